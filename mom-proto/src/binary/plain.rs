//! A fast path for plain messages: read in place, and forwarded as a run.
//!
//! A fast peer repeats the same name and context with other content. The common part is decided once; each message
//! then costs its stamps and one copy of its content.

use bytes::Bytes;

use super::KIND_PARCEL;
use super::header::{
    CONTENT, CONTEXT_NUMBER, DELIVERY, ECHO, ID, NAME, PRIORITY, SENDER, TIMESTAMP, presence,
};
use super::wire::{put_name, put_varint, put_zigzag};
use crate::frame::Encoded;
use crate::{ContextNumber, MAX_ID, Parcel, Time, checksum};

/// The slots that a plain message may have.
const ALLOWED: u64 = bits(&[
    CONTEXT_NUMBER,
    NAME,
    TIMESTAMP,
    ID,
    CONTENT,
    PRIORITY,
    DELIVERY,
    ECHO,
]);
/// The required slots.
const NEEDED: u64 = bits(&[CONTEXT_NUMBER, NAME]);

const fn bits(slots: &[u32]) -> u64 {
    let (mut all, mut at) = (0, 0);
    while at < slots.len() {
        all |= 1 << slots[at];
        at += 1;
    }
    all
}

/// A whole frame with a message to all members of a context given by number, without slots that need a decision of
/// their own (address, fence, expiry, receipt, slots of applications).
#[derive(Clone, Copy, Debug)]
pub struct Plain<'a> {
    /// The whole frame.
    frame: &'a [u8],
    /// The context.
    number: ContextNumber,
    /// From the bitmap to the name.
    head: &'a [u8],
    /// The timestamp, as it stands there.
    timestamp: &'a [u8],
    /// The id, as it stands there.
    id: &'a [u8],
    /// What stands between id and content.
    tail: &'a [u8],
    content: &'a [u8],
}

impl<'a> Plain<'a> {
    /// Reads the front of `input`; none if that is not a complete frame, or needs the decoder.
    pub(super) fn look(input: &'a [u8]) -> Option<Plain<'a>> {
        let length = u32::from_be_bytes(*input.first_chunk::<4>()?) as usize;
        let frame = input.get(..length.checked_add(4)?)?;
        let mut rest = Rest { bytes: frame, at: 5 };
        if frame.get(4) != Some(&KIND_PARCEL) {
            return None;
        }
        let bits = rest.varint()?;
        if bits & !ALLOWED != 0 || bits & NEEDED != NEEDED {
            return None;
        }
        let has = |bit: u32| bits & (1 << bit) != 0;
        let number = rest.varint()?;
        let name = rest.varint()?;
        if name & 1 == 0 {
            rest.skip(usize::try_from(name >> 1).ok()?)?;
        }
        let head = &frame[5..rest.at];
        let timestamp = rest.skip(if has(TIMESTAMP) { 8 } else { 0 })?;
        let start = rest.at;
        if has(TIMESTAMP) {
            Time::from_micros(i64::from_be_bytes(*timestamp.first_chunk::<8>()?))?;
        }
        if has(ID) && rest.varint()? > MAX_ID {
            return None;
        }
        let id = &frame[start..rest.at];
        let start = rest.at;
        if has(PRIORITY) {
            rest.varint()?;
        }
        rest.skip(usize::from(has(DELIVERY)) + usize::from(has(ECHO)))?;
        let (tail, content) = (&frame[start..rest.at], &frame[rest.at..]);
        if !has(CONTENT) && !content.is_empty() {
            return None;
        }
        Some(Plain {
            frame,
            number: ContextNumber(number),
            head,
            timestamp,
            id,
            tail,
            content,
        })
    }

    /// The length of the frame in bytes.
    pub fn length(&self) -> usize {
        self.frame.len()
    }

    /// The context it is for.
    pub fn number(&self) -> ContextNumber {
        self.number
    }

    /// The bytes of its content.
    pub fn content_length(&self) -> usize {
        self.content.len()
    }

    /// When it was created, if it says so and that is a time.
    pub fn timestamp(&self) -> Option<Time> {
        let bytes = self.timestamp.first_chunk::<8>()?;
        Time::from_micros(i64::from_be_bytes(*bytes))
    }

    /// What stands for it in a [`Checksum`](crate::Checksum).
    pub fn checksum_word(&self) -> u32 {
        let mut id = Rest {
            bytes: self.id,
            at: 0,
        };
        checksum::word(id.varint())
    }

    /// The frame up to its content, to be decoded.
    pub(super) fn header(&self) -> Bytes {
        Bytes::copy_from_slice(&self.frame[4..self.frame.len() - self.content.len()])
    }
}

/// Reads on in a frame.
struct Rest<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Rest<'a> {
    fn varint(&mut self) -> Option<u64> {
        let mut number = 0;
        // Nine groups are enough for all that a plain message has; the decoder judges longer ones.
        for shift in (0..63).step_by(7) {
            let byte = *self.bytes.get(self.at)?;
            self.at += 1;
            number |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Some(number);
            }
        }
        None
    }

    fn skip(&mut self, length: usize) -> Option<&'a [u8]> {
        let end = self.at.checked_add(length)?;
        let skipped = self.bytes.get(self.at..end)?;
        self.at = end;
        Some(skipped)
    }
}

