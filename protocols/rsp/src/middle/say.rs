//! What a middle's end sends.

use super::device::{Call, ElementState};
use super::hear::keep_map;
use super::{HELLO_MOST, Middle, Notice, State};
use crate::fragment::HEAD;
use crate::handshake::Hello;
use crate::robot::next_id;
use crate::seal;
use crate::traffic::stamp;
use crate::{Direction, Element, FRAGMENT, Header, Item, Kind, Motion, Type, VERSION, Writer};

impl Middle<'_> {
    /// Does what is due, and gives the next datagram to be sent, or `None` when there is no more for now. To be called until `None` after
    /// each [`receive`](Self::receive) and at [`wake`](Self::wake).
    pub fn poll(&mut self, now: u64) -> Option<&[u8]> {
        let mut out = core::mem::take(&mut self.out);
        let len = self.say(now, &mut out);
        self.out = out;
        self.out.get(..len?)
    }

    /// When [`poll`](Self::poll) has something to do, if nothing arrives before; `None` for never.
    #[must_use]
    pub fn wake(&self) -> Option<u64> {
        match self.state {
            State::Idle => None,
            State::Calling => Some(self.next),
            State::Up | State::Ending => Some(self.next.min(self.heard + self.silence_us())),
        }
    }

    fn silence_us(&self) -> u64 {
        u64::from(self.settings.silence) * 1000
    }

    fn say(&mut self, now: u64, out: &mut [u8]) -> Option<usize> {
        let silent = now.saturating_sub(self.heard) >= self.silence_us();
        match self.state {
            State::Up if silent => {
                self.forget();
                self.tell(Notice::Lost);
                self.call(now);
            }
            State::Ending if silent => {
                self.state = State::Idle;
                self.tell(Notice::Ended);
            }
            _ => {}
        }
        if core::mem::take(&mut self.due_end) {
            return self.close(Type::End, now, out, 0);
        }
        match self.state {
            State::Idle => None,
            State::Calling if now >= self.next => {
                self.next = now + self.wait;
                self.wait = (self.wait * 3 / 2).min(HELLO_MOST);
                self.say_hello(now, out)
            }
            State::Ending if now >= self.next => {
                self.next = now + self.period_us();
                self.close(Type::End, now, out, 0)
            }
            State::Calling | State::Ending => None,
            State::Up => self.say_up(now, out),
        }
    }

    fn say_up(&mut self, now: u64, out: &mut [u8]) -> Option<usize> {
        if now >= self.next {
            let period = self.period_us();
            // One late turn does not make the next ones come in a row.
            self.next = (self.next + period).max(now + period / 2);
            self.make_control();
            (self.due_data, self.due_control) = (true, !self.control.is_confirmed);
            self.budget = self.settings.budget;
        }
        if core::mem::take(&mut self.due_data) {
            return self.say_data(now, out);
        }
        if core::mem::take(&mut self.due_control) {
            return self.say_control(now, out);
        }
        self.say_fragment(now, out)
    }

    fn say_hello(&mut self, now: u64, out: &mut [u8]) -> Option<usize> {
        self.called.get_or_insert(now);
        let key = self.settings.key.as_ref();
        let header = Header {
            version: VERSION,
            model: self.layout.id,
            encryption: u8::from(key.is_some()),
            kind: Type::Hello,
            sequence: 0,
            stamp: stamp(now),
            session: [0; 6],
            last: 0xFFFF,
            buffers: 0,
        };
        let hello = Hello {
            nonce: self.nonce,
            hash: self.layout.hash,
            period: self.control.period,
            paper: self.settings.paper,
        };
        let end = Header::LEN + Hello::LEN;
        out.get_mut(..Header::LEN)?.copy_from_slice(&header.encode());
        out.get_mut(Header::LEN..end)?.copy_from_slice(&hello.encode());
        seal::sign(key, out, end)
    }

    fn close(&mut self, kind: Type, now: u64, out: &mut [u8], len: usize) -> Option<usize> {
        self.traffic
            .as_mut()?
            .close(self.layout, kind, now, self.cleared, out, len)
    }

    /// Whether the newest control says something else than what is wanted.
    pub(super) fn is_control_old(&self) -> bool {
        self.control.period != self.settings.period
            || self.devices.iter().any(|device| device.wanted != device.level)
    }

    /// Makes the next control when the last one is confirmed: so the robot sees each deactivation, and both ends forget the same values.
    /// One that deactivates waits for nothing, and does no more than that: whichever of the two the robot hears, it sees it.
    fn make_control(&mut self) {
        let waits = !self.control.is_confirmed;
        let rests = self.devices.iter().any(|device| device.level && !device.wanted);
        if !self.is_control_old() || (waits && !rests) {
            return;
        }
        self.control.number = self.control.number.wrapping_add(1);
        self.control.is_confirmed = false;
        if !waits {
            self.control.period = self.settings.period;
        }
        for device in &mut self.devices {
            device.level = device.wanted && (device.level || !waits);
        }
        for place in 0..self.devices.len() {
            let element = place as u8;
            if !self.with_module(element, |device| device.level) {
                self.withdraw(element);
                if let Some(device) = self.devices.get_mut(place) {
                    device.rest();
                }
            }
        }
        let mut outgoing = core::mem::take(&mut self.outgoing);
        outgoing.forget(|element| self.is_open(element));
        self.outgoing = outgoing;
    }

    fn say_control(&mut self, now: u64, out: &mut [u8]) -> Option<usize> {
        let map_len = self.layout.map_len();
        let (head, map) = out
            .get_mut(Header::LEN..Header::LEN + 3 + map_len)?
            .split_first_chunk_mut::<3>()?;
        let [p0, p1] = self.control.period.to_be_bytes();
        *head = [self.control.number, p0, p1];
        map.fill(0);
        for (place, _) in self.devices.iter().enumerate().filter(|(_, device)| device.level) {
            if let Some(byte) = map.get_mut(place / 8) {
                *byte |= 0x80 >> (place % 8);
            }
        }
        self.close(Type::Control, now, out, 3 + map_len)
    }

    fn say_data(&mut self, now: u64, out: &mut [u8]) -> Option<usize> {
        self.ask_for_held(now);
        let sequence = self.traffic.as_ref()?.next;
        let patience = self.patience();
        let layout = self.layout;
        let mut writer = Writer::new(layout, Direction::Down, out.get_mut(Header::LEN..)?)?;
        for (place, element) in layout.elements.iter().enumerate() {
            // Before the robot has said that a module is active, what is for its members would be heard and not used.
            let is_open = self.is_open(place as u8) && self.active(place as u8);
            let Some(device) = self.devices.get_mut(place) else {
                continue;
            };
            if !is_open {
                device.pause();
                continue;
            }
            let turn = DataPacket {
                now,
                sequence,
                patience,
                paper: self.settings.paper,
                place: place as u8,
            };
            if let Some(failed) = turn.put(element, device, &mut writer) {
                self.notices.push_back(failed);
            }
        }
        let len = writer.finish();
        let [down, _] = &mut self.maps;
        keep_map(down, out.get(Header::LEN..).unwrap_or_default(), layout.map_len());
        let len = self.close(Type::Data, now, out, len)?;
        self.clock.leaves(sequence, now);
        Some(len)
    }

    /// Asks for memory events that the robot holds and has sent no more for a while (S22).
    fn ask_for_held(&mut self, now: u64) {
        let (all, free, since) = self.buffers;
        let waits = free < all && now.saturating_sub(since) >= self.patience();
        if self.settings.paper || !waits {
            return;
        }
        self.buffers.2 = now;
        for (device, element) in self.devices.iter_mut().zip(self.layout.elements) {
            if element.kind == Kind::MemoryEvent {
                device.asked = Some(None);
            }
        }
    }

    fn say_fragment(&mut self, now: u64, out: &mut [u8]) -> Option<usize> {
        if usize::from(self.budget) < FRAGMENT {
            return None;
        }
        let len = self.outgoing.next(|fragment| {
            let (head, bytes) = out.get_mut(Header::LEN..)?.split_first_chunk_mut::<HEAD>()?;
            *head = fragment.head();
            bytes
                .get_mut(..fragment.bytes.len())?
                .copy_from_slice(fragment.bytes);
            Some(fragment.bytes.len())
        })??;
        self.budget -= len as u16;
        self.close(Type::Fragment, now, out, HEAD + len)
    }
}

