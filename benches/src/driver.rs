//! The drivers: how a protocol's peers connect, what they send, how they find parcels in what they receive.

mod mom;
mod relay;

use std::io::Read;
use std::net::TcpStream;
use std::time::Duration;

pub use mom::MomDriver;
pub use relay::RelayDriver;

use crate::Error;

/// A wait for the hub under measurement ends here: then something is lost.
pub(crate) const PATIENCE: Duration = Duration::from_secs(5);

/// Speaks one protocol as raw bytes: no client library, nothing encoded while the clock runs.
pub trait Driver: Send + Sync {
    /// Connects a peer that hears whatever another peer of this driver sends from now on, and can send.
    ///
    /// # Errors
    /// A link that cannot be had, or a refusal.
    fn connect(&self) -> Result<Link, Error>;

    /// A frame that carries a payload of so many bytes, ready to be numbered; at least eight.
    ///
    /// # Errors
    /// A size that the protocol cannot carry.
    fn template(&self, payload: usize) -> Result<Template, Error>;

    /// Finds the parcels made from [`Driver::template`] of the same size in a receiver's bytes.
    fn scanner(&self, payload: usize) -> Box<dyn Scanner>;
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
    pub(crate) fn connect(address: &str) -> Result<Link, Error> {
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

    /// Reads something more from the socket.
    pub(crate) fn receive(&mut self) -> Result<&[u8], Error> {
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
    /// A frame of this length that is no parcel of the workload.
    Other(usize),
    /// A frame of this length with a parcel of this number.
    Parcel(usize, u32),
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
}

/// The bytes that a number takes.
pub(crate) const NUMBER: usize = 8;

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
        Template { frame, number_at }
    }

    /// The frame's size on the wire.
    pub fn size(&self) -> usize {
        self.frame.len()
    }

    /// Appends the frame with this number.
    pub fn append(&self, number: u32, out: &mut Vec<u8>) {
        let start = out.len();
        out.extend_from_slice(&self.frame);
        let at = start + self.number_at;
        out[at..at + NUMBER].copy_from_slice(&letters(number));
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
