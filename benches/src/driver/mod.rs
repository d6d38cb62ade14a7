//! The drivers: how a protocol's peers connect, what they send, how they find parcels in what they receive.

mod mom;
mod mom_scan;
mod relay;

use std::fmt::Debug;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

pub use mom::MomDriver;
pub use relay::RelayDriver;

use crate::Error;

/// How long a measurement waits for its hub; what has not come by then is lost.
pub const PATIENCE: Duration = Duration::from_secs(5);

/// What peers of a measurement talk about. A protocol without subjects has one for all, and every peer hears it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topic {
    /// Streams, and the way there of round trips.
    Forth,
    /// The way back.
    Back,
    /// A camera's frames: only the newest is worth anything.
    Image,
    /// What must not wait.
    Stop,
    /// Commands that need a token, where the protocol knows such a thing.
    Command,
    /// What has to reach everybody and may come late: its sender waits, where the hub can have it wait.
    Bulk,
}

impl Topic {
    /// All of them.
    pub const ALL: [Topic; 6] = [
        Topic::Forth,
        Topic::Back,
        Topic::Image,
        Topic::Stop,
        Topic::Command,
        Topic::Bulk,
    ];

    /// A word for it, good as a subject in any protocol; all have the same length.
    pub fn word(self) -> &'static str {
        match self {
            Topic::Forth => "forth",
            Topic::Back => "backs",
            Topic::Image => "image",
            Topic::Stop => "stops",
            Topic::Command => "comma",
            Topic::Bulk => "bulks",
        }
    }
}

/// The kind of parcels that a template makes.
#[derive(Clone, Copy, Debug)]
pub struct Message {
    /// What they are about.
    pub topic: Topic,
    /// Bytes of payload; at least eight, for the number.
    pub payload: usize,
    /// Whether a sender that hears the topic hears itself, where the protocol leaves the choice.
    pub echo: bool,
}

impl Message {
    /// On the topic of streams, without an echo.
    pub fn forth(payload: usize) -> Message {
        Message {
            topic: Topic::Forth,
            payload,
            echo: false,
        }
    }
}

/// Speaks one protocol as raw bytes: no client library, nothing encoded while the clock runs.
pub trait Driver: Send + Sync {
    /// Connects a peer that from now on hears whatever others send on the topics of `hears`, and may send on
    /// those of `says`.
    ///
    /// # Errors
    /// A link that cannot be had, or a refusal.
    fn connect(&self, hears: &[Topic], says: &[Topic]) -> Result<Link, Error>;

    /// A frame of this kind, ready to be numbered.
    ///
    /// # Errors
    /// A size that the protocol cannot carry.
    fn template(&self, message: Message) -> Result<Template, Error>;

    /// Finds parcels made from templates of this driver in a receiver's bytes.
    fn scanner(&self) -> Box<dyn Scanner>;

    /// Whether a peer hears itself whatever it asks for, so that a task has to read that.
    fn reflects(&self) -> bool {
        false
    }

    /// Whether a peer that wants to can hear itself by way of the hub.
    fn echoes(&self) -> bool {
        true
    }
}

/// A connected peer.
#[derive(Debug)]
pub struct Link {
    /// Its socket, blocking, without delay.
    pub stream: TcpStream,
    /// What was received beyond the greeting.
    pub received: Vec<u8>,
}

impl Link {
    /// Connects to this address; a read or a write gives up after [`PATIENCE`].
    ///
    /// # Errors
    /// Nobody who listens there.
    pub fn connect(address: &str) -> Result<Link, Error> {
        let stream = TcpStream::connect(address).map_err(Error::io(format!("connect to {address}")))?;
        let set = || {
            stream.set_nodelay(true)?;
            stream.set_read_timeout(Some(PATIENCE))?;
            stream.set_write_timeout(Some(PATIENCE))
        };
        set().map_err(Error::io("socket options"))?;
        Ok(Link {
            stream,
            received: Vec::new(),
        })
    }

