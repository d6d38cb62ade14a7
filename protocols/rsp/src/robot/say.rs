//! What a robot's end sends.

use super::cell::{self, ASKED, HAS, NEW, SENT};
use super::{Body, DUE, EVENTS, Phase, Robot};
use crate::fragment::HEAD;
use crate::handshake::{self, MODEL, REFUSAL, Welcome};
use crate::seal::{self, NONCE};
use crate::traffic::stamp;
use crate::{Direction, FRAGMENT, Fragment, Header, Item, Kind, Type, VERSION, Writer};

impl<const E: usize, const V: usize, const B: usize, const S: usize> Robot<'_, E, V, B, S> {
    /// Does what is due, and writes the next datagram to be sent: its length, or `None` when there is no more for now. To be called until
    /// `None` after each [`receive`](Self::receive) and at [`wake`](Self::wake); `out` takes
    /// [`Layout::largest`](crate::Layout::largest) bytes: a smaller one gets no data packet.
    pub fn poll(&mut self, now: u64, out: &mut [u8], body: &mut impl Body) -> Option<usize> {
        self.watch(now, body);
        if let Some((reason, echo)) = self.answers.refusal.take() {
            return self.say_refusal(now, reason, &echo, out);
        }
        if core::mem::take(&mut self.answers.welcome) {
            return self.say_welcome(now, out);
        }
        if core::mem::take(&mut self.answers.end) {
            return self.close(Type::UpEnd, now, out, 0);
        }
        match self.phase {
            Phase::Down => None,
            Phase::Ending if now >= self.next => {
                self.next = now + self.period_us();
                self.close(Type::UpEnd, now, out, 0)
            }
            Phase::Ending => None,
            Phase::Up => {
                if core::mem::take(&mut self.answers.control) {
                    return self.say_control(now, out);
                }
                if now >= self.due {
                    self.move_all(now, body);
                }
                if now >= self.next {
                    return self.say_data(now, out);
                }
                self.say_fragment(now, out, body)
            }
        }
    }

    /// When [`poll`](Self::poll) has something to do, if nothing arrives before; `None` for never.
    #[must_use]
    pub fn wake(&self) -> Option<u64> {
        match self.phase {
            Phase::Down => None,
            Phase::Up if self.is_watched() => {
                Some(self.next.min(self.due).min(self.fed + self.watchdog_us()))
            }
            Phase::Up => Some(self.next.min(self.due)),
            Phase::Ending => Some(self.next),
        }
    }

    fn close(&mut self, kind: Type, now: u64, out: &mut [u8], len: usize) -> Option<usize> {
        let buffers = self.free_buffers();
        self.traffic
            .as_mut()?
            .close(self.layout, kind, now, buffers, out, len)
    }

    fn handshake(&self, kind: Type, now: u64, session: [u8; 6], out: &mut [u8], len: usize) -> Option<usize> {
        let key = self.settings.key.as_ref();
        let header = Header {
            version: VERSION,
            model: self.layout.id,
            encryption: u8::from(key.is_some()),
            kind,
            sequence: 0,
            stamp: stamp(now),
            session,
            last: 0xFFFF,
            buffers: self.free_buffers(),
        };
        out.get_mut(..Header::LEN)?.copy_from_slice(&header.encode());
        seal::sign(key, out, Header::LEN + len)
    }

    fn say_welcome(&self, now: u64, out: &mut [u8]) -> Option<usize> {
        let pending = self.pending.as_ref()?;
        let welcome = self.welcome(pending).encode();
        out.get_mut(Header::LEN..Header::LEN + Welcome::LEN)?
            .copy_from_slice(&welcome);
        self.handshake(Type::Welcome, now, pending.session, out, Welcome::LEN)
    }

    fn say_refusal(&self, now: u64, reason: u8, echo: &[u8; NONCE], out: &mut [u8]) -> Option<usize> {
        let most = out.len().min(REFUSAL).checked_sub(crate::layout::TAG)?;
        let mut rest = out.get_mut(Header::LEN..most)?;
        let whole = rest.len();
        let fits = handshake::put(&mut rest, &[reason])
            && handshake::put(&mut rest, echo)
            && handshake::put(&mut rest, &self.layout.hash);
        if !fits {
            return None;
        }
        let mut len = whole - rest.len();
        if reason == MODEL {
            for element in self.layout.elements {
                let name = element.name.as_bytes();
                let fits = handshake::put(&mut rest, &element.digest.to_be_bytes())
                    && handshake::put(&mut rest, &[name.len() as u8])
                    && handshake::put(&mut rest, name);
                if !fits {
                    break;
                }
                len = whole - rest.len();
            }
        }
        self.handshake(Type::Refusal, now, [0; 6], out, len)
    }

    fn say_control(&mut self, now: u64, out: &mut [u8]) -> Option<usize> {
        let (_, number) = self.control?;
        let map_len = self.layout.map_len();
        let (first, map) = out
            .get_mut(Header::LEN..=Header::LEN + map_len)?
            .split_first_mut()?;
        *first = number;
        map.fill(0);
        for place in (0..E).filter(|&place| self.is_active(place as u8)) {
            if let Some(byte) = map.get_mut(place / 8) {
                *byte |= 0x80 >> (place % 8);
            }
        }
        self.close(Type::UpControl, now, out, 1 + map_len)
    }

    fn say_data(&mut self, now: u64, out: &mut [u8]) -> Option<usize> {
        let period = self.period_us();
        // One late turn does not make the next ones come in a row.
        self.next = (self.next + period).max(now + period / 2);
        self.budget = self.settings.budget;
        let sequence = self.traffic.as_ref()?.next as u16;
        let layout = self.layout;
        if out.len() < layout.largest_data(Direction::Up) {
            return None;
        }
        let mut writer = Writer::new(layout, Direction::Up, out.get_mut(Header::LEN..)?)?;
        for place in 0..E {
            self.put(now, place as u8, sequence, &mut writer);
        }
        let len = writer.finish();
        self.close(Type::UpData, now, out, len)
    }

    /// Puts into a data packet what an element has to say.
    fn put(&mut self, now: u64, place: u8, sequence: u16, writer: &mut Writer<'_>) {
        let is_active = self.is_active(place);
        let paper = self.paper;
        let Some((element, cell, bytes)) = self.parts(place) else {
            return;
        };
        match element.kind {
            Kind::Sensor | Kind::Monitor if is_active && cell.is(HAS) => {
                // A new value begins at most once in the sensor's own period, and is then in each packet until it is acknowledged.
                let passed = (now as u32).wrapping_sub(cell.at);
                if cell.is(NEW) && (cell.at == 0 || passed >= u32::from(element.period) * 1000) {
                    cell.clear(NEW);
                    cell.set(SENT);
                    (cell.first, cell.at) = (sequence, (now as u32).max(1));
                }
                let value = cell::stored(element.payload, bytes);
                if (paper || cell.flags & DUE != 0) && writer.put(place, Item::Value(value)).is_ok() {
                    cell.clear(ASKED);
                }
            }
            Kind::Command | Kind::MemoryCommand
                if cell.count != 0 && writer.put(place, Item::Ack(cell.count)).is_ok() =>
            {
                cell.count = 0;
            }
            Kind::Event if is_active && cell.count > 0 => {
                if !cell.is(SENT) {
                    cell.id = next_id(cell.id);
                    cell.set(SENT);
                }
                let size = element.payload.size();
                let start = usize::from(cell.head) % EVENTS * size;
                let data = cell::stored(
                    element.payload,
                    bytes.get(start..start + size).unwrap_or_default(),
                );
                let _ = writer.put(place, Item::Call { id: cell.id, data });
            }
            Kind::MemoryEvent if is_active => self.put_held(place, writer),
            _ => {}
        }
    }

    /// Sends the oldest memory event of an element that is held, once (S22).
    fn put_held(&mut self, place: u8, writer: &mut Writer<'_>) {
        let held = self
            .slots
            .iter_mut()
            .filter(|slot| slot.order != 0 && slot.element == place);
        let Some(slot) = held.min_by_key(|slot| slot.order).filter(|slot| slot.waits) else {
            return;
        };
        let Some(cell) = self.cells.get_mut(usize::from(place)) else {
            return;
        };
        if slot.id == 0 {
            cell.id = next_id(cell.id);
            slot.id = cell.id;
        }
        let data = slot.data.get(..usize::from(slot.len)).unwrap_or_default();
        slot.waits = writer.put(place, Item::Call { id: slot.id, data }).is_err();
    }

    /// A part of a blob behind the data packet, as far as the budget goes (S13).
    fn say_fragment(&mut self, now: u64, out: &mut [u8], body: &mut impl Body) -> Option<usize> {
        if usize::from(self.budget) < FRAGMENT {
            return None;
        }
        let start = Header::LEN + HEAD;
        let into = out.get_mut(start..start + FRAGMENT)?;
        let next = body.next_fragment(into)?;
        let bytes = into.get(..usize::from(next.len))?;
        let fragment = Fragment {
            element: next.element,
            blob: next.blob,
            offset: next.offset,
            total: next.total,
            bytes,
        };
        let head = fragment.head();
        self.budget -= next.len;
        out.get_mut(Header::LEN..start)?.copy_from_slice(&head);
        self.close(Type::UpFragment, now, out, HEAD + usize::from(next.len))
    }
}

/// Ids go from 1 to 255, and on with 1.
pub(crate) const fn next_id(id: u8) -> u8 {
    if id == 255 { 1 } else { id + 1 }
}
