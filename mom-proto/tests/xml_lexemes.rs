//! Where tags, names, references and values end, also where they are wrong: the byte of the body and the words.

mod common;

use bytes::BytesMut;
use common::{check_body, entity, refuse};
use mom_proto::codec::Frame;
use mom_proto::xml::XmlDecoder;
use mom_proto::{Limits, Map, Value};

/// A tag ends at the first > outside of quotes, a name at a blank, / or >. Element, slot, words.
const START_TAGS: &[(&str, &str, &str)] = &[
    ("<a¦/b>1</a>", "a", "attributes are separated by blanks"),
    ("<a¦//>", "a", "attributes are separated by blanks"),
    ("<a¦/ >", "a", "attributes are separated by blanks"),
    ("<a ¦/ >", "a", "\"/\" is not a name"),
    ("<¦>x</>", "", "\"\" is not a name"),
    ("<¦ >", "", "\"\" is not a name"),
    ("<¦a\"b>1</a>", "", "\"a\\\"b\" is not a name"),
    ("<¦a\"b>\">1</a>", "", "\"a\\\"b\" is not a name"),
    ("<¦a\"b c>1</a>", "", "\"a\\\"b\" is not a name"),
    ("¦<a'b c'>", "", "this tag does not end"),
    ("<a ¦b", "a", "\"b</parcel\" is not a name"),
    ("¦<a b=\"c>1</a>", "", "this tag does not end"),
    ("¦<a type='int\">1</a>", "", "this tag does not end"),
    ("<¦a", "", "\"a<\" is not a name"),
    ("<a¦/", "a", "attributes are separated by blanks"),
    ("<¦longer-than", "", "\"longer-than<\" is not a name"),
    ("<¦é\"/>", "", "\"é\\\"\" is not a name"),
    ("<¦a:b/c>", "", "a parcel has no namespaces: \"a:b\""),
    ("¦<slot key=\"a>b", "", "this tag does not end"),
];

/// An end tag is its name, blanks and >, whatever quotes say. Element, slot, words.
const END_TAGS: &[(&str, &str, &str)] = &[
    ("<a>x¦</a'>", "a", "expected </a>, found </a'>"),
    ("<a>x¦</a'>'>", "a", "expected </a>, found </a'>"),
    ("<a>x¦</a b=\">\">", "a", "expected </a>, found </a b=\">"),
    ("<a>x¦</a", "a", "expected </a>, found </a</parcel>"),
    ("<a>x¦</ a>", "a", "expected </a>, found </ a>"),
    ("<a>x¦</ >", "a", "expected </a>, found </>"),
    ("<a>x¦</>", "a", "expected </a>, found </>"),
    ("<a>x¦</b \t>", "a", "expected </a>, found </b>"),
];

/// Text goes on over references, and is resolved when its element has ended. Element, slot, words.
const REFERENCES: &[(&str, &str, &str)] = &[
    ("<a>&amp¦</a", "a", "expected </a>, found </a</parcel>"),
    (
        "<a>&amp¦<b/></a>",
        "a",
        "a value of this type has no elements in it",
    ),
    (
        "<a>¦&&amp;</a>",
        "a",
        "\"&&amp;\" is none of &amp; &lt; &gt; &quot; &apos; and no character by number",
    ),
    ("<a>&lt;&x¦", "a", "expected </a>, found </parcel>"),
    (
        "<a>x ¦&amp y;</a>",
        "a",
        "\"&amp y;\" is none of &amp; &lt; &gt; &quot; &apos; and no character by number",
    ),
    ("<a>&¦</b>", "a", "expected </a>, found </b>"),
    ("<a>x&lt;¦<!-- c --></a>", "a", "a parcel has no comments"),
    (" ¦&amp;", "", "text stands only in values"),
    ("¦&", "", "text stands only in values"),
    (
        "<content type='map'>¦&lt;</content>",
        "content",
        "text stands only in values",
    ),
    (
        "<content type='map'>¦&a<b/></content>",
        "content",
        "text stands only in values",
    ),
];

/// What follows after a name. Element, slot, words.
const ATTRIBUTES: &[(&str, &str, &str)] = &[
    ("<a ¦=\"x\"/>", "a", "\"\" is not a name"),
    ("<a ¦=\"x\"type=\"int\">1</a>", "a", "\"\" is not a name"),
    ("<a ¦\"x\"/>", "a", "\"\\\"x\\\"\" is not a name"),
    ("<a type¦/>", "a", "an attribute is written name=\"value\""),
    ("<a type ¦/>", "a", "an attribute is written name=\"value\""),
    ("<a type =¦/>", "a", "an attribute's value stands between quotes"),
    ("<a type= ¦/>", "a", "an attribute's value stands between quotes"),
    (
        "<a type=¦int>1</a>",
        "a",
        "an attribute's value stands between quotes",
    ),
    (
        "<a type=\"int\" type=¦int/>",
        "a",
        "an attribute's value stands between quotes",
    ),
    ("<a ¦type:b c>", "a", "a parcel has no namespaces: \"type:b\""),
    ("<a ¦1 >", "a", "\"1\" is not a name"),
    (
        "<a type='int'¦key=''/>",
        "a",
        "attributes are separated by blanks",
    ),
    ("<a type=\"int\"¦/ >", "a", "attributes are separated by blanks"),
    ("<a type=\"int\" ¦/ >", "a", "\"/\" is not a name"),
    ("<slot key='>'¦<", "", "attributes are separated by blanks"),
    (
        "<a type=\"i¦&nt\"/>",
        "a",
        "\"&nt\" is none of &amp; &lt; &gt; &quot; &apos; and no character by number",
    ),
    (
        "<a type=\"¦<&\"/>",
        "a",
        "an attribute may not contain <: write &lt;",
    ),
];