    /// The same connection once more.
    ///
    /// # Errors
    /// A socket that cannot be shared.
    pub fn second(&self) -> Result<Link, Error> {
        let stream = self.stream.try_clone().map_err(Error::io("a second handle"))?;
        Ok(Link {
            stream,
            received: Vec::new(),
        })
    }

    /// Writes all of this.
    ///
    /// # Errors
    /// A connection that is closed, or a hub that takes nothing for as long as [`PATIENCE`].
    pub fn write(&mut self, bytes: &[u8]) -> Result<(), Error> {
        self.stream.write_all(bytes).map_err(Error::io("write"))
    }

    /// Reads something more from the socket; gives what is new.
    ///
    /// # Errors
    /// A connection that is closed, or a hub that says nothing for as long as [`PATIENCE`].
    pub fn receive(&mut self) -> Result<&[u8], Error> {
        let mut chunk = [0; 4096];
        let length = self.stream.read(&mut chunk).map_err(Error::io("read"))?;
        if length == 0 {
            return Err(Error::Unexpected("the end of the connection".to_owned()));
        }
        let before = self.received.len();
        self.received.extend_from_slice(&chunk[..length]);
        Ok(&self.received[before..])
    }
}

/// Finds parcels in received bytes.
pub trait Scanner: Send {
    /// Looks at the first frame in `bytes`.
    ///
    /// # Errors
    /// A refusal or a loss that the hub tells of, or bytes that are no frame.
    fn scan(&mut self, bytes: &[u8]) -> Result<Scan, Error>;
}

/// What a scanner found at the front.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scan {
    /// Not all of a frame.
    Incomplete,
    /// A frame of this length that is not a parcel of the workload.
    Other(usize),
    /// A frame of this length with a parcel of this number, or with the end of one.
    Parcel(usize, u32),
    /// A frame of this length in which the hub says that so many parcels were dropped.
    Dropped(usize, u64),
}

/// An encoded frame whose number can be changed in place.
///
/// The number is eight letters, four bits each, so that every protocol can carry it, text or not.
///
/// ```
/// use mom_benches::Template;
/// let template = Template::new(b"<12345678>".to_vec(), 1);
/// let mut out = Vec::new();
/// template.append(0xab, &mut out);
/// assert_eq!(out, b"<aaaaaakl>");
/// assert_eq!(Template::number(&out[1..]), Some(0xab));
/// ```
#[derive(Clone, Debug)]
pub struct Template {
    frame: Vec<u8>,
    number_at: usize,
    /// Where the time of sending goes, µs since 1970 in eight bytes, if it is not the template's own.
    stamp_at: Option<usize>,
    /// What goes around many frames, in a protocol that has that.
    batching: Option<Arc<dyn Batching>>,
}

/// What a protocol puts around many frames that are sent at once.
pub trait Batching: Debug + Send + Sync {
    /// Appends the frames of a template with all these numbers, and what goes around them.
    fn append_all(&self, template: &Template, numbers: Range<u32>, out: &mut Vec<u8>);
}

/// The bytes that a parcel's number takes.
pub const NUMBER: usize = 8;

impl Template {
    /// A frame with room for a number at this place.
    ///
    /// # Panics
    /// If the place is not inside the frame.
    pub fn new(frame: Vec<u8>, number_at: usize) -> Template {
        assert!(
            number_at + NUMBER <= frame.len(),
            "a frame has room for its number"
        );
        Template {
            frame,
            number_at,
            stamp_at: None,
            batching: None,
        }
    }

    /// The frame of a payload of so many bytes between what comes before and after it; the number ends the payload,
    /// so that who has read it has read all.
    pub fn around(before: &[u8], payload: usize, after: &[u8]) -> Template {
        let payload = payload.max(NUMBER);
        let mut frame = before.to_vec();
        frame.resize(before.len() + payload, b'.');
        frame.extend_from_slice(after);
        Template::new(frame, before.len() + payload - NUMBER)
    }

    /// With the time of sending at this place of each frame.
    pub(crate) fn stamped(mut self, at: usize) -> Template {
        assert!(at + 8 <= self.number_at, "a stamp stands before the payload");
        self.stamp_at = Some(at);
        self
    }

