//! zenoh 1.x: batches with a length before them, frames with numbers in them, messages in those; large messages in
//! fragments. Numbers are of seven bits a byte, the lowest first.

mod scan;

use std::ops::Range;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Instant;

use mom_benches::{Batching, Driver, Error, Link, Message, NUMBER, PATIENCE, Scan, Scanner, Template, Topic};

use scan::{Bytes, ZenohScanner};

const VERSION: u8 = 0x09;
/// What a message is, in the low five bits of its first byte.
const KIND: u8 = 0x1f;
const INIT: u8 = 0x01;
const OPEN: u8 = 0x02;
const CLOSE: u8 = 0x03;
const KEEP_ALIVE: u8 = 0x04;
const FRAME: u8 = 0x05;
const FRAGMENT: u8 = 0x06;
const INTEREST: u8 = 0x19;
const PUSH: u8 = 0x1d;
const DECLARE: u8 = 0x1e;
const DECLARE_KEY: u8 = 0x00;
const FORGET_KEY: u8 = 0x01;
const DECLARE_SUBSCRIBER: u8 = 0x02;
const LAST_DECLARATION: u8 = 0x07;
const FINAL: u8 = 0x1a;
const PUT: u8 = 0x01;
const TOKENS: u8 = 0x08;
/// Flags, which mean different things in different messages.
const F5: u8 = 0x20;
const F6: u8 = 0x40;
const EXTENDED: u8 = 0x80;

/// Priorities, and what they are joined with: never drop, do not wait for more.
const REAL_TIME: u8 = 1;
const DATA: u8 = 5;
const KEEP: u8 = 0x08;
const EXPRESS: u8 = 0x10;

/// No batch is larger: what zenohd says that it takes.
const BATCH: usize = 49_152;
/// Frames of data are numbered from here on, behind those of the greeting.
const FIRST: u32 = 1000;

/// Drives zenohd, as a client of it.
#[derive(Debug)]
pub struct ZenohDriver {
    address: String,
    /// Every client has its own name.
    clients: AtomicU64,
}

impl ZenohDriver {
    /// A driver for a router at this address.
    pub fn new(address: &str) -> ZenohDriver {
        ZenohDriver {
            address: address.to_owned(),
            clients: AtomicU64::new(1),
        }
    }

    /// The greeting: both tell who they are, a cookie goes there and back.
    fn open(&self) -> Result<Link, Error> {
        let mut link = Link::connect(&self.address)?;
        let number = self.clients.fetch_add(1, Ordering::Relaxed);
        let pair = [number, u64::from(std::process::id()) << 32 | 1];
        let mut hello = vec![INIT | EXTENDED, VERSION, 0xf2];
        hello.extend(pair.iter().flat_map(|half| half.to_le_bytes()));
        // The one extension: priorities.
        hello.push(0x01);
        send(&mut link, &hello)?;
        let answer = batch(&mut link)?;
        let mut rest = Bytes(&answer);
        let head = rest.byte().ok_or_else(broken)?;
        if head & (KIND | F5) != INIT | F5 {
            return Err(Error::Unexpected(format!("{answer:?} in place of a greeting")));
        }
        rest.skip(1).ok_or_else(broken)?;
        let name = usize::from(rest.byte().ok_or_else(broken)? >> 4) + 1;
        rest.skip(name).ok_or_else(broken)?;
        if head & F6 != 0 {
            rest.skip(1).ok_or_else(broken)?;
            let low = rest.byte().ok_or_else(broken)?;
            let size = u16::from_le_bytes([low, rest.byte().ok_or_else(broken)?]);
            if usize::from(size) < BATCH {
                return Err(Error::Unexpected(format!("batches of {size} bytes at most")));
            }
        }
        let length = rest.length().ok_or_else(broken)?;
        let cookie = rest.take(length).ok_or_else(broken)?;
        // The router may wait an hour for a sign of life; frames are numbered from 0.
        let mut open = vec![OPEN | F6];
        put(&mut open, 3600);
        put(&mut open, 0);
        put(&mut open, cookie.len() as u64);
        open.extend_from_slice(cookie);
        send(&mut link, &open)?;
        match batch(&mut link)?.first() {
            Some(head) if head & KIND == OPEN => Ok(link),
            other => Err(Error::Unexpected(format!("{other:?} in place of an opening"))),
        }
    }
}

