//! What the tests of refusals share.

use bytes::BytesMut;
use mom_proto::codec::Frame;
use mom_proto::xml::XmlDecoder;
use mom_proto::{Limits, Value, WireError};

/// The error that `entity` gives, with the id it names and whether the connection lives on.
pub(crate) fn refuse(entity: &[u8], limits: &Limits) -> (WireError, Option<u64>, bool) {
    let next = b"Content-Type: application/xml\nContent-Length: 56\n\n<parcel><family>reply</family><name>ok</name></parcel>\n\n";
    let mut input = BytesMut::from(&[entity, next].concat()[..]);
    let mut decoder = XmlDecoder::new(limits);
    match decoder.decode(&mut input) {
        Err(error) => (error, None, false),
        Ok(Some(Frame::Malformed { reference, error })) => {
            let next = decoder.decode(&mut input);
            assert!(
                matches!(next, Ok(Some(Frame::Parcel(_)))),
                "after {error}: {next:?}"
            );
            (error, reference, true)
        }
        other => panic!("not refused: {other:?}, {}", String::from_utf8_lossy(entity)),
    }
}

/// An entity of this type with this body.
pub(crate) fn entity(media: &str, body: &[u8]) -> Vec<u8> {
    let head = format!("Content-Type: {media}\r\nContent-Length: {}\r\n\r\n", body.len());
    [head.as_bytes(), body].concat()
}

/// Checks a body in which `¦` stands before the byte at fault.
pub(crate) fn check_body(media: &str, marked: &str, code: &str, slot: &str) -> Option<u64> {
    let body = marked.replace('¦', "");
    let (error, reference, lives) = refuse(&entity(media, body.as_bytes()), &Limits::default());
    let position = marked.find('¦').and_then(|at| i64::try_from(at).ok());
    assert_eq!(error.code.word(), code, "{marked}: {error}");
    assert_eq!(
        error.get("slot").and_then(Value::as_str).unwrap_or_default(),
        slot,
        "{marked}: {error}"
    );
    assert_eq!(
        error.get("position").and_then(Value::as_int),
        position,
        "{marked}: {error}"
    );
    assert_eq!(lives, code != "restricted-xml", "{marked}");
    reference
}
