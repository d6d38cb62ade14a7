//! Contents of all kinds and sizes, right and wrong.

use bytes::Bytes;
use mom_proto::codec::Form;
use mom_proto::{Content, Map, Packed, Time, Value};

use super::Mind;
use super::chance::{MOST, size};

/// What a content is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Null,
    Bool,
    Int,
    Time,
    Text,
    Binary,
    List,
    Tree,
    Doubles,
    Nils,
    Keys,
    Deep,
    NoValue,
    Packed,
}

impl Kind {
    pub(super) const ALL: [Kind; 14] = [
        Kind::Null,
        Kind::Bool,
        Kind::Int,
        Kind::Time,
        Kind::Text,
        Kind::Binary,
        Kind::List,
        Kind::Tree,
        Kind::Doubles,
        Kind::Nils,
        Kind::Keys,
        Kind::Deep,
        Kind::NoValue,
        Kind::Packed,
    ];
}

/// What the generator itself opens to write it as text is no larger than this many values: it has a bound, too.
const OPENED: usize = 64 * 1024;

impl Mind {
    /// Any content, for a peer of this form.
    pub(super) fn content(&mut self, form: Form) -> Content {
        let kind = self.kinds.draw(&mut self.rng);
        let size = size(&mut self.rng);
        self.content_of(kind, size, form)
    }

    fn content_of(&mut self, kind: Kind, size: usize, form: Form) -> Content {
        let most = if form.is_binary() { MOST } else { OPENED };
        match kind {
            Kind::Null => Value::Null.into(),
            Kind::Bool => self.rng.bool().into(),
            Kind::Int => self.int().into(),
            Kind::Time => self.time().into(),
            Kind::Text => self.text(size).into(),
            Kind::Binary => Value::Binary(vec![self.rng.u8(..); size].into()).into(),
            Kind::List => Value::List(vec![Value::Int(7); (size / 8).min(OPENED)]).into(),
            Kind::Tree => self.tree(3).into(),
            Kind::Doubles => {
                let some = self.rng.f64();
                let numbers = (0..(size / 9).min(OPENED)).map(|at| Value::Double(some + at as f64));
                Value::List(numbers.collect()).into()
            }
            Kind::Nils => encoded(&[0xdd], size.min(most), &[0xc0]),
            Kind::Keys => keys((size / 8).min(most / 64)),
            Kind::Deep => encoded_deep(size.min(self.rng.usize(..200_000))),
            // More than one, none, an extension that nobody knows, text that is not UTF-8, and less than announced.
            Kind::NoValue => {
                let wrong: [&[u8]; 6] = [
                    &[0xc0, 0xc0],
                    &[],
                    &[0xc7, 4, 99, 1, 2, 3, 4],
                    &[0xa2, 0xff, 0xfe],
                    &[0xdd, 0xff, 0xff, 0xff, 0xff],
                    &[0xc1],
                ];
                Content::Encoded(Bytes::copy_from_slice(wrong[self.rng.usize(..wrong.len())]))
            }
            Kind::Packed => {
                let plain = Content::from(Value::from("pack ".repeat(size / 5)));
                let packed = plain.to_msgpack().ok();
                match packed.and_then(|bytes| Packed::pack(&bytes)) {
                    Some(packed) => Content::Packed(packed),
                    None => plain,
                }
            }
        }
    }

    /// An int of every order.
    pub(super) fn int(&mut self) -> i64 {
        let any = self.rng.i64(..);
        any >> self.rng.u32(0..64)
    }

    /// About now, or any.
    pub(super) fn time(&mut self) -> Time {
        let since = std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default();
        let now = i64::try_from(since.as_micros()).unwrap_or_default();
        let moved = match self.rng.u8(..4) {
            0 => self.int(),
            _ => self.rng.i64(-2_000_000..2_000_000),
        };
        Time::from_micros(now.saturating_add(moved)).unwrap_or_default()
    }

    /// Text of so many bytes, or a few less.
    pub(super) fn text(&mut self, size: usize) -> String {
        let words = [
            "x",
            "é<&>",
            "]]>\"'",
            "\r\n\t",
            "\u{10ffff}",
            "日本",
            "{\"$int\":",
            " ",
        ];
        let word = words[self.rng.usize(..words.len())];
        word.repeat(size / word.len())
    }

    fn tree(&mut self, depth: usize) -> Value {
        let small = size(&mut self.rng).min(1 << 16);
        match self.rng.u8(..8) {
            0 => Value::Null,
            1 => self.int().into(),
            2 => Value::Double(self.rng.f64()),
            3 => self.text(small).into(),
            4 => Value::Binary(vec![self.rng.u8(..); small].into()),
            5 if depth > 0 => (0..self.rng.usize(0..8))
                .map(|_| self.tree(depth - 1))
                .collect::<Vec<_>>()
                .into(),
            _ if depth > 0 => {
                let mut map = Map::new();
                for _ in 0..self.rng.usize(0..8) {
                    let key = self.key();
                    map.set(&key, self.tree(depth - 1));
                }
                map.into()
            }
            _ => true.into(),
        }
    }

    /// A key, some of them with a meaning in one of the forms.
    pub(super) fn key(&mut self) -> String {
        let keys = [
            "a", "b", "slot", "xml:c", "$int", "$map", "item", "ключ", " e", "stop", "fence", "content",
        ];
        match self.rng.usize(..keys.len() + 2) {
            at if at < keys.len() => keys[at].to_owned(),
            at if at == keys.len() => String::new(),
            _ => format!("k{}", self.rng.u16(..)),
        }
    }
}

/// A list or map of so many of the same, already encoded: as values it would be 32 times as large.
fn encoded(head: &[u8], count: usize, each: &[u8]) -> Content {
    let count = count.min(MOST);
    let number = u32::try_from(count).unwrap_or(u32::MAX).to_be_bytes();
    Content::Encoded([head, &number, &each.repeat(count)].concat().into())
}

fn keys(count: usize) -> Content {
    let mut bytes = vec![0xdf];
    bytes.extend(u32::try_from(count).unwrap_or(u32::MAX).to_be_bytes());
    for key in 0..u32::try_from(count).unwrap_or(u32::MAX) {
        bytes.push(0xa7);
        bytes.extend(format!("{:07}", key % 10_000_000).bytes());
        bytes.push(0xc0);
    }
    Content::Encoded(bytes.into())
}

fn encoded_deep(depth: usize) -> Content {
    let mut bytes = vec![0x91; depth];
    bytes.push(0xc0);
    Content::Encoded(bytes.into())
}
