//! XML that is not a parcel: the code, the slot and the byte of the body (threats 1–5).

mod common;

use common::{check_body, entity, refuse};
use mom_proto::{Limits, Value};

const FAMILY: &str = "<family>message</family><name>x</name>";

/// Whole documents: body and code.
const DOCUMENTS: &[(&str, &str)] = &[
    // Threat 1.
    ("¦<!DOCTYPE a [<!ENTITY b \"c\">]><parcel/>", "restricted-xml"),
    ("¦<!doctype a", "restricted-xml"),
    (
        "<parcel>¦<!ENTITY x SYSTEM \"file:///etc/passwd\"></parcel>",
        "restricted-xml",
    ),
    ("<parcel>¦<?php x?></parcel>", "restricted-xml"),
    ("<parcel/>¦<?xml version=\"1.0\"?>", "restricted-xml"),
    (" ¦<?xml version=\"1.0\"?><parcel/>", "restricted-xml"),
    ("¦<?XML version=\"1.0\"?><parcel/>", "restricted-xml"),
    ("¦<?xml-stylesheet href=\"a\"?><parcel/>", "restricted-xml"),
    (
        "<?xml version=\"1.0\"?>¦<?xml version=\"1.0\"?><parcel/>",
        "restricted-xml",
    ),
    // The declaration.
    ("¦<?xml version=\"1.0\"", "bad-xml"),
    ("¦<?xml ?><parcel/>", "bad-xml"),
    ("<?xml ¦version=\"1.1\"?><parcel/>", "bad-xml"),
    ("<?xml encoding=\"utf-8\" ¦version=\"1.0\"?><parcel/>", "bad-xml"),
    (
        "<?xml version=\"1.0\" ¦encoding=\"latin1\"?><parcel/>",
        "bad-encoding",
    ),
    ("<?xml version=\"1.0\" ¦version=\"1.0\"?><parcel/>", "bad-xml"),
    (
        "<?xml version=\"1.0\" ¦standalone=\"maybe\"?><parcel/>",
        "bad-xml",
    ),
    ("<?xml version=\"1.0\"?>¦\u{FEFF}<parcel/>", "bad-xml"),
    // Around the element.
    ("¦", "bad-xml"),
    ("  ¦", "bad-xml"),
    ("¦\u{FEFF}<parcel/>", "bad-encoding"),
    (" ¦x<parcel/>", "bad-xml"),
    ("¦&#32;<parcel/>", "bad-xml"),
    ("¦<Parcel/>", "bad-xml"),
    ("¦<parcel type=\"map\"/>", "bad-xml"),
    ("<parcel ¦xmlns=\"urn:x\"/>", "bad-xml"),
    ("<¦p:parcel/>", "bad-xml"),
    ("<parcel>¦", "bad-xml"),
    ("<parcel>¦</parcels>", "bad-xml"),
    ("<parcel>¦</ parcel>", "bad-xml"),
    ("¦</parcel>", "bad-xml"),
    ("¦<parcel", "bad-xml"),
    ("¦<!-- c --><parcel/>", "bad-xml"),
    ("¦<!x><parcel/>", "bad-xml"),
    ("¦<", "bad-xml"),
    ("<parcel><a>¦\u{0}</a></parcel>", "bad-encoding"),
    ("<parcel><a>¦\u{FFFE}</a></parcel>", "bad-encoding"),
];

/// What follows in a document after its id.
const ENDS: &[(&str, &str)] = &[
    ("</parcel>¦<parcel></parcel>", "bad-xml"),
    ("</parcel>\n ¦x", "bad-xml"),
    ("</parcel>¦</parcel>", "bad-xml"),
    ("¦text</parcel>", "bad-xml"),
    ("¦&amp;</parcel>", "bad-xml"),
    ("¦<![CDATA[a]]></parcel>", "bad-xml"),
    ("¦<!-- a --></parcel>", "bad-xml"),
    ("<a>¦\u{1}</a></parcel>", "bad-encoding"),
];

