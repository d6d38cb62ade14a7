//! Framing and MIME that are refused: the code and the byte of the body (threats 6–9).

mod common;

use bytes::BytesMut;
use common::{check_body, entity, refuse};
use mom_proto::codec::Frame;
use mom_proto::xml::XmlDecoder;
use mom_proto::{Limits, Value};

/// Header lines that end the connection.
const HEADS: &[(&str, &str)] = &[
    ("GET / HTTP/1.1\r\n", "bad-frame"),
    ("G", "bad-frame"),
    ("<parcel>", "bad-frame"),
    ("\rContent-Length: 1\r\n", "bad-frame"),
    ("Content-Length: 1\r\nHost: x\r\n\r\n", "bad-frame"),
    (
        "Content-Length: 1\r\nTransfer-Encoding: chunked\r\n\r\n",
        "bad-frame",
    ),
    (
        "Content-Length: 1\r\n Content-Type: application/xml\r\n\r\n",
        "bad-frame",
    ),
    ("Content-Length : 1\r\n", "bad-frame"),
    ("Content-: 1\r\n", "bad-frame"),
    ("Content-Length\r\n", "bad-frame"),
    ("Content-Length: \r\n", "bad-frame"),
    ("Content-Length: +5\r\n", "bad-frame"),
    ("Content-Length: -5\r\n", "bad-frame"),
    ("Content-Length: 0x5\r\n", "bad-frame"),
    ("Content-Length: 5, 5\r\n", "bad-frame"),
    ("Content-Length: 5\r\nContent-Length: 5\r\n", "bad-frame"),
    (
        "Content-Type: application/xml\r\nContent-Type: application/xml\r\n",
        "bad-frame",
    ),
    ("Content-Type: application/xml\r\n\r\n", "bad-frame"),
    ("Content-Length: 5\r\n\r\n", "bad-frame"),
    ("Content-Name: a\0b\r\n", "bad-frame"),
    ("Content-Name: ü\r\n", "bad-frame"),
    ("Content-Length: 101\r\n", "too-large"),
    ("Content-Length: 99999999999999999999999999\r\n", "too-large"),
];

/// Types and encodings that are not spoken.
const MEDIA: &[(&str, &str)] = &[
    ("text/xml", "bad-mime"),
    ("application/json", "bad-mime"),
    ("xml", "bad-mime"),
    ("application/xml; charset=utf-16", "bad-encoding"),
    ("application/xml; charset=utf-8; charset=utf-8", "bad-mime"),
    ("application/xml; charset=utf-8; version=2", "bad-mime"),
    ("application/xml\r\nContent-Transfer-Encoding: base64", "bad-mime"),
    ("application/xml\r\nContent-Encoding: gzip", "bad-mime"),
    ("multipart/mixed; boundary=b", "bad-mime"),
    ("multipart/related; boundary=b", "bad-mime"),
    ("multipart/related; type=\"text/xml\"; boundary=b", "bad-mime"),
    ("multipart/related; type=\"application/xml\"", "bad-mime"),
    (
        "multipart/related; type=\"application/xml\"; boundary=\"b \"",
        "bad-mime",
    ),
    (
        "multipart/related; type=\"application/xml\"; boundary=\"b%\"",
        "bad-mime",
    ),
    (
        "multipart/related; type=\"application/xml\"; boundary=b; boundary=c",
        "bad-mime",
    ),
    (
        "multipart/related; type=\"application/xml\"; boundary=b; start=\"<a>\"",
        "bad-mime",
    ),
    (
        "multipart/related; type=\"application/xml\"; boundary=bbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbb",
        "bad-mime",
    ),
];

/// Threat 6, and what is not an entity at all.
#[test]
fn framing() {
    let small = Limits {
        parcel: mom_proto::Limit::At(100),
        ..Limits::default()
    };
    let long = format!(
        "Content-Type: application/xml\r\nContent-X: {}\r\n",
        "x".repeat(1000)
    );
    let endless = [(long.as_str(), "bad-frame"), (long.trim_end(), "bad-frame")];
    for (head, code) in HEADS.iter().copied().chain(endless) {
        let mut decoder = XmlDecoder::new(&small);
        // Refused at once: no byte after these is waited for.
        let error = decoder.decode(&mut BytesMut::from(head)).expect_err(head);
        assert_eq!(error.code.word(), code, "{head}: {error}");
    }
    let mut decoder = XmlDecoder::new(&small);
    decoder.set_limits(&Limits::default());
    assert_eq!(
        decoder.decode(&mut BytesMut::from("Content-Length: 101\r\n")),
        Ok(None)
    );
}

#[test]
fn media_types() {
    for (media, code) in MEDIA.iter().copied() {
        let (error, _, lives) = refuse(&entity(media, b"<parcel/>"), &Limits::default());
        assert_eq!((error.code.word(), lives), (code, true), "{media}: {error}");
    }
}

const RELATED: &str = "multipart/related; type=\"application/xml\"; boundary=b";
const XML: &str =
    "Content-Type: application/xml\r\n\r\n<parcel><id>7</id><family>message</family><name>x</name>";