/// Outgoing messages of one peer that were admitted together: frames one after the other.
///
/// The first is admitted like any parcel; the others follow while they agree with it in everything that was decided.
#[derive(Debug)]
pub struct ParcelRun {
    /// What the messages have in common as they arrive.
    head: Vec<u8>,
    tail: Vec<u8>,
    /// And as they leave: before the timestamp, between id and age, after the age.
    prefix: Vec<u8>,
    middle: Vec<u8>,
    suffix: Vec<u8>,
    out: Vec<u8>,
    count: u32,
}

impl ParcelRun {
    /// A run that begins with `first`, of which `stamped` is what was admitted: without content, but with
    /// sender, time, age and fence. `room` is the expected size in bytes.
    pub fn begin(first: &Plain<'_>, stamped: &Parcel, room: usize) -> ParcelRun {
        let mut run = ParcelRun {
            head: first.head.to_vec(),
            tail: first.tail.to_vec(),
            prefix: Vec::with_capacity(64),
            middle: Vec::with_capacity(32),
            suffix: Vec::with_capacity(16),
            out: Vec::with_capacity(room),
            count: 0,
        };
        let content = first.head.first().is_some_and(|bits| bits & (1 << CONTENT) != 0);
        put_varint(&mut run.prefix, presence(stamped) | u64::from(content) << CONTENT);
        stamped
            .number
            .iter()
            .for_each(|number| put_varint(&mut run.prefix, number.0));
        put_name(&mut run.prefix, &stamped.name);
        stamped
            .sender
            .iter()
            .for_each(|sender| put_name(&mut run.prefix, sender));
        stamped
            .fence
            .iter()
            .for_each(|fence| put_varint(&mut run.middle, *fence));
        stamped
            .received
            .iter()
            .for_each(|time| run.middle.extend_from_slice(&time.micros().to_be_bytes()));
        stamped
            .age_error
            .iter()
            .for_each(|error| put_varint(&mut run.suffix, *error));
        stamped
            .priority
            .iter()
            .for_each(|priority| put_zigzag(&mut run.suffix, i64::from(*priority)));
        stamped
            .delivery
            .iter()
            .for_each(|delivery| run.suffix.push(*delivery as u8));
        stamped
            .echo
            .iter()
            .for_each(|echo| run.suffix.push(u8::from(*echo)));
        run
    }

    /// Whether this message agrees with the first in everything that was decided.
    pub fn takes(&self, plain: &Plain<'_>) -> bool {
        plain.head == self.head && plain.tail == self.tail
    }

    /// Adds a message of this age in µs.
    pub fn push(&mut self, plain: &Plain<'_>, age: i64) {
        let start = self.out.len();
        self.out.extend_from_slice(&[0, 0, 0, 0, KIND_PARCEL]);
        self.out.extend_from_slice(&self.prefix);
        self.out.extend_from_slice(plain.timestamp);
        self.out.extend_from_slice(plain.id);
        self.out.extend_from_slice(&self.middle);
        put_zigzag(&mut self.out, age);
        self.out.extend_from_slice(&self.suffix);
        self.out.extend_from_slice(plain.content);
        // A frame's length was a u32 when it came, and it grew by less than a name and four stamps.
        let length = u32::try_from(self.out.len() - start - 4).unwrap_or(u32::MAX);
        self.out[start..start + 4].copy_from_slice(&length.to_be_bytes());
        self.count += 1;
    }

