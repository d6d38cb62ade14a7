//! What both ends keep of a session: counters of both directions, and the keys.

use crate::layout::TAG;
use crate::seal::{self, Keys};
use crate::sequence::Window;
use crate::{Direction, Dropped, Header, Layout, Type, VERSION};

/// One end's part of a session.
pub(crate) struct Traffic {
    pub(crate) id: [u8; 6],
    /// What this end sends.
    pub(crate) direction: Direction,
    /// The sequence of the next packet, continued to 64 bits.
    pub(crate) next: u64,
    pub(crate) heard: Window,
    /// The newest data packet that counts, continued.
    pub(crate) data: Option<u64>,
    pub(crate) keys: Option<Keys>,
}

impl Traffic {
    pub(crate) fn new(id: [u8; 6], direction: Direction, keys: Option<Keys>) -> Traffic {
        Traffic {
            id,
            direction,
            next: 0,
            heard: Window::NEW,
            data: None,
            keys,
        }
    }

    /// What stands behind the header of a packet of this session that was not heard before, with its sequence.
    pub(crate) fn open<'p>(
        &mut self,
        header: &Header,
        packet: &'p mut [u8],
    ) -> Result<(u64, &'p [u8]), Dropped> {
        if header.encryption != u8::from(self.keys.is_some()) {
            return Err(Dropped::Encryption);
        }
        let full = self.heard.continued(header.sequence)?;
        let (head, sealed) = packet.split_at_mut_checked(Header::LEN).ok_or(Dropped::Short)?;
        let body = match (&self.keys, self.direction) {
            (None, _) => sealed,
            (Some(keys), Direction::Up) => seal::open(&keys.down, full, head, sealed)?,
            (Some(keys), Direction::Down) => seal::open(&keys.up, full, head, sealed)?,
        };
        self.heard.mark(full);
        Ok((full, body))
    }

    /// Makes a packet of the body that is in `packet[20..20 + len]`; its length, and `None` where it does not fit.
    pub(crate) fn close(
        &mut self,
        layout: &Layout<'_>,
        kind: Type,
        now: u64,
        buffers: u8,
        packet: &mut [u8],
        len: usize,
    ) -> Option<usize> {
        let header = Header {
            version: VERSION,
            model: layout.id,
            encryption: u8::from(self.keys.is_some()),
            kind,
            sequence: self.next as u16,
            stamp: stamp(now),
            session: self.id,
            last: self.last(),
            buffers,
        };
        let header = header.encode();
        let end = Header::LEN + len;
        packet.get_mut(..Header::LEN)?.copy_from_slice(&header);
        let end = match &self.keys {
            None => packet.get(..end).map(|_| end)?,
            Some(keys) => {
                let key = if self.direction == Direction::Up {
                    &keys.up
                } else {
                    &keys.down
                };
                let (body, rest) = packet.get_mut(Header::LEN..end + TAG)?.split_at_mut(len);
                rest.copy_from_slice(&seal::seal(key, self.next, &header, body)?);
                end + TAG
            }
        };
        self.next += 1;
        Some(end)
    }

    /// The sequence of the newest data packet for the header; before the first one that is before 0.
    pub(crate) fn last(&self) -> u16 {
        self.data.map_or(0xFFFF, |full| full as u16)
    }
}

/// A time in a header: ms, which wrap after 49 days.
pub(crate) fn stamp(now: u64) -> u32 {
    (now / 1000) as u32
}