/// One data packet that is being made.
struct DataPacket {
    now: u64,
    sequence: u64,
    patience: u64,
    paper: bool,
    place: u8,
}

impl DataPacket {
    /// Puts in what an element has to say. A notice if a command is given up.
    fn put(
        &self,
        element: &Element<'_>,
        device: &mut ElementState,
        writer: &mut Writer<'_>,
    ) -> Option<Notice> {
        match element.kind {
            Kind::Effector => self.put_value(element, device, writer),
            Kind::Sensor | Kind::Monitor => {
                if let Some(since) = &mut device.asked {
                    since.get_or_insert(self.sequence);
                    let _ = writer.put(self.place, Item::Ask);
                    if self.paper {
                        device.asked = None;
                    }
                }
            }
            Kind::Event | Kind::MemoryEvent => {
                let ack = device.ack.take();
                // 0 asks for what is held (S22).
                let id = ack.or_else(|| device.asked.take().map(|_| 0));
                if let Some(id) = id {
                    let _ = writer.put(self.place, Item::Ack(id));
                }
            }
            Kind::Command | Kind::MemoryCommand => return self.put_call(element.kind, device, writer),
            Kind::Module => {}
        }
        None
    }

    fn put_value(&self, element: &Element<'_>, device: &mut ElementState, writer: &mut Writer<'_>) {
        if self.paper && matches!(element.motion, Motion::Incremental { .. }) {
            if !device.step.is_empty() {
                let _ = writer.put(self.place, Item::Value(&device.step));
                device.step.fill(0);
            }
            return;
        }
        device.leaves(self.sequence);
        if let Some(value) = &device.value
            && (self.paper || !device.changes.is_empty())
        {
            let _ = writer.put(self.place, Item::Value(value));
        }
    }

    fn put_call(&self, kind: Kind, device: &mut ElementState, writer: &mut Writer<'_>) -> Option<Notice> {
        let mut failed = None;
        let is_memory = kind == Kind::MemoryCommand;
        if is_memory
            && self.paper
            && let Some(call) = &device.call
            && call
                .sent
                .is_some_and(|(first, _)| self.now.saturating_sub(first) >= self.patience)
        {
            failed = Some(Notice::Failed {
                element: self.place,
                ticket: call.ticket,
            });
            device.call = None;
        }
        if device.call.is_none()
            && let Some((ticket, data)) = device.queue.pop_front()
        {
            device.id = next_id(device.id);
            device.call = Some(Call {
                ticket,
                id: device.id,
                data,
                sent: None,
            });
        }
        if let Some(call) = &mut device.call {
            let is_due = match call.sent {
                Some((_, last)) if is_memory => !self.paper && self.now.saturating_sub(last) >= self.patience,
                _ => true,
            };
            let item = Item::Call {
                id: call.id,
                data: &call.data,
            };
            if is_due && writer.put(self.place, item).is_ok() {
                let first = call.sent.map_or(self.now, |(first, _)| first);
                call.sent = Some((first, self.now));
            }
        }
        failed
    }
}