/// Whole documents, and the words.
const DOCUMENTS: &[(&str, &str)] = &[
    (
        "<?xml version=¦\"1.0?><parcel/>",
        "an attribute's value stands between quotes",
    ),
    (
        "<?xml version=¦\"1.0'?><parcel/>",
        "an attribute's value stands between quotes",
    ),
    (
        "<?xml version=¦'?>'?><parcel/>",
        "an attribute's value stands between quotes",
    ),
    (
        "<?xml version=¦?><parcel/>",
        "an attribute's value stands between quotes",
    ),
    (
        "<?xml version=¦1.0?><parcel/>",
        "an attribute's value stands between quotes",
    ),
    (
        "<?xml version¦?><parcel/>",
        "an attribute is written name=\"value\"",
    ),
    ("¦<?xml version='1.0'?", "the XML declaration does not end"),
    (
        "<?xml version='1.0'¦standalone='no'?><parcel/>",
        "attributes are separated by blanks",
    ),
    ("<?xml ¦=?><parcel/>", "\"\" is not a name"),
    (
        "¦</parcel '>",
        "a document is one element <parcel>, without attributes",
    ),
    ("¦</'", "this tag does not end"),
    ("<parcel/>¦<", "this tag does not end"),
    ("<parcel/>¦&amp;", "text stands only in values"),
    ("<parcel>¦&", "text stands only in values"),
    ("¦&<parcel/>", "text stands only in values"),
    ("<parcel¦/ >", "attributes are separated by blanks"),
    ("<parcel>¦</parcel'>", "expected </parcel>, found </parcel'>"),
];

fn check(marked: &str, slot: &str, words: &str) {
    check_body("application/xml", marked, "bad-xml", slot);
    let body = marked.replace('¦', "");
    let (error, ..) = refuse(&entity("application/xml", body.as_bytes()), &Limits::default());
    assert_eq!(error.text, words, "{marked}");
}

#[test]
fn elements() {
    for (marked, slot, words) in [START_TAGS, END_TAGS, REFERENCES, ATTRIBUTES].concat() {
        let marked = format!("<parcel><family>message</family><name>x</name>{marked}</parcel>");
        check(&marked, slot, words);
    }
}

#[test]
fn documents() {
    for (marked, words) in DOCUMENTS {
        check(marked, "", words);
    }
}

#[test]
fn a_name_that_is_too_long_comes_first() {
    let long = "a".repeat(Limits::default().attribute_size + 1);
    for rest in ["", " ", ">", "/>", "\"b>", " b=\"", " b=\">1</a>"] {
        let inner = format!("<{long}{rest}");
        if rest.is_empty() {
            check(&format!("<parcel>¦{inner}"), "", "this tag does not end");
        } else {
            let words = "the name of an element is longer than the limit";
            check(&format!("<parcel>¦{inner}"), "", words);
        }
    }
}

/// Threat 1: however long it is, its end is not looked for.
#[test]
fn refused_markup_needs_no_end() {
    for (begin, code) in [
        ("<!DOCTYPE a [", "restricted-xml"),
        ("<?a", "restricted-xml"),
        ("<!--", "bad-xml"),
    ] {
        check_body("application/xml", &format!("¦{begin}"), code, "");
        let inside = format!("<parcel><a>x&amp;¦{begin}</a></parcel>");
        check_body("application/xml", &inside, code, "a");
    }
}

#[test]
fn what_is_right_but_unusual() {
    let read = |body: &str| {
        let body = format!(
            "<parcel><family>message</family><name>x</name><content type='map'>{body}</content ></parcel\n>"
        );
        let entity = entity("application/xml", body.as_bytes());
        match XmlDecoder::new(&Limits::default()).decode(&mut BytesMut::from(&entity[..])) {
            Ok(Some(Frame::Parcel(parcel))) => parcel.value().clone(),
            other => panic!("{body}: {other:?}"),
        }
    };
    let all: [(&str, Map); 9] = [
        ("<a>x</a >", Map::new().with("a", "x")),
        ("<a\n>x</a\t\r\n>", Map::new().with("a", "x")),
        ("<a type = 'int' >1</a>", Map::new().with("a", 1)),
        ("<a\ttype\n=\r\n\"int\"\n>1</a>", Map::new().with("a", 1)),
        (
            "<slot key='>'/><slot key=\"'>'\" />",
            Map::new().with(">", "").with("'>'", ""),
        ),
        (
            "<slot\nkey='&quot;&#10;\n'>x</slot>",
            Map::new().with("\"\n ", "x"),
        ),
        ("<a>&lt;&amp;&#65;;&gt;</a >", Map::new().with("a", "<&A;>")),
        (
            "<a>\u{FEFF}ü]] ></a><ü>/&apos;'\"=</ü >",
            Map::new().with("a", "\u{FEFF}ü]] >").with("ü", "/''\"="),
        ),
        (
            "<a></a ><b/><c />",
            Map::new().with("a", "").with("b", "").with("c", ""),
        ),
    ];
    for (body, expected) in all {
        assert_eq!(read(body), Value::from(expected), "{body}");
    }
}
