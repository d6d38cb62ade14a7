//! What a router sends, found in its bytes: batches, the messages in them, and the parcels in those.

use std::collections::BTreeMap;

use mom_benches::{Error, NUMBER, Scan, Scanner, Template};

use super::{
    CLOSE, DATA, DECLARE, DECLARE_KEY, EXTENDED, F5, F6, FINAL, FORGET_KEY, FRAGMENT, FRAME, KEEP_ALIVE,
    KIND, LAST_DECLARATION, PUSH, PUT, broken,
};

/// Reads forward in bytes; none at their end.
pub(super) struct Bytes<'a>(pub(super) &'a [u8]);

impl<'a> Bytes<'a> {
    pub(super) fn byte(&mut self) -> Option<u8> {
        let (byte, rest) = self.0.split_first()?;
        self.0 = rest;
        Some(*byte)
    }

    pub(super) fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(taken)
    }

    pub(super) fn skip(&mut self, length: usize) -> Option<()> {
        self.take(length).map(drop)
    }

    fn number(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in 0..9 {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << (7 * shift);
            if byte & 0x80 == 0 {
                break;
            }
        }
        Some(value)
    }

    pub(super) fn length(&mut self) -> Option<usize> {
        usize::try_from(self.number()?).ok()
    }

    /// Bytes with their length before them.
    fn counted(&mut self) -> Option<()> {
        let length = self.length()?;
        self.skip(length)
    }

    /// Extensions, if the flag says that there are any; gives the number of the last one that is a number.
    fn extensions(&mut self, head: u8) -> Option<Option<u64>> {
        let mut more = head & EXTENDED != 0;
        let mut value = None;
        while more {
            let head = self.byte()?;
            match head & 0x60 {
                0x20 => value = Some(self.number()?),
                0x40 => self.counted()?,
                _ => {}
            }
            more = head & EXTENDED != 0;
        }
        Some(value)
    }

    /// The key that a message is about.
    fn key(&mut self, head: u8) -> Option<()> {
        self.number()?;
        match head & F5 {
            0 => Some(()),
            _ => self.counted(),
        }
    }

    /// What follows the head of a message with data; gives its payload.
    fn push(&mut self, head: u8) -> Option<&'a [u8]> {
        self.key(head)?;
        self.extensions(head)?;
        let body = self.byte()?;
        if body & KIND != PUT {
            return None;
        }
        if body & F5 != 0 {
            self.number()?;
            self.counted()?;
        }
        if body & F6 != 0 && self.number()? & 1 != 0 {
            self.counted()?;
        }
        self.extensions(body)?;
        let length = self.length()?;
        self.take(length)
    }

    /// What follows the head of a declaration; gives whether it is the end of an answer.
    fn declare(&mut self, head: u8) -> Option<bool> {
        if head & F5 != 0 {
            self.number()?;
        }
        self.extensions(head)?;
        let body = self.byte()?;
        match body & KIND {
            FINAL => {}
            FORGET_KEY..=LAST_DECLARATION if body & 1 == 1 => drop(self.number()?),
            DECLARE_KEY..=LAST_DECLARATION => {
                self.number()?;
                self.key(body)?;
            }
            _ => return None,
        }
        self.extensions(body)?;
        Some(body & KIND == FINAL)
    }
}

/// Finds parcels in what a client receives.
pub(super) struct ZenohScanner {
    /// Of the batch that is being read.
    pub(super) left: usize,
    /// The last bytes of messages in fragments, by channel.
    tails: BTreeMap<(u8, u64), Vec<u8>>,
    /// The answer to the interest of the greeting is complete.
    pub(super) answered: bool,
}

impl ZenohScanner {
    pub(super) fn new() -> ZenohScanner {
        ZenohScanner {
            left: 0,
            tails: BTreeMap::new(),
            answered: false,
        }
    }

    /// One message at the front of what is left of a batch; none if it ends too early.
    fn message(&mut self, bytes: &[u8]) -> Option<Result<Scan, Error>> {
        let mut rest = Bytes(bytes);
        let head = rest.byte()?;
        let mut number = None;
        match head & KIND {
            KEEP_ALIVE => drop(rest.extensions(head)?),
            CLOSE => return Some(Err(Error::Unexpected("the router closed".to_owned()))),
            FRAME => {
                rest.number()?;
                rest.extensions(head)?;
            }
            FRAGMENT => {
                rest.number()?;
                let priority = rest.extensions(head)?.unwrap_or(u64::from(DATA));
                let channel = (head & F5, priority);
                let piece = std::mem::take(&mut rest.0);
                let tail = self.tails.entry(channel).or_default();
                tail.extend_from_slice(&piece[piece.len().saturating_sub(NUMBER)..]);
                let old = tail.len().saturating_sub(NUMBER);
                tail.drain(..old);
                if head & F6 == 0 {
                    // Only data is ever so large.
                    number = self
                        .tails
                        .remove(&channel)
                        .map(|tail| Template::last_number(&tail));
                }
            }
            PUSH => number = Some(Template::last_number(rest.push(head)?)),
            DECLARE => self.answered |= rest.declare(head)?,
            // Nothing here asks for more; what it may be, the batch's length says where it ends.
            _ => rest.0 = &[],
        }
        let length = bytes.len() - rest.0.len();
        self.left -= length;
        Some(match number {
            None => Ok(Scan::Other(length)),
            Some(number) => number.map(|number| Scan::Parcel(length, number)),
        })
    }
}

impl Scanner for ZenohScanner {
    fn scan(&mut self, bytes: &[u8]) -> Result<Scan, Error> {
        if self.left > 0 {
            let batch = bytes.get(..self.left).ok_or_else(broken)?;
            return self.message(batch).ok_or_else(broken)?;
        }
        let Some((length, rest)) = bytes.split_first_chunk::<2>() else {
            return Ok(Scan::Incomplete);
        };
        let length = usize::from(u16::from_le_bytes(*length));
        if rest.len() < length {
            return Ok(Scan::Incomplete);
        }
        // What is left of a batch stays in its place until all of it is scanned.
        self.left = length;
        Ok(Scan::Other(2))
    }
}
