//! What a robot's end does with a datagram.

use super::cell::{ACTIVE, ASKED, NEW, SENT};
use super::{Body, NEVER, Pending, Phase, Robot};
use crate::handshake::{self, BUSY, Hello, MODEL, VERSION as OTHER_VERSION};
use crate::packet::{bit, is_padded};
use crate::seal::{self, Keys};
use crate::traffic::Traffic;
use crate::{Direction, Dropped, Fragment, Header, Item, Items, Kind, PERIODS, Type, VERSION, is_newer};

/// Hellos that are answered in a second.
const ANSWERS: u8 = 10;

/// A session is alive for so long after its last data packet where there is no watchdog, µs.
const ALIVE: u64 = 500_000;

impl<const E: usize, const V: usize, const B: usize, const S: usize> Robot<'_, E, V, B, S> {
    /// A datagram has arrived; it is opened in place. What it asks for is done through the body before this returns.
    ///
    /// # Errors
    ///
    /// Why it was dropped, which is counted.
    pub fn receive(&mut self, now: u64, datagram: &mut [u8], body: &mut impl Body) -> Result<(), Dropped> {
        let outcome = self.take(now, datagram, body);
        self.counters.count(outcome)
    }

    fn take(&mut self, now: u64, datagram: &mut [u8], body: &mut impl Body) -> Result<(), Dropped> {
        let header = Header::decode(datagram)?;
        match header.kind {
            Type::Hello => return self.hear_hello(now, &header, datagram, body),
            Type::Data | Type::Control | Type::Fragment | Type::End => {}
            _ => return Err(Dropped::Type),
        }
        if header.version != VERSION {
            return Err(Dropped::Version);
        }
        if header.model != self.layout.id {
            return Err(Dropped::Model);
        }
        self.watch(now, body);
        let known = self
            .traffic
            .as_ref()
            .is_some_and(|traffic| traffic.id == header.session);
        if !known {
            return self.hear_first(now, &header, datagram, body);
        }
        let Some(traffic) = &mut self.traffic else {
            return Err(Dropped::Session);
        };
        let (full, payload) = traffic.open(&header, datagram)?;
        self.hear(now, full, &header, payload, body)
    }

    /// The first packet of a session that was given: it begins, and another one is over.
    fn hear_first(
        &mut self,
        now: u64,
        header: &Header,
        datagram: &mut [u8],
        body: &mut impl Body,
    ) -> Result<(), Dropped> {
        let pending = self.pending.as_ref();
        let pending = pending
            .filter(|pending| pending.session == header.session)
            .ok_or(Dropped::Session)?;
        let (session, period, paper) = (pending.session, pending.period, pending.paper);
        let keys = match &self.settings.key {
            None => None,
            Some(key) => {
                let keys = Keys::derive(key, &pending.hello, &pending.welcome, session);
                Some(keys.ok_or(Dropped::Encryption)?)
            }
        };
        let mut traffic = Traffic::new(session, Direction::Up, keys);
        let (full, payload) = traffic.open(header, datagram)?;
        if self.phase == Phase::Up {
            self.over(body);
        }
        self.traffic = Some(traffic);
        (self.pending, self.phase, self.paper) = (None, Phase::Up, paper);
        (self.period, self.next) = (period, now);
        (self.fed, self.floor, self.barrier) = (now, 0, 0);
        (self.control, self.cleared) = (None, 0);
        (self.answers.control, self.answers.end, self.is_ender) = (false, false, false);
        body.session(true);
        self.hear(now, full, header, payload, body)
    }

    fn hear(
        &mut self,
        now: u64,
        full: u64,
        header: &Header,
        payload: &[u8],
        body: &mut impl Body,
    ) -> Result<(), Dropped> {
        match (header.kind, self.phase) {
            (Type::End, phase) => {
                if !payload.is_empty() {
                    return Err(Dropped::Payload);
                }
                // An end that answers one's own needs no answer, or two ends would answer each other for ever.
                self.answers.end = !self.is_ender;
                match phase {
                    Phase::Up => self.over(body),
                    Phase::Ending | Phase::Down => self.phase = Phase::Down,
                }
                Ok(())
            }
            (_, Phase::Down | Phase::Ending) => Err(Dropped::Session),
            (Type::Data, Phase::Up) => self.hear_data(now, full, header, payload, body),
            (Type::Control, Phase::Up) => self.hear_control(now, full, payload, body),
            (_, Phase::Up) => {
                let fragment = Fragment::parse(payload)?;
                if full < self.barrier {
                    return Ok(());
                }
                let known = self
                    .layout
                    .element(fragment.element)
                    .is_some_and(|element| element.kind == Kind::Effector);
                if !known {
                    return Err(Dropped::Payload);
                }
                if self.is_active(fragment.element) {
                    body.fragment(fragment);
                }
                Ok(())
            }
        }
    }

    fn hear_data(
        &mut self,
        now: u64,
        full: u64,
        header: &Header,
        payload: &[u8],
        body: &mut impl Body,
    ) -> Result<(), Dropped> {
        let layout = self.layout;
        let items = Items::parse(layout, Direction::Down, payload)?;
        let is_newest = full >= self.floor;
        if is_newest {
            self.floor = full + 1;
            self.fed = now;
            if let Some(traffic) = &mut self.traffic {
                traffic.data = Some(full);
            }
            self.acknowledge(header.last);
            if header.buffers != self.cleared {
                self.cleared = header.buffers;
                self.slots = [super::Buffer::FREE; B];
            }
        }
        for (place, item) in items {
            // A late packet moves nothing, but its ids and acknowledgements count: they do so once anyway. Only a call that a control has
            // overtaken counts as lost: it may have been withdrawn.
            match item {
                Item::Call { .. } if full < self.barrier => {}
                Item::Call { id, data } => self.execute(place, id, data, is_newest, body),
                Item::Ack(0) if !is_newest => {}
                Item::Ack(id) => self.hear_ack(place, id),
                _ if !is_newest => {}
                Item::Value(value) => {
                    self.activate(place, true, body);
                    if self.is_active(place) {
                        self.hear_value(now, place, value);
                    }
                }
                Item::Ask => {
                    self.activate(place, true, body);
                    if let Some(cell) = self.cells.get_mut(usize::from(place)) {
                        cell.set(ASKED);
                    }
                }
                Item::Activate => self.activate(place, true, body),
            }
        }
        Ok(())
    }

    /// Executes a command that was not executed yet, and has its id acknowledged (S19, S20).
    fn execute(&mut self, place: u8, id: u8, data: &[u8], is_newest: bool, body: &mut impl Body) {
        if is_newest {
            self.activate(place, true, body);
        }
        if !self.is_active(place) {
            return;
        }
        let Some(cell) = self.cells.get_mut(usize::from(place)) else {
            return;
        };
        // Ids go from 1 to 255 and on with 1. What is older than the last one is late: it was acknowledged, or given up.
        let ahead = (i16::from(id) - i16::from(cell.id)).rem_euclid(255);
        match (cell.id, ahead) {
            (0, _) | (_, 1..=127) => {
                (cell.id, cell.count) = (id, id);
                body.command(place, data);
            }
            (_, 0) => cell.count = id,
            _ => {}
        }
    }

    /// The middle has an event, or asks for what is held.
    fn hear_ack(&mut self, place: u8, id: u8) {
        let held = self
            .slots
            .iter_mut()
            .filter(|slot| slot.order != 0 && slot.element == place && slot.id != 0);
        for slot in held {
            if id == 0 {
                slot.waits = true;
            } else if slot.id == id {
                *slot = super::Buffer::FREE;
                return;
            }
        }
        let Some((element, cell, _)) = self.parts(place) else {
            return;
        };
        if element.kind == Kind::Event && cell.count > 0 && cell.is(SENT) && cell.id == id {
            cell.head = (cell.head + 1) % super::EVENTS as u8;
            cell.count -= 1;
            cell.clear(SENT);
        }
    }

    /// The newest data packet that the middle has: the values in it are acknowledged.
    fn acknowledge(&mut self, last: u16) {
        let newest = self
            .traffic
            .as_ref()
            .map_or(0, |traffic| traffic.next.wrapping_sub(1) as u16);
        if is_newer(last, newest) {
            return;
        }
        for (cell, element) in self.cells.iter_mut().zip(self.layout.elements) {
            let is_value = matches!(element.kind, Kind::Sensor | Kind::Monitor);
            if is_value && cell.is(SENT) && !is_newer(cell.first, last) {
                cell.clear(SENT);
            }
        }
    }

    /// Activates or deactivates an element by itself; a module with all its members.
    fn activate(&mut self, place: u8, active: bool, body: &mut impl Body) {
        let was = self.is_active(place);
        let Some(cell) = self.cells.get_mut(usize::from(place)) else {
            return;
        };
        if cell.is(ACTIVE) == active {
            return;
        }
        cell.flags ^= ACTIVE;
        if self.is_active(place) != was {
            self.changed(place, active, body);
        }
        for member in 0..E {
            let member = member as u8;
            let is_member = self
                .layout
                .element(member)
                .is_some_and(|element| element.module == Some(place));
            if is_member
                && self
                    .cells
                    .get(usize::from(member))
                    .is_some_and(|cell| cell.is(ACTIVE))
            {
                self.changed(member, active, body);
            }
        }
    }

    /// An element is active now, or is not.
    fn changed(&mut self, place: u8, active: bool, body: &mut impl Body) {
        let Some((element, cell, _)) = self.parts(place) else {
            return;
        };
        match element.kind {
            Kind::Effector if !active => self.make_safe(place, body),
            // The middle has withdrawn what was under way, and a packet that had it is behind the barrier.
            Kind::Command | Kind::MemoryCommand if !active => (cell.id, cell.count) = (0, 0),
            Kind::Sensor | Kind::Monitor => {
                cell.clear(SENT | ASKED);
                cell.set(NEW);
            }
            _ => {}
        }
        body.active(place, active);
    }

    fn hear_control(
        &mut self,
        now: u64,
        full: u64,
        payload: &[u8],
        body: &mut impl Body,
    ) -> Result<(), Dropped> {
        let layout = self.layout;
        let (&[number, p0, p1], map) = payload.split_first_chunk().ok_or(Dropped::Payload)?;
        let period = u16::from_be_bytes([p0, p1]);
        if map.len() != layout.map_len() || !is_padded(map, E) {
            return Err(Dropped::Map);
        }
        if !PERIODS.contains(&period) {
            return Err(Dropped::Payload);
        }
        if self.control.is_some_and(|(newest, _)| full < newest) {
            return Ok(());
        }
        if self.control.is_none_or(|(_, last)| last != number) {
            // Data packets that this one has overtaken speak of what was active before: they are late.
            self.floor = self.floor.max(full + 1);
            self.barrier = full + 1;
            if period != self.period {
                self.period = period;
                let latest = now + self.period_us();
                self.next = self.next.min(latest);
                if self.due != NEVER {
                    self.due = self.due.min(latest);
                }
            }
            for place in 0..E {
                self.activate(place as u8, bit(map, place), body);
            }
        }
        self.control = Some((full, number));
        self.answers.control = true;
        Ok(())
    }

    /// A middle asks for a session.
    fn hear_hello(
        &mut self,
        now: u64,
        header: &Header,
        datagram: &[u8],
        body: &mut impl Body,
    ) -> Result<(), Dropped> {
        let key = self.settings.key.as_ref();
        let payload = seal::checked(key, header, datagram)?;
        let hello = Hello::parse(payload)?;
        self.watch(now, body);
        let second = now / 1_000_000;
        if self.flood.0 != second {
            self.flood = (second, 0);
        }
        if self.flood.1 >= ANSWERS {
            return Err(Dropped::Flood);
        }
        self.flood.1 += 1;
        let alive = match self.phase {
            Phase::Up if !self.is_watched() => now.saturating_sub(self.fed) < ALIVE,
            Phase::Up => true,
            Phase::Ending | Phase::Down => false,
        };
        let refusal = if header.version != VERSION {
            Some((OTHER_VERSION, Dropped::Version))
        } else if hello.hash[..] != self.layout.hash[..] || header.model != self.layout.id {
            Some((MODEL, Dropped::Model))
        } else if alive {
            Some((BUSY, Dropped::Busy))
        } else {
            None
        };
        if let Some((reason, dropped)) = refusal {
            self.answers.refusal = Some((reason, hello.nonce));
            return Err(dropped);
        }
        // The same hello again has the same answer.
        let known = self.pending.as_ref();
        if known.is_none_or(|known| known.hello != hello.nonce) {
            let pending = self.pending.insert(Pending {
                hello: hello.nonce,
                welcome: [0; seal::NONCE],
                session: [0; 6],
                period: hello.period,
                paper: hello.paper,
            });
            body.random(&mut pending.welcome);
            body.random(&mut pending.session);
        }
        self.answers.welcome = true;
        Ok(())
    }

    /// What stands in a welcome.
    pub(super) fn welcome(&self, pending: &Pending) -> handshake::Welcome {
        handshake::Welcome {
            nonce: pending.welcome,
            echo: pending.hello,
            hash: self.layout.hash,
            buffers: B as u8,
        }
    }

    /// The watchdog: a silent middle commands nothing.
    pub(super) fn watch(&mut self, now: u64, body: &mut impl Body) {
        let silent = now.saturating_sub(self.fed);
        match self.phase {
            Phase::Up if self.is_watched() && silent >= self.watchdog_us() => self.over(body),
            Phase::Ending if silent >= ALIVE => self.phase = Phase::Down,
            _ => {}
        }
    }

    pub(super) fn is_watched(&self) -> bool {
        !self.paper && self.settings.watchdog > 0
    }

    pub(super) fn watchdog_us(&self) -> u64 {
        u64::from(self.settings.watchdog) * 1000
    }
}