fn broken() -> Error {
    Error::Unexpected("a message that ends too early".to_owned())
}

fn send(link: &mut Link, message: &[u8]) -> Result<(), Error> {
    let length = u16::try_from(message.len()).map_err(|_| broken())?;
    link.write(&[&length.to_le_bytes()[..], message].concat())
}

fn batch(link: &mut Link) -> Result<Vec<u8>, Error> {
    loop {
        if let Some((length, rest)) = link.received.split_first_chunk::<2>() {
            let length = usize::from(u16::from_le_bytes(*length));
            if rest.len() >= length {
                return Ok(link.received.drain(..2 + length).skip(2).collect());
            }
        }
        link.receive()?;
    }
}

fn put(out: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        out.push(number as u8 | 0x80);
        number >>= 7;
    }
    out.push(number as u8);
}

/// The number by which a client names a topic's key.
fn key(topic: Topic) -> u64 {
    topic as u64 + 1
}

fn expression(out: &mut Vec<u8>, topic: Topic) {
    put(out, 0);
    put(out, topic.word().len() as u64);
    out.extend_from_slice(topic.word().as_bytes());
}

impl Driver for ZenohDriver {
    fn connect(&self, hears: &[Topic], says: &[Topic]) -> Result<Link, Error> {
        let mut link = self.open()?;
        let mut frame = vec![FRAME | F5, 0];
        for topic in says {
            frame.extend_from_slice(&[DECLARE, DECLARE_KEY | F5]);
            put(&mut frame, key(*topic));
            expression(&mut frame, *topic);
        }
        for topic in hears {
            frame.extend_from_slice(&[DECLARE, DECLARE_SUBSCRIBER | F5 | F6]);
            put(&mut frame, key(*topic));
            expression(&mut frame, *topic);
        }
        // Asking for the tokens of now, of which there are none: the end of the answer says that the router knows the
        // above.
        frame.extend_from_slice(&[INTEREST | F5, 1, TOKENS]);
        send(&mut link, &frame)?;
        let mut scanner = ZenohScanner::new();
        let mut used = 0;
        let start = Instant::now();
        while start.elapsed() < PATIENCE {
            match scanner.scan(&link.received[used..])? {
                Scan::Other(length) => used += length,
                Scan::Incomplete => {
                    link.receive()?;
                }
                other => return Err(Error::Unexpected(format!("{other:?} in a greeting"))),
            }
            if scanner.answered && scanner.left == 0 {
                link.received.drain(..used);
                return Ok(link);
            }
        }
        Err(Error::Stalled {
            what: "the greeting".to_owned(),
            after: PATIENCE,
        })
    }

    fn template(&self, message: Message) -> Result<Template, Error> {
        let quality = match message.topic {
            Topic::Stop => REAL_TIME | KEEP | EXPRESS,
            Topic::Image => DATA,
            _ => DATA | KEEP,
        };
        let mut before = vec![PUSH | F6 | EXTENDED];
        put(&mut before, key(message.topic));
        before.extend_from_slice(&[0x21, quality, PUT]);
        put(&mut before, message.payload.max(NUMBER) as u64);
        let template = Template::around(&before, message.payload, &[]);
        Ok(template.batched(ZenohBatching {
            next: AtomicU32::new(FIRST),
            priority: quality & 0x07,
        }))
    }

    fn scanner(&self) -> Box<dyn Scanner> {
        Box::new(ZenohScanner::new())
    }

    fn echoes(&self) -> bool {
        false
    }
}