/// Slots of a parcel: element, code and slot.
const SLOTS: &[(&str, &str, &str)] = &[
    ("¦<id>8</id>", "bad-slot", "id"),
    ("¦<fence type=\"string\">8</fence>", "bad-slot", "fence"),
    ("<fence>¦-0</fence>", "bad-slot", "fence"),
    ("¦<fence>-1</fence>", "bad-slot", "fence"),
    ("¦<context>/a/../b</context>", "bad-path", "context"),
    ("¦<address></address>", "bad-slot", "address"),
    ("<address>¦arm</address>", "bad-xml", "address"),
    ("<a type=\"int\">¦ 1</a>", "bad-slot", "a"),
    ("<a type=\"null\">¦x</a>", "bad-slot", "a"),
    ("<a type=\"double\">¦inf</a>", "bad-slot", "a"),
    ("<a type=\"time\">¦now</a>", "bad-slot", "a"),
    ("<a type=\"boolean\">¦</a>", "bad-slot", "a"),
    ("<a ¦type=\"string \"/>", "bad-slot", "a"),
    ("¦<a type=\"binary\"/>", "bad-slot", "a"),
    ("<a type=\"binary\">¦AAEC</a>", "bad-xml", "a"),
    ("<a type=\"binary\" encoding=\"base64\">¦AAE</a>", "bad-slot", "a"),
    ("<a type=\"binary\" ¦encoding=\"hex\"/>", "bad-xml", "a"),
    ("¦<a encoding=\"base64\">AAEC</a>", "bad-xml", "a"),
    (
        "<a type=\"binary\">¦<cid type=\"string\">p</cid></a>",
        "bad-xml",
        "a",
    ),
    ("<a type=\"binary\"><cid>¦part-1</cid></a>", "bad-cid", "a"),
    ("<a>b¦<b/></a>", "bad-xml", "a"),
    ("<a>¦<![CDATA[b]]></a>", "bad-xml", "a"),
    ("<a>b¦<!-- c --></a>", "bad-xml", "a"),
    ("<a>b¦]]>c</a>", "bad-xml", "a"),
    ("<a>b ¦& c</a>", "bad-xml", "a"),
    ("<a>¦&nbsp;</a>", "bad-xml", "a"),
    ("<a>¦&#0;</a>", "bad-xml", "a"),
    ("<a>¦</b>", "bad-xml", "a"),
    ("<a>b<¦ c</a>", "bad-xml", "a"),
    ("<a ¦b=\"c\"/>", "bad-xml", "a"),
    ("<a ¦xml:lang=\"de\"/>", "bad-xml", "a"),
    ("<a type=¦int/>", "bad-xml", "a"),
    ("<a type¦/>", "bad-xml", "a"),
    ("<a type=\"int\"¦key=\"b\"/>", "bad-xml", "a"),
    ("<a type=\"int\" ¦type=\"int\">1</a>", "bad-xml", "a"),
    ("<slot key=\"a¦<b\"/>", "bad-xml", ""),
    ("<slot key=\"a¦&b\"/>", "bad-xml", ""),
    ("¦<slot>1</slot>", "bad-xml", ""),
    ("¦<a key=\"b\"/>", "bad-xml", ""),
    ("¦<xmlThing/>", "bad-xml", ""),
    ("<¦1a/>", "bad-xml", ""),
    ("<¦a:b/>", "bad-xml", ""),
    ("<a/>¦<slot key=\"a\"/>", "bad-slot", "a"),
    ("¦<name>y</name>", "bad-slot", "name"),
    ("<content type=\"list\">¦<a/></content>", "bad-xml", "content/0"),
    (
        "<content type=\"list\"><item/><item/>¦<item key=\"a\"/></content>",
        "bad-xml",
        "content/2",
    ),
    (
        "<content type=\"list\"><item/>¦,<item/></content>",
        "bad-xml",
        "content",
    ),
    (
        "<content type=\"map\"><a type=\"list\"><item/><item type=\"int\">¦x</item></a></content>",
        "bad-slot",
        "content/a/1",
    ),
    (
        "<content type=\"map\"><a/>¦<a/></content>",
        "bad-slot",
        "content/a",
    ),
    ("<content type=\"map\">¦a</content>", "bad-xml", "content"),
];