    /// The bytes so far.
    pub fn length(&self) -> usize {
        self.out.len()
    }

    /// How many messages it has.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// All of its frames, one after the other.
    pub fn finish(self) -> Encoded {
        Encoded {
            head: self.out.into(),
            body: Bytes::new(),
        }
    }
}

/// The first frames of a run that together have at least `least` bytes, or all: their length and their count.
pub fn cut(run: &[u8], least: usize) -> (usize, u32) {
    let (mut at, mut count) = (0, 0);
    while at < least
        && let Some(length) = run[at..].first_chunk::<4>()
    {
        at += 4 + u32::from_be_bytes(*length) as usize;
        count += 1;
    }
    (at.min(run.len()), count)
}

/// The first frames of a run that lie whole in its first `most` bytes: their length and their count.
pub fn whole(run: &[u8], most: usize) -> (usize, u32) {
    let (mut at, mut count) = (0, 0);
    while let Some(length) = run.get(at..).and_then(<[u8]>::first_chunk::<4>) {
        let end = at + 4 + u32::from_be_bytes(*length) as usize;
        if end > most.min(run.len()) {
            break;
        }
        (at, count) = (end, count + 1);
    }
    (at, count)
}

/// What stands for the first frame of a run in a [`Checksum`](crate::Checksum).
pub fn checksum_word(run: &[u8]) -> u32 {
    let mut rest = Rest { bytes: run, at: 5 };
    let mut id = || {
        let bits = rest.varint()?;
        let has = |bit: u32| bits & (1 << bit) != 0;
        if has(CONTEXT_NUMBER) {
            rest.varint()?;
        }
        for _ in (NAME..=SENDER).filter(|bit| has(*bit)) {
            let name = rest.varint()?;
            if name & 1 == 0 {
                rest.skip(usize::try_from(name >> 1).ok()?)?;
            }
        }
        rest.skip(if has(TIMESTAMP) { 8 } else { 0 })?;
        has(ID).then(|| rest.varint()).flatten()
    };
    checksum::word(id())
}

/// The length of so many frames of a run from its beginning.
pub fn first(run: &[u8], count: u64) -> usize {
    let mut at = 0;
    for _ in 0..count {
        let Some(length) = run.get(at..).and_then(<[u8]>::first_chunk::<4>) else {
            break;
        };
        at += 4 + u32::from_be_bytes(*length) as usize;
    }
    at.min(run.len())
}

#[cfg(test)]
mod tests {
    use bytes::{Buf, BytesMut};
    use proptest::prelude::*;

    use super::*;
    use crate::binary::{BinaryDecoder, PREFACE};
    use crate::codec::{Form, Frame};
    use crate::{Delivery, Family, Limit, Limits, Value};

    fn decoder() -> (BinaryDecoder, BytesMut) {
        (
            BinaryDecoder::new(&Limits::default()),
            BytesMut::from(&PREFACE[..]),
        )
    }

    fn decode(frames: &[u8]) -> Vec<Parcel> {
        let (mut decoder, mut input) = decoder();
        input.extend_from_slice(frames);
        let next = || match decoder.decode(&mut input).expect("healthy frames") {
            Some(Frame::Parcel(parcel)) => Some(*parcel),
            Some(Frame::Malformed { error, .. }) => panic!("{error}"),
            None => None,
        };
        std::iter::from_fn(next).collect()
    }