/// Parts that are none: body and code. `{one}` begins an entity of one part, `{part}` is that part.
const PARTS: &[(&str, &str)] = &[
    ("{one}\r\n--b\r\n{part}\r\n--b¦c\r\n\r\n--b--", "bad-mime"),
    ("{one}\r\n--b\r\n{part}\r\n--b¦ \r\n--b--", "bad-mime"),
    ("{one}\r\n--b\r\n{part}¦", "bad-mime"),
    ("{one}\r\n--b\r\n{part}\n--b--¦", "bad-mime"),
    ("{one}\r\n--b\r\n{part}\r\n--b--¦x", "bad-mime"),
    ("{one}\r\n--b\r\n{part}\r\n--b--¦\r\n\r\n", "bad-mime"),
    (
        "{one}\r\n--b\r\n¦Content-Type: multipart/mixed; boundary=c\r\n{part}\r\n--b--",
        "bad-mime",
    ),
    ("{one}\r\n--b\r\n¦\r\ndata\r\n--b--", "bad-mime"),
    ("{one}\r\n--b\r\nContent-ID: <p>\r\n¦{part}\r\n--b--", "bad-mime"),
    ("{one}\r\n--b\r\n¦Content-ID: p\r\n\r\ndata\r\n--b--", "bad-mime"),
    ("{one}\r\n--b\r\n¦X-Header: p\r\n{part}\r\n--b--", "bad-mime"),
    (
        "{one}\r\n--b\r\n¦Content-Transfer-Encoding: base64\r\n{part}\r\n--b--",
        "bad-mime",
    ),
    (
        "{one}\r\n--b\r\n¦Content-X: {long}\r\n{part}\r\n--b--",
        "bad-mime",
    ),
    ("{one}\r\n--b\r\n{part}\r\n--b\r\n¦{part}\r\n--b--", "bad-cid"),
    ("--b\r\n{XML}</parcel>\r\n--b\r\n¦{part}\r\n--b--", "bad-cid"),
    (
        "--b\r\n{XML}{cid}<c type=\"binary\"><cid>¦p</cid></c></parcel>\r\n--b\r\n{part}\r\n--b--",
        "bad-cid",
    ),
    (
        "--b\r\n{XML}<a type=\"binary\"><cid>¦p</cid></a></parcel>\r\n--b\r\nContent-ID: <q>\r\n\r\n\r\n--b--",
        "bad-cid",
    ),
];

/// Bodies that have no readable XML part first.
const FIRST_PARTS: &[(&str, &str)] = &[
    ("¦", "bad-mime"),
    ("¦preamble\r\n--b\r\n", "bad-mime"),
    ("¦--b--", "bad-mime"),
    ("--b--¦c", "bad-mime"),
    ("--b\r\n¦\r\n<parcel/>\r\n--b--", "bad-mime"),
    (
        "--b\r\n¦Content-Type: text/plain\r\n\r\n<parcel/>\r\n--b--",
        "bad-mime",
    ),
    ("--b\r\n¦Content-Type: application/xml", "bad-mime"),
    (
        "--b\r\n¦Content-Type: application/xml; charset=utf-16\r\n\r\n\r\n--b--",
        "bad-encoding",
    ),
    (
        "--b\r\nContent-Type: application/xml\r\n\r\n<parcel>¦<!-- a -->\r\n--b--",
        "bad-xml",
    ),
    (
        "--b\r\nContent-Type: application/xml\r\n\r\n¦<!DOCTYPE x>\r\n--b--",
        "restricted-xml",
    ),
];

/// Threats 7 and 8.
#[test]
fn parts() {
    let cid = "<a type=\"binary\"><cid>p</cid></a>";
    for (marked, code) in PARTS.iter().copied() {
        let marked = marked
            .replace("{one}", &format!("--b\r\n{XML}{cid}</parcel>"))
            .replace("{part}", "Content-ID: <p>\r\n\r\ndata")
            .replace("{long}", &"x".repeat(1024))
            .replace("{cid}", cid)
            .replace("{XML}", XML);
        let (error, reference, lives) = refuse(
            &entity(RELATED, marked.replace('¦', "").as_bytes()),
            &Limits::default(),
        );
        assert_eq!(
            (error.code.word(), reference, lives),
            (code, Some(7), true),
            "{marked}: {error}"
        );
        let cid = (code == "bad-cid").then(|| Value::from("p"));
        assert_eq!(error.get("cid"), cid.as_ref(), "{marked}: {error}");
        let fault = marked.find('¦').and_then(|at| i64::try_from(at).ok());
        assert_eq!(
            error.get("position").and_then(Value::as_int),
            fault,
            "{marked}: {error}"
        );
    }
    for (marked, code) in FIRST_PARTS.iter().copied() {
        check_body(RELATED, marked, code, "");
    }
}

/// Threat 9.
#[test]
fn too_many_parts() {
    let part = |number: usize| format!("\r\n--b\r\nContent-ID: <p{number}>\r\n\r\n{number}");
    let cid = |number: usize| format!("<item type=\"binary\"><cid>p{number}</cid></item>");
    let body = |count: usize| {
        let cids: String = (0..count).map(cid).collect();
        let parts: String = (0..count).map(part).collect();
        format!("--b\r\n{XML}<content type=\"list\">{cids}</content></parcel>{parts}\r\n--b--")
    };
    let limits = Limits {
        parts: 4,
        ..Limits::default()
    };
    for count in [4, 10_000] {
        let (error, reference, _) = refuse(&entity(RELATED, body(count).as_bytes()), &limits);
        assert_eq!((error.code.word(), reference), ("bad-mime", Some(7)), "{error}");
    }
    let fits = entity(RELATED, body(3).as_bytes());
    let frame = XmlDecoder::new(&limits).decode(&mut BytesMut::from(&fits[..]));
    assert!(matches!(frame, Ok(Some(Frame::Parcel(_)))), "{frame:?}");
}
