//! The reader and the one before it give the same.

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::{Index, select};

use super::multipart::Parts;
use super::{old, read};
use crate::{Limits, arbitrary};

fn tight() -> Limits {
    Limits {
        attributes: 2,
        attribute_size: 6,
        depth: 2,
        slots: 40,
        ..Limits::default()
    }
}

fn same(document: &[u8]) {
    for limits in [Limits::default(), tight()] {
        let new = read::read(document, 17, &limits, &mut Parts::default());
        let old = old::read::read(document, 17, &limits, &mut Parts::default());
        let same = match (&new, &old) {
            (Ok(new), Ok(old)) => new == old,
            (Err(new), Err(old)) => new.reference == old.reference && new.error == old.error,
            _ => false,
        };
        assert!(
            same,
            "{:?}\nnew {new:?}\nold {old:?}",
            String::from_utf8_lossy(document)
        );
    }
}

const PIECES: &[&str] = &[
    "<parcel>",
    "</parcel>",
    "<parcel/>",
    "<family>message</family>",
    "<name>x</name>",
    "<id>7</id>",
    "<content type=\"map\">",
    "<content type='list'>",
    "</content>",
    "<item>",
    "<item/>",
    "<item type=\"int\">3</item>",
    "</item>",
    "<a type=\"list\">",
    "<a>",
    "</a>",
    "<b/>",
    "<cid>",
    "</cid>",
    "p",
    "<a type=\"binary\">",
    "<a type=\"binary\" encoding='base64'>",
    "AAEC",
    "&lt;",
    "&#10;",
    "&#x41;",
    "&nbsp;",
    "&amp",
    "&",
    ";",
    "<",
    ">",
    "/>",
    "/",
    "</",
    " ",
    "\t",
    "\r\n",
    "\n",
    "\"",
    "'",
    "=",
    "<slot key=\"a\">",
    "<slot key='b&gt;'/>",
    "</slot>",
    "<!",
    "<!--",
    "-->",
    "<![CDATA[",
    "]]>",
    "<?",
    "?>",
    "<?xml version=\"1.0\"?>",
    "<?xml version='1.0' encoding=\"utf-8\"?>",
    "<?xml ",
    "<?xml\n",
    "version=\"1.0\"",
    " encoding='UTF-8'",
    " standalone=\"no\"",
    "<!DOCTYPE a>",
    "<!doctype",
    "<!ENTITY",
    "\u{FEFF}",
    "ü",
    "<ü>",
    "</ü>",
    "\u{1}",
    "a:b",
    "<a:b>",
    "<xml>",
    " type=\"int\"",
    " key=\"k\"",
    " key=\"<\"",
    " key=\"a\tb\"",
    " encoding=\"base64\"",
    " xmlns=\"u\"",
    " type=\"no\"",
    "</a >",
    "</a\n>",
    "</a'>",
    "</a \">\">",
    "</a",
    "</ a>",
    "<a b",
    "<a\"b",
    "<a\"b>",
    "<a'",
    "<a/b>",
    "<a//>",
    "<>",
    "</>",
    "< >",
    "<longername>",
    "</longername>",
    "<longername",
    "1",
    "true",
    " type = 'int'",
    " type='int'key=''",
    "=\"\"",
    " ='x'",
    " type",
    " type=",
    " type=int",
    "--",
    "<1>",
];

fn golden() -> Vec<&'static [u8]> {
    let all: [&'static [u8]; 7] = [
        include_bytes!("../../tests/golden/xml/all_slots.mime"),
        include_bytes!("../../tests/golden/xml/by_hand.mime"),
        include_bytes!("../../tests/golden/xml/image.mime"),
        include_bytes!("../../tests/golden/xml/kinds.mime"),
        include_bytes!("../../tests/golden/xml/login.mime"),
        include_bytes!("../../tests/golden/xml/related_by_hand.mime"),
        include_bytes!("../../tests/golden/xml/reply.mime"),
    ];
    all.into_iter()
        .flat_map(|file| {
            let start = memchr::memmem::find_iter(file, b"<parcel").map(|at| {
                let from = memchr::memmem::rfind(&file[..at], b"\n\n")
                    .or(memchr::memmem::rfind(&file[..at], b"\r\n\r\n").map(|at| at + 2))
                    .unwrap_or(0);
                let end =
                    memchr::memmem::find(&file[at..], b"</parcel>").map_or(file.len(), |end| at + end + 9);
                &file[if at - from < 80 { from + 2 } else { at }..end]
            });
            start.collect::<Vec<_>>()
        })
        .collect()
}