    /// Messages of one name, with and without each slot that may vary.
    fn messages() -> impl Strategy<Value = Vec<Parcel>> {
        let common = (
            prop_oneof!["[a-z]{1,9}", Just("command".to_owned())],
            1_u64..1 << 40,
            proptest::option::of(-200..200_i32),
            proptest::option::of(prop_oneof![Just(Delivery::Reliable), Just(Delivery::Fleeting)]),
            proptest::option::of(any::<bool>()),
            any::<(bool, bool, bool)>(),
        );
        let own = (
            0..1_i64 << 50,
            0..MAX_ID,
            proptest::collection::vec(any::<u8>(), 0..300),
        );
        (common, proptest::collection::vec(own, 1..20)).prop_map(|(common, own)| {
            let (name, number, priority, delivery, echo, (stamped, counted, filled)) = common;
            let message = |(time, id, content): (i64, u64, Vec<u8>)| {
                let mut parcel = Parcel::new(Family::Message, name.as_str());
                parcel.number = Some(ContextNumber(number));
                parcel.priority = priority;
                parcel.delivery = delivery;
                parcel.echo = echo;
                parcel.timestamp = stamped.then(|| Time::from_micros(time)).flatten();
                parcel.id = counted.then_some(id);
                match filled {
                    true => parcel.content(Value::from(Bytes::from(content))),
                    false => parcel,
                }
            };
            own.into_iter().map(message).collect()
        })
    }

    fn stamp(parcel: &mut Parcel, guarded: bool) {
        parcel.sender = Some("sender~2".into());
        parcel.received = Time::from_micros(77);
        parcel.age = Some(-5);
        parcel.age_error = guarded.then_some(300);
        parcel.fence = guarded.then_some(1 << 44);
        parcel.priority = parcel.priority.map(|priority| priority.clamp(-100, 100));
    }

    proptest! {
        /// A run equals the messages decoded, stamped and encoded one by one.
        #[test]
        fn a_run_says_what_its_messages_say(messages in messages(), guarded: bool) {
            let mut input: Vec<u8> = Vec::new();
            let mut expected = Vec::new();
            for message in &messages {
                input.extend_from_slice(&Form::Binary.encode(message).unwrap().to_vec());
                let mut stamped = message.clone();
                stamp(&mut stamped, guarded);
                expected.extend_from_slice(&Form::Binary.encode(&stamped).unwrap().to_vec());
            }
            let (mut decoder, mut greeting) = decoder();
            decoder.decode(&mut greeting).unwrap();
            let mut rest = &input[..];
            let (mut run, mut words) = (None, Vec::new());
            while let Some(plain) = decoder.plain(rest) {
                let mut stamped = decoder.head(&plain).expect("plain messages are decoded");
                stamp(&mut stamped, guarded);
                let run = run.get_or_insert_with(|| ParcelRun::begin(&plain, &stamped, 0));
                prop_assert!(run.takes(&plain));
                run.push(&plain, -5);
                words.push(plain.checksum_word());
                rest.advance(plain.length());
            }
            prop_assert!(rest.is_empty(), "all of them are plain");
            let run = run.expect("at least one");
            prop_assert_eq!(run.count() as usize, messages.len());
            let frames = run.finish().to_vec();
            prop_assert_eq!(decode(&frames), decode(&expected));
            let said: Vec<u32> = messages.iter().map(Parcel::checksum_word).collect();
            let left: Vec<u32> = (0..said.len() as u64)
                .map(|place| checksum_word(&frames[first(&frames, place)..]))
                .collect();
            prop_assert_eq!(left, &said[..]);
            prop_assert_eq!(words, said);
            prop_assert_eq!(frames, expected);
        }

        /// For any input: a plain message is one that the decoder reads as a message without other slots.
        #[test]
        fn what_is_plain_is_healthy(frame in proptest::collection::vec(any::<u8>(), 0..60), change in any::<(u8, u8)>()) {
            let parcel = Parcel::new(Family::Message, "command").id(7).content("grip");
            let mut healthy = Form::Binary.encode(&Parcel { number: Some(ContextNumber(3)), ..parcel }).unwrap().to_vec();
            let at = usize::from(change.0) % healthy.len();
            healthy[at] = change.1;
            for bytes in [&frame, &healthy] {
                let (mut decoder, mut input) = decoder();
                decoder.decode(&mut input).unwrap();
                let Some(plain) = decoder.plain(bytes) else { continue };
                let Some(head) = decoder.head(&plain) else { continue };
                let decoded = decode(&bytes[..plain.length()]).remove(0);
                prop_assert_eq!(&head.name, &decoded.name);
                prop_assert_eq!(head.timestamp, plain.timestamp());
                prop_assert_eq!(decoded.content.map_or(0, |content| content.size()), plain.content_length());
                prop_assert_eq!(decoded.fence, None);
            }
        }
    }

