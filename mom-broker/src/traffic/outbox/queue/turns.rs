//! What a receiver with a rate is spared: of each sender and name the newest waits here until its turn comes.

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use mom_hub::PeerId;
use mom_managers::Micros;
use mom_proto::ContextNumber;

use crate::traffic::outbox::packet::{Origin, Packet};

/// Names of one sender in one channel that have turns of their own; further ones share one, or a sender could fill
/// the memory with names.
const NAMES: usize = 64;

/// Senders from which on those are looked for whose turns are all over.
const SENDERS: usize = 64;

/// A name that no message has.
const OTHERS: &str = "";

type Sender = (ContextNumber, PeerId);

/// The turns of one receiver.
#[derive(Debug, Default)]
pub(super) struct Turns {
    senders: HashMap<Sender, HashMap<Arc<str>, Turn>>,
    /// When which of those turns come for which something waits.
    due: BTreeSet<(Micros, Sender, Arc<str>)>,
    /// Of what waits.
    bytes: usize,
    sweep_at: usize,
}

#[derive(Debug)]
struct Turn {
    /// No other is handed out before.
    next: Micros,
    interval: Micros,
    held: Option<(Arc<Packet>, usize)>,
}

/// What becomes of a message.
#[derive(Debug)]
pub(super) enum Offered {
    /// It is its turn.
    Now(Arc<Packet>),
    /// It waits.
    Later,
    /// There is no room for it.
    Full(Arc<Packet>),
}

impl Turns {
    /// Takes in a message of `size` bytes, of which `limit` may wait; gives what became of it, and the older one whose
    /// turn will not come any more.
    pub(super) fn offer(
        &mut self,
        packet: Arc<Packet>,
        (size, limit): (usize, usize),
        interval: Micros,
        now: Micros,
    ) -> (Offered, Option<Arc<Packet>>) {
        let (sender, name) = self.place(&packet.origin, now);
        let turns = self.senders.entry(sender).or_default();
        let turn = turns.entry(Arc::clone(&name)).or_insert(Turn {
            next: now,
            interval,
            held: None,
        });
        turn.interval = interval;
        let old = turn.held.as_ref().map_or(0, |(_, size)| *size);
        if turn.next > now && self.bytes > old && self.bytes - old + size > limit {
            return (Offered::Full(packet), None);
        }
        let replaced = turn.held.take();
        self.bytes -= old;
        let offered = if turn.next <= now {
            self.due.remove(&(turn.next, sender, name));
            turn.next = now.saturating_add(interval);
            Offered::Now(packet)
        } else {
            turn.held = Some((packet, size));
            self.bytes += size;
            self.due.insert((turn.next, sender, name));
            Offered::Later
        };
        (offered, replaced.map(|(packet, _)| packet))
    }

    /// The senders whose turns are kept.
    #[cfg(test)]
    pub(super) fn senders(&self) -> usize {
        self.senders.len()
    }

    /// When the next turn comes for which something waits.
    pub(super) fn due(&self) -> Option<Micros> {
        self.due.first().map(|(at, ..)| *at)
    }

    /// What has its turn by now, in the order of the turns.
    pub(super) fn release(&mut self, now: Micros) -> Vec<Arc<Packet>> {
        let mut released = Vec::new();
        while self.due().is_some_and(|at| at <= now) {
            let Some((_, sender, name)) = self.due.pop_first() else {
                break;
            };
            let turn = self
                .senders
                .get_mut(&sender)
                .and_then(|turns| turns.get_mut(&name));
            let Some(turn) = turn else { continue };
            turn.next = now.saturating_add(turn.interval);
            if let Some((packet, size)) = turn.held.take() {
                self.bytes -= size;
                released.push(packet);
            }
        }
        released
    }

    /// Gives up all turns of a channel, of all channels if none is named; gives what waited for them.
    pub(super) fn forget(&mut self, channel: Option<ContextNumber>) -> Vec<Arc<Packet>> {
        let concerned = |sender: &Sender| channel.is_none_or(|channel| sender.0 == channel);
        let due = std::mem::take(&mut self.due);
        let mut held = Vec::new();
        for (at, sender, name) in due {
            if !concerned(&sender) {
                self.due.insert((at, sender, name));
                continue;
            }
            let turn = self
                .senders
                .get_mut(&sender)
                .and_then(|turns| turns.get_mut(&name));
            if let Some((packet, size)) = turn.and_then(|turn| turn.held.take()) {
                self.bytes -= size;
                held.push(packet);
            }
        }
        self.senders.retain(|sender, _| !concerned(sender));
        held
    }

    /// Where the turn of a message is kept; old turns make way for new ones.
    fn place(&mut self, origin: &Origin, now: Micros) -> (Sender, Arc<str>) {
        let sender = (origin.context, origin.sender);
        let pending = |turn: &Turn| turn.held.is_some() || turn.next > now;
        if !self.senders.contains_key(&sender) && self.senders.len() >= self.sweep_at.max(SENDERS) {
            self.senders.retain(|_, turns| turns.values().any(pending));
            self.sweep_at = self.senders.len() * 2;
        }
        let turns = self.senders.entry(sender).or_default();
        if !turns.contains_key(&origin.name) && turns.len() >= NAMES {
            turns.retain(|_, turn| pending(turn));
            if turns.len() >= NAMES {
                return (sender, OTHERS.into());
            }
        }
        (sender, Arc::clone(&origin.name))
    }
}