fn mutate(mut bytes: Vec<u8>, changes: &[(u8, Index, &'static str, Index)]) -> Vec<u8> {
    for (kind, at, piece, other) in changes {
        let at = at.index(bytes.len() + 1);
        let other = at + other.index(12).min(bytes.len() - at);
        match kind % 5 {
            0 => {
                bytes.splice(at..at, piece.bytes());
            }
            1 => {
                bytes.splice(at..other, piece.bytes());
            }
            2 => {
                bytes.drain(at..other);
            }
            3 => {
                let copy = bytes[at..other].to_vec();
                bytes.splice(at..at, copy);
            }
            _ => {
                if *kind > 200 {
                    bytes.truncate(at)
                } else if at < bytes.len() {
                    bytes[at] = *kind
                }
            }
        }
    }
    bytes
}

fn changes() -> impl Strategy<Value = Vec<(u8, Index, &'static str, Index)>> {
    vec(
        (any::<u8>(), any::<Index>(), select(PIECES), any::<Index>()),
        0..5,
    )
}

fn cases() -> u32 {
    std::env::var("VERSUS_CASES")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(3000)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(), max_shrink_iters: 20000, ..ProptestConfig::default() })]

    #[test]
    fn of_pieces(pieces in vec(select(PIECES), 0..16), frame in 0..5) {
        let body = pieces.concat();
        let text = match frame {
            0 => body,
            1 => format!("<parcel><id>7</id>{body}</parcel>"),
            2 => format!("<parcel><family>message</family><name>x</name><a>{body}</a></parcel>"),
            3 => format!("<parcel><family>message</family><name>x</name><content type=\"map\">{body}</content></parcel>"),
            _ => format!("<parcel><a{body}</a></parcel>"),
        };
        same(text.as_bytes());
    }

    #[test]
    fn of_golden_files(file in select(golden()), changes in changes()) {
        same(&mutate(file.to_vec(), &changes));
    }

    #[test]
    fn of_parcels(parcel in arbitrary::parcel(), changes in changes()) {
        let bytes = super::encode(&parcel).unwrap().to_vec();
        let start = memchr::memmem::find(&bytes, b"<parcel").unwrap();
        same(&mutate(bytes[start..].to_vec(), &changes));
    }
}

#[test]
fn of_all_short_texts() {
    let length: u32 = std::env::var("VERSUS_LENGTH")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(3);
    let alphabet = b"<>/\"'= a&;!?";
    for code in 0..12_u32.pow(length) {
        let mut rest = code;
        let body: String = (0..length)
            .map(|_| {
                let c = alphabet[(rest % 12) as usize];
                rest /= 12;
                char::from(c)
            })
            .collect();
        for text in [
            body.clone(),
            format!("<parcel>{body}"),
            format!("<parcel><a>{body}</a></parcel>"),
            format!("<parcel><a{body}></a></parcel>"),
            format!("<parcel><a type{body}\"int\">1</a></parcel>"),
            format!("<?xml {body}?><parcel/>"),
            format!("<?xml version{body}\"1.0\"?><parcel/>"),
            format!("<parcel><a>x</a{body}"),
        ] {
            same(text.as_bytes());
        }
    }
}

#[test]
fn golden_is_found() {
    assert!(golden().len() >= 7);
    for file in golden() {
        println!("{:?}", String::from_utf8_lossy(&file[..file.len().min(60)]));
    }
}