    #[test]
    fn what_differs_in_what_was_decided_ends_a_run() {
        let frame = |parcel: Parcel| {
            let parcel = Parcel {
                number: Some(ContextNumber(3)),
                ..parcel
            };
            Form::Binary.encode(&parcel).unwrap().to_vec()
        };
        let message = |name: &str| Parcel::new(Family::Message, name).id(1).content("x");
        let (mut decoder, mut greeting) = decoder();
        decoder.decode(&mut greeting).unwrap();
        let first = frame(message("state"));
        let plain = decoder.plain(&first).unwrap();
        let stamped = decoder.head(&plain).unwrap();
        let run = ParcelRun::begin(&plain, &stamped, 100);
        assert!(run.takes(&decoder.plain(&frame(message("state").id(900))).unwrap()));
        let urgent = Parcel {
            priority: Some(1),
            ..message("state")
        };
        for other in [
            message("command"),
            urgent,
            Parcel {
                content: None,
                ..message("state")
            },
        ] {
            assert!(!run.takes(&decoder.plain(&frame(other)).unwrap()));
        }
        for special in [
            Parcel {
                fence: Some(1),
                ..message("state")
            },
            Parcel {
                expires: Some(1),
                ..message("state")
            },
            Parcel {
                receipt: Some(true),
                ..message("state")
            },
            Parcel {
                address: Some(vec!["bob".into()]),
                ..message("state")
            },
            Parcel {
                family: Family::Token,
                ..message("grab")
            },
        ] {
            assert!(decoder.plain(&frame(special)).is_none());
        }
        assert!(
            decoder.plain(&first[..first.len() - 1]).is_none(),
            "not all of it is here"
        );
    }
    fn numbered(parcel: Parcel) -> Vec<u8> {
        let number = Some(ContextNumber(3));
        Form::Binary
            .encode(&Parcel { number, ..parcel })
            .unwrap()
            .to_vec()
    }

    #[test]
    fn a_plain_message_is_within_the_limits_and_its_id_too() {
        let message = |id| numbered(Parcel::new(Family::Message, "state").id(id).content("x"));
        let is_plain = |frame: &[u8], parcel: u64| {
            let mut decoder = BinaryDecoder::new(&Limits {
                parcel: Limit::At(parcel),
                ..Limits::default()
            });
            decoder.decode(&mut BytesMut::from(&PREFACE[..])).unwrap();
            decoder.plain(frame).is_some()
        };
        let frame = message(7);
        let length = frame.len() as u64 - 4;
        assert!(is_plain(&frame, length) && !is_plain(&frame, length - 1));
        assert!(is_plain(&message(MAX_ID), 100));
        assert!(!is_plain(&message(MAX_ID + 1), 100));
        let decoder = BinaryDecoder::new(&Limits::default());
        assert!(decoder.plain(&frame).is_none(), "the preface comes first");
    }

    #[test]
    fn the_head_of_a_plain_message_has_no_content() {
        let (mut decoder, mut greeting) = decoder();
        decoder.decode(&mut greeting).unwrap();
        let frame = numbered(Parcel::new(Family::Message, "state").id(7).content("x"));
        let plain = decoder.plain(&frame).unwrap();
        let head = decoder.head(&plain).unwrap();
        assert_eq!(
            (head.content.is_none(), head.id, &*head.name),
            (true, Some(7), "state")
        );
    }

    #[test]
    fn a_run_is_cut_between_frames() {
        let frame = |length: u32| [&length.to_be_bytes()[..], &vec![7; length as usize]].concat();
        let run = [frame(1), frame(6), frame(11)].concat();
        for (least, length, count) in [
            (0, 0, 0),
            (1, 5, 1),
            (5, 5, 1),
            (6, 15, 2),
            (15, 15, 2),
            (16, 30, 3),
            (30, 30, 3),
            (1000, 30, 3),
        ] {
            assert_eq!(cut(&run, least), (length, count), "{least}");
        }
        assert_eq!(cut(&[], 1), (0, 0));
    }
}
