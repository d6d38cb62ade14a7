//! Thinning by a rate: the newest message of each sender and name waits here until the receiver wants the next one.

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use mom_hub::PeerId;
use mom_proto::{ContextNumber, Micros};

use crate::traffic::outbox::packet::{Origin, Packet};

/// Names of one sender in one channel that are thinned each by itself; further ones share one state, or a sender could fill
/// the memory with names.
const NAMES: usize = 64;

/// Senders from which on those are forgotten for which nothing waits.
const SENDERS: usize = 64;

/// A name that no message has.
const OTHERS: &str = "";

type ThinnedSender = (ContextNumber, PeerId);

/// What is thinned for one receiver.
#[derive(Debug, Default)]
pub(super) struct Thinner {
    senders: HashMap<ThinnedSender, HashMap<Arc<str>, Conflated>>,
    /// When which of those may leave for which something waits.
    due: BTreeSet<(Micros, ThinnedSender, Arc<str>)>,
    /// Of what waits.
    bytes: usize,
    sweep_at: usize,
}

#[derive(Debug)]
struct Conflated {
    /// Earliest time of the next delivery.
    next: Micros,
    interval: Micros,
    held: Option<(Arc<Packet>, usize)>,
}

/// What becomes of a message.
#[derive(Debug)]
pub(super) enum Thinned {
    /// It may leave now.
    Now(Arc<Packet>),
    /// It waits.
    Later,
    /// There is no room for it.
    Full(Arc<Packet>),
}

impl Thinner {
    /// Takes in a message of `size` bytes, of which `limit` may wait; gives what became of it, and the older one that
    /// it takes the place of.
    pub(super) fn offer(
        &mut self,
        packet: Arc<Packet>,
        (size, limit): (usize, usize),
        interval: Micros,
        now: Micros,
    ) -> (Thinned, Option<Arc<Packet>>) {
        let (sender, name) = self.slot_of(&packet.origin, now);
        let states = self.senders.entry(sender).or_default();
        let state = states.entry(Arc::clone(&name)).or_insert(Conflated {
            next: now,
            interval,
            held: None,
        });
        state.interval = interval;
        let old = state.held.as_ref().map_or(0, |(_, size)| *size);
        if state.next > now && self.bytes > old && self.bytes - old + size > limit {
            return (Thinned::Full(packet), None);
        }
        let replaced = state.held.take();
        self.bytes -= old;
        let offered = if state.next <= now {
            self.due.remove(&(state.next, sender, name));
            state.next = now.saturating_add(interval);
            Thinned::Now(packet)
        } else {
            state.held = Some((packet, size));
            self.bytes += size;
            self.due.insert((state.next, sender, name));
            Thinned::Later
        };
        (offered, replaced.map(|(packet, _)| packet))
    }

    /// The senders that are known.
    #[cfg(test)]
    pub(super) fn senders(&self) -> usize {
        self.senders.len()
    }

    /// When the next of what waits may leave.
    pub(super) fn due(&self) -> Option<Micros> {
        self.due.first().map(|(at, ..)| *at)
    }

    /// What may leave by now, in the order of its times.
    pub(super) fn release(&mut self, now: Micros) -> Vec<Arc<Packet>> {
        let mut released = Vec::new();
        while self.due().is_some_and(|at| at <= now) {
            let Some((_, sender, name)) = self.due.pop_first() else {
                break;
            };
            let state = self
                .senders
                .get_mut(&sender)
                .and_then(|states| states.get_mut(&name));
            let Some(state) = state else { continue };
            // What waited may have been taken out.
            if let Some((packet, size)) = state.held.take() {
                state.next = now.saturating_add(state.interval);
                self.bytes -= size;
                released.push(packet);
            }
        }
        released
    }

    /// Takes out what waits and does not outlive a loss of the connection.
    pub(super) fn take_late(&mut self) -> Vec<Arc<Packet>> {
        let states = self.senders.values_mut().flat_map(|states| states.values_mut());
        let late = states.filter_map(|state| state.held.take_if(|(packet, _)| !packet.outlives_loss));
        let late: Vec<(Arc<Packet>, usize)> = late.collect();
        self.bytes -= late.iter().map(|(_, size)| size).sum::<usize>();
        late.into_iter().map(|(packet, _)| packet).collect()
    }

    /// Forgets a channel, all channels if none is named; gives what waited.
    pub(super) fn forget(&mut self, channel: Option<ContextNumber>) -> Vec<Arc<Packet>> {
        let concerned = |sender: &ThinnedSender| channel.is_none_or(|channel| sender.0 == channel);
        let due = std::mem::take(&mut self.due);
        let mut held = Vec::new();
        for (at, sender, name) in due {
            if !concerned(&sender) {
                self.due.insert((at, sender, name));
                continue;
            }
            let state = self
                .senders
                .get_mut(&sender)
                .and_then(|states| states.get_mut(&name));
            if let Some((packet, size)) = state.and_then(|state| state.held.take()) {
                self.bytes -= size;
                held.push(packet);
            }
        }
        self.senders.retain(|sender, _| !concerned(sender));
        held
    }

    /// Where the state for a message is kept; what nothing waits for makes way.
    fn slot_of(&mut self, origin: &Origin, now: Micros) -> (ThinnedSender, Arc<str>) {
        let sender = (origin.context, origin.sender);
        let pending = |state: &Conflated| state.held.is_some() || state.next > now;
        if !self.senders.contains_key(&sender) && self.senders.len() >= self.sweep_at.max(SENDERS) {
            self.senders.retain(|_, states| states.values().any(pending));
            self.sweep_at = self.senders.len() * 2;
        }
        let states = self.senders.entry(sender).or_default();
        if !states.contains_key(&origin.name) && states.len() >= NAMES {
            states.retain(|_, state| pending(state));
            if states.len() >= NAMES {
                return (sender, OTHERS.into());
            }
        }
        (sender, Arc::clone(&origin.name))
    }
}
