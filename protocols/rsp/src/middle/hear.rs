//! What a middle's end does with a datagram.

use alloc::borrow::ToOwned;
use alloc::string::String;
use alloc::vec::Vec;

use super::blobs::{Incoming, Part};
use super::clock::Clock;
use super::device::Kept;
use super::{FIRST_MOST, Middle, NOTICES, Notice, Reason, Refusal, State};
use crate::handshake::{self, BUSY, MODEL, REFUSAL, VERSION as OTHER_VERSION, Welcome};
use crate::layout::TAG;
use crate::packet::{bit, is_padded};
use crate::seal::{self, Keys, NONCE};
use crate::traffic::Traffic;
use crate::{Direction, Dropped, Fragment, Header, Item, Items, Kind, Type, VERSION};

/// Keeps the device map that a payload begins with.
pub(super) fn keep_map(kept: &mut Vec<u8>, payload: &[u8], len: usize) {
    kept.clear();
    kept.extend_from_slice(payload.get(..len).unwrap_or_default());
}

impl Middle<'_> {
    /// A datagram has arrived; it is opened in place.
    ///
    /// # Errors
    ///
    /// Why it was dropped, which is counted.
    pub fn receive(&mut self, now: u64, datagram: &mut [u8]) -> Result<(), Dropped> {
        let outcome = self.take(now, datagram);
        self.counters.count(outcome)
    }

    fn take(&mut self, now: u64, datagram: &mut [u8]) -> Result<(), Dropped> {
        let header = Header::decode(datagram)?;
        match header.kind {
            Type::Refusal => return self.hear_refusal(&header, datagram),
            Type::Welcome | Type::UpData | Type::UpControl | Type::UpFragment | Type::UpEnd => {}
            _ => return Err(Dropped::Type),
        }
        if header.version != VERSION {
            return Err(Dropped::Version);
        }
        if header.model != self.layout.id {
            return Err(Dropped::Model);
        }
        if header.kind == Type::Welcome {
            return self.hear_welcome(now, &header, datagram);
        }
        let known = self
            .traffic
            .as_mut()
            .filter(|traffic| traffic.id == header.session && self.state != State::Calling);
        let (full, payload) = known.ok_or(Dropped::Session)?.open(&header, datagram)?;
        match (header.kind, self.state) {
            (Type::UpEnd, state) => {
                if !payload.is_empty() {
                    return Err(Dropped::Payload);
                }
                self.hear_end(state);
                return Ok(());
            }
            (_, State::Ending | State::Idle | State::Calling) => return Err(Dropped::Session),
            (_, State::Up) => self.heard = now,
        }
        match header.kind {
            Type::UpData => self.hear_data(now, full, &header, payload),
            Type::UpControl => self.hear_control(payload),
            _ => self.hear_fragment(payload),
        }
    }

    fn hear_end(&mut self, state: State) {
        match state {
            State::Up => {
                self.forget();
                self.is_answerer = true;
                self.tell(Notice::Ended);
            }
            State::Ending => self.tell(Notice::Ended),
            State::Idle | State::Calling => {}
        }
        self.state = State::Idle;
        // An end that answers one's own needs no answer, or two ends would answer each other for ever.
        self.due_end = self.is_answerer;
    }

    fn hear_welcome(&mut self, now: u64, header: &Header, datagram: &[u8]) -> Result<(), Dropped> {
        let key = self.settings.key.as_ref();
        let welcome = Welcome::parse(seal::checked(key, header, datagram)?)?;
        if self.state != State::Calling || welcome.echo != self.nonce {
            return Err(Dropped::Session);
        }
        if welcome.hash != self.layout.hash {
            return Err(Dropped::Model);
        }
        let keys = match key {
            None => None,
            Some(key) => {
                let keys = Keys::derive(key, &self.nonce, &welcome.nonce, header.session);
                Some(keys.ok_or(Dropped::Encryption)?)
            }
        };
        self.traffic = Some(Traffic::new(header.session, Direction::Down, keys));
        self.clock = Clock::default();
        (self.state, self.next) = (State::Up, now);
        // The first packet takes a round trip, as the welcome has; those that follow come each period, however far the robot is.
        let way = now.saturating_sub(self.called.unwrap_or(now));
        self.heard = now + way.min(FIRST_MOST);
        (self.cleared, self.is_answerer) = (0, false);
        self.buffers = (welcome.buffers, header.buffers, now);
        self.control.number = 0;
        self.control.is_confirmed = true;
        self.tell(Notice::Up);
        Ok(())
    }

    fn hear_refusal(&mut self, header: &Header, datagram: &[u8]) -> Result<(), Dropped> {
        let mut payload = seal::checked(self.settings.key.as_ref(), header, datagram)?;
        // The longest name would still have found its place.
        let is_whole = datagram.len() + 5 + 255 + TAG <= REFUSAL;
        let [reason] = handshake::take(&mut payload)?;
        let echo: [u8; NONCE] = handshake::take(&mut payload)?;
        let _hash: [u8; 32] = handshake::take(&mut payload)?;
        if self.state != State::Calling || echo != self.nonce {
            return Err(Dropped::Session);
        }
        let (reason, differs) = match reason {
            MODEL => (Reason::Model, self.differs(payload, is_whole)?),
            BUSY => (Reason::Busy, Vec::new()),
            OTHER_VERSION => (Reason::Version, Vec::new()),
            _ => return Err(Dropped::Payload),
        };
        let refusal = Refusal { reason, differs };
        if self.refused.as_ref() != Some(&refusal) {
            self.refused = Some(refusal.clone());
            self.tell(Notice::Refused(refusal));
        }
        Ok(())
    }

    /// The elements in which a robot's list differs from this model, by name; `is_whole` says that the list was not cut off.
    fn differs(&self, mut list: &[u8], is_whole: bool) -> Result<Vec<String>, Dropped> {
        let mut differs = Vec::new();
        let mut ours = self.layout.elements.iter();
        while !list.is_empty() && differs.len() < 512 {
            let digest = u32::from_be_bytes(handshake::take(&mut list)?);
            let [len] = handshake::take(&mut list)?;
            let (name, rest) = list.split_at_checked(usize::from(len)).ok_or(Dropped::Payload)?;
            list = rest;
            let name = core::str::from_utf8(name).map_err(|_| Dropped::Payload)?;
            // One that is at another place differs too: the order is part of the model.
            let here = ours.next();
            if here.is_none_or(|here| here.name != name || here.digest != digest) {
                differs.push(name.to_owned());
            }
            differs.extend(
                here.filter(|here| here.name != name)
                    .map(|here| here.name.to_owned()),
            );
        }
        if is_whole {
            differs.extend(ours.map(|lacking| lacking.name.to_owned()));
        }
        differs.sort_unstable();
        differs.dedup();
        Ok(differs)
    }

    fn hear_data(&mut self, now: u64, full: u64, header: &Header, payload: &[u8]) -> Result<(), Dropped> {
        let layout = self.layout;
        let items = Items::parse(layout, Direction::Up, payload)?;
        let Some(traffic) = &mut self.traffic else {
            return Err(Dropped::Session);
        };
        let is_newest = traffic.data.is_none_or(|newest| full > newest);
        let sent = traffic.next;
        let mut heard = None;
        if is_newest {
            traffic.data = Some(full);
            self.newest = Some(now);
            let [_, up] = &mut self.maps;
            keep_map(up, payload, layout.map_len());
            let back = (sent.wrapping_sub(1) as u16).wrapping_sub(header.last);
            heard = sent
                .checked_sub(1)
                .filter(|_| back < 0x8000)
                .and_then(|newest| newest.checked_sub(u64::from(back)));
            if let Some(sequence) = heard {
                self.clock.heard(header.stamp, sequence, now);
                for device in &mut self.devices {
                    device.confirm(sequence, now, header.stamp);
                }
            }
            if self.buffers.1 >= self.buffers.0 {
                self.buffers.2 = now;
            }
            self.buffers.1 = header.buffers;
        }
        for (place, item) in items {
            match item {
                Item::Value(value) if is_newest => self.hear_value(now, place, value, heard, header.stamp),
                Item::Ack(id) => self.hear_ack(now, place, id),
                Item::Call { id, data } => self.hear_event(now, place, id, data, header.stamp),
                _ => {}
            }
        }
        Ok(())
    }

    fn hear_value(&mut self, now: u64, place: u8, value: &[u8], heard: Option<u64>, stamp: u32) {
        let Some(device) = self.devices.get_mut(usize::from(place)) else {
            return;
        };
        if let (Some(Some(since)), Some(heard)) = (device.asked, heard)
            && heard >= since
        {
            device.asked = None;
        }
        match &mut device.reading {
            Some(reading) => {
                reading.value.clear();
                reading.value.extend_from_slice(value);
                (reading.at, reading.stamp) = (now, stamp);
            }
            none => {
                *none = Some(Kept {
                    value: value.to_vec(),
                    at: now,
                    stamp,
                });
            }
        }
        if !core::mem::replace(&mut device.is_told, true) {
            // One for each element, so that it needs no limit.
            self.notices.push_back(Notice::Changed { element: place });
        }
    }

    fn hear_ack(&mut self, now: u64, place: u8, id: u8) {
        let Some(device) = self.devices.get_mut(usize::from(place)) else {
            return;
        };
        let Some((call, (first, _))) = device.call.as_ref().and_then(|call| Some((call, call.sent?))) else {
            return;
        };
        if call.id == id {
            // As many as `command` has let in.
            self.notices.push_back(Notice::Done {
                element: place,
                ticket: call.ticket,
                after: now.saturating_sub(first),
            });
            device.call = None;
        }
    }

    /// An event is delivered once, and acknowledged each time (S21, S22).
    fn hear_event(&mut self, now: u64, place: u8, id: u8, data: &[u8], stamp: u32) {
        let is_full = self.notices.len() >= NOTICES;
        let is_held = self
            .layout
            .element(place)
            .is_some_and(|element| element.kind == Kind::MemoryEvent);
        let Some(device) = self.devices.get_mut(usize::from(place)) else {
            return;
        };
        // Ids go from 1 to 255 and on with 1. What is older than the last one is late.
        let ahead = (i16::from(id) - i16::from(device.id)).rem_euclid(255);
        match (device.id, ahead) {
            (1.., 0) => device.ack = Some(id),
            (0, _) | (_, 1..=127) if !is_full => {
                (device.id, device.ack) = (id, Some(id));
                // Events of other kinds tell nothing of what is held.
                if is_held {
                    self.buffers.2 = now;
                }
                self.notices.push_back(Notice::Raised {
                    element: place,
                    id,
                    data: data.to_vec(),
                    stamp,
                    at: now,
                });
            }
            // Without an acknowledgement it comes again.
            _ => {}
        }
    }

    fn hear_control(&mut self, payload: &[u8]) -> Result<(), Dropped> {
        let (&number, map) = payload.split_first().ok_or(Dropped::Payload)?;
        if map.len() != self.layout.map_len() || !is_padded(map, self.devices.len()) {
            return Err(Dropped::Map);
        }
        if self.control.is_confirmed || number != self.control.number {
            return Ok(());
        }
        self.control.is_confirmed = true;
        for place in 0..self.devices.len() {
            let active = bit(map, place);
            let Some(device) = self.devices.get_mut(place) else {
                continue;
            };
            if device.active != active {
                device.active = active;
                self.tell(Notice::Active {
                    element: place as u8,
                    active,
                });
            }
        }
        Ok(())
    }

    fn hear_fragment(&mut self, payload: &[u8]) -> Result<(), Dropped> {
        let fragment = Fragment::parse(payload)?;
        let element = fragment.element;
        let known = self
            .layout
            .element(element)
            .filter(|of| matches!(of.kind, Kind::Sensor | Kind::Monitor));
        if known.is_none() {
            return Err(Dropped::Payload);
        }
        let held: usize = self
            .devices
            .iter()
            .filter_map(|device| device.incoming.as_ref())
            .map(Incoming::len)
            .sum();
        let most = self
            .settings
            .blob
            .min((4 * self.settings.blob).saturating_sub(held));
        let Some(device) = self.devices.get_mut(usize::from(element)) else {
            return Err(Dropped::Payload);
        };
        match Incoming::push(&mut device.incoming, &fragment, most, &mut self.lost_blobs) {
            Part::Complete(bytes) if self.notices.len() < NOTICES => self.notices.push_back(Notice::Blob {
                element,
                blob: fragment.blob,
                bytes,
            }),
            Part::Complete(_) => self.lost_blobs = self.lost_blobs.saturating_add(1),
            Part::Large => return Err(Dropped::Payload),
            Part::Kept | Part::Late => {}
        }
        Ok(())
    }
}