#[test]
fn documents() {
    for (marked, code) in DOCUMENTS.iter().copied() {
        check_body("application/xml", marked, code, "");
    }
    for (rest, code) in ENDS.iter().copied() {
        let marked = format!("<parcel>{FAMILY}<id>7</id>{rest}");
        assert_eq!(
            check_body("application/xml", &marked, code, ""),
            Some(7),
            "{marked}"
        );
    }
    let missing = [
        ("¦<parcel/>", "family"),
        ("¦<parcel><family>time</family></parcel>", "name"),
    ];
    for (marked, slot) in missing {
        check_body("application/xml", marked, "bad-slot", slot);
    }
}

#[test]
fn slots() {
    for (marked, code, slot) in SLOTS.iter().copied() {
        let marked = format!("<parcel><id type=\"int\">7</id>{FAMILY}{marked}</parcel>");
        assert_eq!(
            check_body("application/xml", &marked, code, slot),
            Some(7),
            "{marked}"
        );
    }
}

/// Threats 2 and 3.
#[test]
fn too_much() {
    let limits = Limits::default();
    let check = |body: String, limits: &Limits, code: &str, slot: &str| {
        let (error, _, lives) = refuse(&entity("application/xml", body.as_bytes()), limits);
        let given = error.get("slot").and_then(Value::as_str).unwrap_or_default();
        assert_eq!((error.code.word(), lives), (code, true), "{error}");
        assert!(given.starts_with(slot) && given.len() < 1000, "{given}");
        assert!(
            error.get("position").and_then(Value::as_int) < Some(20_000),
            "the rest is not read"
        );
    };
    let levels = |count: usize| format!("<parcel>{}", "<a type=\"map\">".repeat(count));
    check(levels(limits.depth + 1), &limits, "too-deep", "a/a/a/");
    check(levels(500_000), &limits, "too-deep", "a/a/a/");
    let lists = |count: usize| {
        let items = "<item type=\"list\">".repeat(count - 1);
        format!("<parcel><a type=\"list\">{items}")
    };
    check(lists(limits.depth + 1), &limits, "too-deep", "a/0/0/");
    check(lists(400_000), &limits, "too-deep", "a/0/0/");
    let endless = Limits {
        depth: usize::MAX,
        ..Limits::default()
    };
    check(levels(500_000), &endless, "too-deep", "a/a/a/");
    let attributes: String = (0..100_000).map(|number| format!(" a{number}=\"\"")).collect();
    check(
        format!("<parcel><a{attributes}/></parcel>"),
        &limits,
        "bad-xml",
        "",
    );
    let few = Limits {
        attributes: 1,
        ..Limits::default()
    };
    check(
        "<parcel><slot key=\"a\" type=\"int\">1</slot></parcel>".to_owned(),
        &few,
        "bad-xml",
        "",
    );
    let long = "a".repeat(limits.attribute_size + 1);
    check(
        format!("<parcel><slot key=\"{long}\"/></parcel>"),
        &limits,
        "bad-xml",
        "",
    );
    check(format!("<parcel><{long}/></parcel>"), &limits, "bad-xml", "");
    let namespaces: String = (0..10_000)
        .map(|number| format!(" xmlns:n{number}=\"urn:{number}\""))
        .collect();
    check(
        format!("<parcel><a{namespaces}/></parcel>"),
        &limits,
        "bad-xml",
        "",
    );
}
