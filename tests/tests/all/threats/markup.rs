//! Threats 1, 2, 3 and 5: what stands inside a parcel.

use mom_proto::Value;
use mom_proto::codec::Form;
use tokio::net::TcpListener;
use tokio::time::timeout;

use super::{After, World, chat_xml, entity};

/// Threat 1: document types, entity bombs, external entities.
#[tokio::test]
async fn threat_1_document_types() {
    let mut world = World::start().await;
    let trap = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let url = format!("http://{}/", trap.local_addr().expect("its address"));
    let lol = "<!ENTITY a \"lol\">".to_owned()
        + &(1..10)
            .map(|level| {
                format!(
                    "<!ENTITY a{level} \"{}\">",
                    format!("&a{};", level - 1).repeat(10)
                )
            })
            .collect::<String>();
    let parcel = chat_xml("<content>&a9;</content>");
    let documents = [
        format!("<!DOCTYPE parcel>{parcel}"),
        format!("<!DOCTYPE parcel [{lol}]>{parcel}"),
        format!("<!DOCTYPE parcel SYSTEM \"{url}\">{parcel}"),
        format!("<!DOCTYPE parcel [<!ENTITY % a SYSTEM \"{url}\"> %a;]>{parcel}"),
        "<parcel><!ENTITY a SYSTEM \"file:///etc/passwd\"></parcel>".to_owned(),
        format!("<?xml version=\"1.0\"?><?xml-stylesheet href=\"{url}\"?>{parcel}"),
        chat_xml("<content>a<?php x ?></content>"),
        format!("{parcel}<!DOCTYPE parcel>"),
    ];
    for document in &documents[..7] {
        let bytes = entity(document);
        let error = world
            .attack(document, Form::Xml, &bytes, "restricted-xml", After::Closed)
            .await;
        assert!(error.get("position").is_some(), "{error:?}");
    }
    // An entity that nobody declared is just unknown.
    let bytes = entity(&documents[7]);
    world
        .attack("entity", Form::Xml, &bytes, "bad-xml", After::Kept)
        .await;
    world.end().await;
    let opened = timeout(std::time::Duration::ZERO, trap.accept()).await;
    assert!(opened.is_err(), "nobody followed the address of an entity");
}

/// Threat 2: levels without end, in XML, in binary content that has to be opened, and in other slots.
#[tokio::test]
async fn threat_2_nesting() {
    let mut world = World::start().await;
    let item = "<item type=\"list\">";
    let most = 8 * 1024 * 1024 / item.len() - 100;
    for levels in [32, 33, 1000, most] {
        let slots = format!("<content type=\"list\">{}", item.repeat(levels));
        let body = format!("<parcel><family>message</family><name>chat</name><id>7</id>{slots}");
        let what = format!("{levels} levels of XML");
        let error = world
            .attack(&what, Form::Xml, &entity(body), "too-deep", After::Kept)
            .await;
        // Refused where the 33rd list opens: what follows was not looked at.
        let position = error.get("position").and_then(Value::as_int).expect("a position");
        assert!(position < 1000, "{error:?}");
    }
    for (what, byte) in [("lists", 0x91), ("maps", 0x81)] {
        for levels in [33, 129, 1_000_000] {
            let mut content = match byte {
                0x81 => [0x81, 0xa1, b'a'].repeat(levels),
                _ => vec![byte; levels],
            };
            content.push(0xc0);
            let what = format!("{levels} {what} in binary");
            world.attack_content(&what, content).await;
        }
    }
    world.end().await;
}

/// Threat 3: too many attributes, too large ones, namespaces.
#[tokio::test]
async fn threat_3_attributes() {
    let mut world = World::start().await;
    let many: String = (0..100_000).map(|number| format!(" a{number}=\"\"")).collect();
    let namespaces: String = (0..10_000)
        .map(|number| format!(" xmlns:n{number}=\"urn:x\""))
        .collect();
    let large = format!(" key=\"{}\"", "k".repeat(1024 * 1024));
    for (what, attributes) in [
        ("100 000 attributes", many.as_str()),
        ("10 000 namespaces", &namespaces),
        ("1 MiB attribute", &large),
        ("8 KiB and a byte", &format!(" key=\"{}\"", "k".repeat(8193))),
        ("default namespace", " xmlns=\"urn:x\""),
        ("twice", " type=\"int\" type=\"int\""),
        ("unknown", " lang=\"de\""),
    ] {
        let bytes = entity(chat_xml(&format!("<slot{attributes}>x</slot>")));
        let error = world
            .attack(what, Form::Xml, &bytes, "bad-xml", After::Kept)
            .await;
        let position = error.get("position").and_then(Value::as_int).expect("a position");
        assert!(
            position < 10_000,
            "{what} is refused before the rest is read: {error:?}"
        );
    }
    world.end().await;
}

/// Threat 5: text that is none.
#[tokio::test]
async fn threat_5_encoding() {
    encoding(World::start().await).await;
}

pub(super) async fn encoding(mut world: World) {
    let with = |bytes: &[u8]| {
        let parcel = chat_xml("<content>¦</content>");
        let (before, after) = parcel.split_once('¦').expect("the mark");
        entity([before.as_bytes(), bytes, after.as_bytes()].concat())
    };
    let utf16: Vec<u8> = format!("\u{feff}{}", chat_xml(""))
        .encode_utf16()
        .flat_map(u16::to_be_bytes)
        .collect();
    for (what, bytes) in [
        ("no UTF-8", with(b"\xff")),
        ("overlong", with(b"\xc0\xaf")),
        ("a lone surrogate", with(b"\xed\xa0\x80")),
        ("half a character", with(b"\xe2\x82")),
        ("NUL", with(b"a\0b")),
        ("an escape sequence", with(b"\x1b[2J")),
        ("U+FFFE", with("\u{fffe}".as_bytes())),
        ("UTF-16", entity(&utf16)),
        ("a byte order mark", entity(format!("\u{feff}{}", chat_xml("")))),
        (
            "another encoding",
            entity(format!(
                "<?xml version=\"1.0\" encoding=\"utf-7\"?>{}",
                chat_xml("")
            )),
        ),
    ] {
        world
            .attack(what, Form::Xml, &bytes, "bad-encoding", After::Kept)
            .await;
    }
    for reference in ["&#xD800;", "&#0;", "&#xFFFE;", "&#x110000;"] {
        let bytes = with(reference.as_bytes());
        world
            .attack(reference, Form::Xml, &bytes, "bad-xml", After::Kept)
            .await;
    }
    for (what, content) in [
        ("no UTF-8", &b"\xa1\xff"[..]),
        ("a lone surrogate", b"\xa3\xed\xa0\x80"),
        ("NUL", b"\xa1\0"),
        ("U+FFFE", b"\xa3\xef\xbf\xbe"),
        ("NUL in a key", b"\x81\xa1\0\xc0"),
    ] {
        world.attack_content(what, content.to_vec()).await;
    }
    // A name of three bytes that are no characters, and one with a NUL.
    for name in [&b"\x06\xff\xff\xff"[..], b"\x04a\0"] {
        let bytes = super::frame(&[b"\0\x02", name].concat());
        world
            .attack("a name", Form::Binary, &bytes, "bad-encoding", After::Kept)
            .await;
    }
    world.end().await;
}