    /// With what the protocol puts around many frames at once.
    #[must_use]
    pub fn batched(mut self, batching: impl Batching + 'static) -> Template {
        self.batching = Some(Arc::new(batching));
        self
    }

    /// The frame's size on the wire.
    pub fn size(&self) -> usize {
        self.frame.len()
    }

    /// Appends the frame with this number, alone.
    pub fn append(&self, number: u32, out: &mut Vec<u8>) {
        let start = out.len();
        out.extend_from_slice(&self.frame);
        let at = start + self.number_at;
        out[at..at + NUMBER].copy_from_slice(&letters(number));
        if let Some(at) = self.stamp_at {
            let at = start + at;
            out[at..at + 8].copy_from_slice(&now().to_be_bytes());
        }
    }

    /// Appends the frames of all these numbers, with whatever the protocol puts around them.
    pub fn append_all(&self, numbers: Range<u32>, out: &mut Vec<u8>) {
        match &self.batching {
            None => numbers.for_each(|number| self.append(number, out)),
            Some(batching) => batching.append_all(self, numbers, out),
        }
    }

    /// The number at the end of a payload.
    ///
    /// # Errors
    /// A payload that does not end with a number.
    pub fn last_number(payload: &[u8]) -> Result<u32, Error> {
        let number = payload
            .last_chunk::<NUMBER>()
            .and_then(|last| Template::number(last));
        number.ok_or_else(|| Error::Unexpected("a parcel without a number".to_owned()))
    }

    /// Reads the number at the front of `bytes`; none if there is no number.
    pub fn number(bytes: &[u8]) -> Option<u32> {
        let letters = u64::from_be_bytes(*bytes.first_chunk::<NUMBER>()?);
        let mut nibbles = letters.wrapping_sub(FIRST_LETTERS);
        if nibbles & !0x0f0f_0f0f_0f0f_0f0f != 0 {
            return None;
        }
        nibbles = (nibbles | nibbles >> 4) & 0x00ff_00ff_00ff_00ff;
        nibbles = (nibbles | nibbles >> 8) & 0x0000_ffff_0000_ffff;
        nibbles = (nibbles | nibbles >> 16) & 0xffff_ffff;
        Some(nibbles as u32)
    }
}

/// Reads a number in decimal digits; none if there is anything else, or nothing.
pub fn decimal(digits: &[u8]) -> Option<usize> {
    let known = !digits.is_empty() && digits.len() < 18 && digits.iter().all(u8::is_ascii_digit);
    let value = |sum, digit: &u8| 10 * sum + usize::from(digit - b'0');
    known.then(|| digits.iter().fold(0, value))
}

/// µs since 1970.
pub(crate) fn now() -> i64 {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    since.map_or(0, |since| i64::try_from(since.as_micros()).unwrap_or(i64::MAX))
}

const FIRST_LETTERS: u64 = u64::from_be_bytes([b'a'; NUMBER]);

/// Spreads the nibbles of a number over eight bytes; cheap, for a small parcel costs a relay 30 ns in all.
fn letters(number: u32) -> [u8; NUMBER] {
    let mut nibbles = u64::from(number);
    nibbles = (nibbles | nibbles << 16) & 0x0000_ffff_0000_ffff;
    nibbles = (nibbles | nibbles << 8) & 0x00ff_00ff_00ff_00ff;
    nibbles = (nibbles | nibbles << 4) & 0x0f0f_0f0f_0f0f_0f0f;
    (nibbles + FIRST_LETTERS).to_be_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_back() {
        let template = Template::new(vec![b'.'; 10], 2);
        for number in [0, 1, 15, 16, 0x1234_5678, u32::MAX - 1, u32::MAX] {
            let mut out = Vec::new();
            template.append(number, &mut out);
            assert_eq!(Template::number(&out[2..]), Some(number));
            assert_eq!(&out[..2], b"..");
        }
        for none in ["aaaaaaa", "aaaaaaaq", "aaaa`aaa", "01234567"] {
            assert_eq!(Template::number(none.as_bytes()), None, "{none}");
        }
    }
}