/// Puts messages into frames and those into batches, as many as fit, as its own library does.
#[derive(Debug)]
struct ZenohBatching {
    /// The number of the next frame; gaps are allowed, so that connections may share it.
    next: AtomicU32,
    priority: u8,
}

impl Batching for ZenohBatching {
    fn append_all(&self, template: &Template, numbers: Range<u32>, out: &mut Vec<u8>) {
        let size = template.size();
        let room = BATCH - 16;
        if size > room {
            let mut whole = Vec::with_capacity(size);
            for number in numbers {
                whole.clear();
                template.append(number, &mut whole);
                let last = whole.chunks(room).count() - 1;
                for (index, piece) in whole.chunks(room).enumerate() {
                    let more = if index < last { F6 } else { 0 };
                    let start = self.begin(FRAGMENT | more, out);
                    out.extend_from_slice(piece);
                    end(start, out);
                }
            }
            return;
        }
        let many = u32::try_from(room / size).unwrap_or(1);
        let mut first = numbers.start;
        while first < numbers.end {
            let after = numbers.end.min(first.saturating_add(many));
            let start = self.begin(FRAME, out);
            (first..after).for_each(|number| template.append(number, out));
            end(start, out);
            first = after;
        }
    }
}

impl ZenohBatching {
    /// The head of a batch with one frame or fragment; gives where the batch begins.
    fn begin(&self, kind: u8, out: &mut Vec<u8>) -> usize {
        let start = out.len();
        let default = self.priority == DATA;
        out.extend_from_slice(&[0, 0, kind | F5 | if default { 0 } else { EXTENDED }]);
        // Always four bytes: the upper ones may be empty.
        let number = self.next.fetch_add(1, Ordering::Relaxed) % (1 << 28);
        let bytes = [0, 7, 14, 21].map(|shift| (number >> shift) as u8 & 0x7f | 0x80);
        out.extend_from_slice(&bytes[..3]);
        out.push(bytes[3] & 0x7f);
        if !default {
            out.extend_from_slice(&[0x31, self.priority]);
        }
        start
    }
}

fn end(start: usize, out: &mut [u8]) {
    let length = u16::try_from(out.len() - start - 2).expect("a batch holds no more than it may");
    out[start..start + 2].copy_from_slice(&length.to_le_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(bytes: &[u8]) -> Vec<u32> {
        let mut scanner = ZenohScanner::new();
        let (mut used, mut found) = (0, Vec::new());
        loop {
            match scanner.scan(&bytes[used..]).unwrap() {
                Scan::Incomplete => break,
                Scan::Other(length) => used += length,
                Scan::Parcel(length, number) => {
                    used += length;
                    found.push(number);
                }
                Scan::Dropped(..) => panic!("nobody said so"),
            }
        }
        assert_eq!((used, scanner.left), (bytes.len(), 0));
        found
    }

    #[test]
    fn small_and_large_messages_are_found() {
        let driver = ZenohDriver::new("127.0.0.1:1");
        for payload in [16, 1000, 65_000, 65_520, 300_000] {
            let mut bytes = Vec::new();
            let template = driver.template(Message::forth(payload)).unwrap();
            template.append_all(3..103, &mut bytes);
            assert_eq!(numbers(&bytes), (3..103).collect::<Vec<_>>(), "{payload}");
        }
    }

    #[test]
    fn other_messages_are_passed_over() {
        let mut bytes = vec![1, 0, KEEP_ALIVE];
        let mut frame = vec![FRAME | F5, 5, DECLARE, DECLARE_KEY | F5, 1, 0, 5];
        frame.extend_from_slice(b"forth");
        frame.extend_from_slice(&[DECLARE | F5, 1, FINAL]);
        bytes.extend_from_slice(&u16::try_from(frame.len()).unwrap().to_le_bytes());
        bytes.extend_from_slice(&frame);
        assert!(numbers(&bytes).is_empty());
        assert!(
            ZenohScanner::new()
                .scan(&[9, 0, 1])
                .is_ok_and(|scan| scan == Scan::Incomplete)
        );
    }
}
