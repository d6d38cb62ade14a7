//! The network below IP: who sends when, what collides, what is repeated.

use std::collections::VecDeque;

use fastrand::Rng;

use crate::{Access, Counts, Micros, Position, Settings, Station};

/// A frame that waits for its turn.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frame {
    /// The sender knows it by this.
    pub(crate) id: u64,
    pub(crate) to: Station,
    /// Octets of its IP packet.
    pub(crate) packet: u32,
}

/// What became of a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Finished {
    pub(crate) id: u64,
    pub(crate) at: Micros,
    pub(crate) attempts: u32,
    pub(crate) delivered: bool,
}

/// A station's side of the network.
#[derive(Debug)]
struct Terminal {
    position: Position,
    in_reach: bool,
    queue: VecDeque<Frame>,
    /// Since when its first frame is the first.
    ready: Micros,
    /// What it still has to wait when the network is free.
    backoff: Micros,
    /// Its contention window.
    window: u32,
    /// Failed attempts at its first frame.
    failed: u32,
}

/// What happens on the network.
#[derive(Debug)]
enum Phase {
    /// Nothing; backoffs run from this time on.
    Free(Micros),
    /// Frames are on the air until then.
    Sending(Micros, Vec<Station>),
    /// An acknowledgement is, or does not come, until then; these have failed.
    Answering(Micros, Vec<Station>),
}

#[derive(Debug)]
pub(crate) struct Medium {
    settings: Settings,
    terminals: Vec<Terminal>,
    phase: Phase,
    /// Who has the first turn, where access is fair.
    turn: usize,
    random: Rng,
    pub(crate) counts: Counts,
}

impl Medium {
    pub(crate) fn new(settings: Settings) -> Medium {
        Medium {
            random: Rng::with_seed(settings.seed),
            settings,
            terminals: Vec::new(),
            phase: Phase::Free(0),
            turn: 0,
            counts: Counts::default(),
        }
    }

    pub(crate) fn add(&mut self, position: Position) -> Station {
        self.terminals.push(Terminal {
            position,
            in_reach: true,
            queue: VecDeque::new(),
            ready: 0,
            backoff: 0,
            window: self.settings.window,
            failed: 0,
        });
        Station(self.terminals.len() - 1)
    }

    pub(crate) fn knows(&self, station: Station) -> bool {
        station.0 < self.terminals.len()
    }

    pub(crate) fn place(&mut self, station: Station, position: Position) {
        if let Some(terminal) = self.terminals.get_mut(station.0) {
            terminal.position = position;
        }
    }

    pub(crate) fn set_in_reach(&mut self, station: Station, in_reach: bool) {
        if let Some(terminal) = self.terminals.get_mut(station.0) {
            terminal.in_reach = in_reach;
        }
    }

    /// Queues a frame; whether there is room for it.
    pub(crate) fn enqueue(&mut self, now: Micros, from: Station, frame: Frame) -> bool {
        let is_free = matches!(self.phase, Phase::Free(since) if since <= now);
        let drawn = self.draw(self.settings.window);
        let Some(terminal) = self.terminals.get_mut(from.0) else {
            return false;
        };
        if terminal.queue.len() >= self.settings.queue {
            self.counts.overflows += 1;
            return false;
        }
        if terminal.queue.is_empty() {
            terminal.ready = now;
            // Who finds the network free for DIFS sends at once.
            if !is_free && terminal.backoff == 0 {
                terminal.backoff = drawn;
            }
        }
        terminal.queue.push_back(frame);
        true
    }

    /// Drops frames that are not on the air; what is, ends by itself.
    pub(crate) fn forget(&mut self, from: Station, is_of: impl Fn(u64) -> bool) {
        let on_air = match &self.phase {
            Phase::Sending(_, senders) => senders.contains(&from),
            Phase::Answering(_, failed) => failed.contains(&from),
            Phase::Free(_) => false,
        };
        let Some(terminal) = self.terminals.get_mut(from.0) else {
            return;
        };
        let first = terminal.queue.front().map(|frame| frame.id);
        let keeps = |id: u64| (on_air && Some(id) == first) || !is_of(id);
        terminal.queue.retain(|frame| keeps(frame.id));
        if terminal.queue.front().map(|frame| frame.id) != first {
            terminal.failed = 0;
            terminal.window = self.settings.window;
        }
    }

    /// When something happens next.
    pub(crate) fn next(&self) -> Option<Micros> {
        match &self.phase {
            Phase::Sending(until, _) | Phase::Answering(until, _) => Some(*until),
            Phase::Free(since) => {
                let times = self
                    .terminals
                    .iter()
                    .filter_map(|terminal| self.begins(terminal, *since));
                times.min()
            }
        }
    }

    /// When a terminal's first frame goes on the air, unless another's does before; at the begin of a slot.
    fn begins(&self, terminal: &Terminal, since: Micros) -> Option<Micros> {
        terminal.queue.front()?;
        let slot = self.settings.slot.max(1);
        let slots = (terminal.ready - since).max(0).saturating_add(slot - 1) / slot;
        Some(since + terminal.backoff.max(slots * slot))
    }

    /// Carries out what happens next, which is at this time; what became of frames by that.
    pub(crate) fn step(&mut self, now: Micros) -> Vec<Finished> {
        match std::mem::replace(&mut self.phase, Phase::Free(now)) {
            Phase::Free(since) => {
                self.begin(now, since);
                Vec::new()
            }
            Phase::Sending(_, senders) => self.received(now, &senders).into_iter().collect(),
            Phase::Answering(_, failed) => {
                self.phase = Phase::Free(now + self.settings.difs());
                failed
                    .iter()
                    .filter_map(|station| self.repeat(now, *station))
                    .collect()
            }
        }
    }

    /// Puts frames on the air.
    fn begin(&mut self, now: Micros, since: Micros) {
        let due = |index: &usize| {
            let terminal = self.terminals.get(*index);
            terminal.and_then(|terminal| self.begins(terminal, since)) == Some(now)
        };
        let mut senders: Vec<usize> = (0..self.terminals.len()).filter(due).collect();
        if self.settings.access == Access::Fair {
            let next = senders.iter().find(|index| **index >= self.turn);
            senders = next.or(senders.first()).copied().into_iter().collect();
            self.turn = senders.first().map_or(0, |index| index + 1);
        }
        let mut longest = 0;
        for (index, terminal) in self.terminals.iter_mut().enumerate() {
            if senders.contains(&index) {
                let packet = terminal.queue.front().map_or(0, |frame| frame.packet);
                longest = longest.max(self.settings.frame_time(packet));
                self.counts.attempts += 1;
                terminal.backoff = 0;
            } else if self.settings.access == Access::Random || terminal.queue.is_empty() {
                terminal.backoff = (terminal.backoff - (now - since)).max(0);
            }
        }
        if senders.len() > 1 {
            self.counts.collisions += 1;
        }
        // A missing acknowledgement is waited for as long as one takes.
        self.counts.busy += longest + self.settings.sifs + self.settings.ack_time();
        let senders = senders.into_iter().map(Station).collect();
        self.phase = Phase::Sending(now + longest, senders);
    }

    /// Frames have been on the air: one alone may have been received.
    fn received(&mut self, now: Micros, senders: &[Station]) -> Option<Finished> {
        let until = now + self.settings.sifs + self.settings.ack_time();
        let [sender] = senders else {
            self.phase = Phase::Answering(until, senders.to_vec());
            return None;
        };
        let lost = self.loses(*sender);
        self.phase = Phase::Answering(until, if lost { vec![*sender] } else { Vec::new() });
        if lost {
            self.counts.losses += 1;
            return None;
        }
        self.finish(now, *sender, true)
    }

    /// Whether the first frame of a station, alone on the air, is lost.
    fn loses(&mut self, sender: Station) -> bool {
        // One number for each frame, so that what follows does not depend on what is lost.
        let chance = self.random.f64();
        let Some(from) = self.terminals.get(sender.0) else {
            return true;
        };
        let to = from
            .queue
            .front()
            .and_then(|frame| self.terminals.get(frame.to.0));
        let Some(to) = to.filter(|to| to.in_reach && from.in_reach) else {
            return true;
        };
        let distance = from.position.distance(to.position);
        chance < self.settings.loss.probability(distance, self.settings.rate)
    }

    /// An attempt has failed: the frame is tried again, or given up.
    fn repeat(&mut self, now: Micros, station: Station) -> Option<Finished> {
        let terminal = self.terminals.get_mut(station.0)?;
        terminal.failed += 1;
        if terminal.failed >= self.settings.attempts {
            self.counts.given_up += 1;
            return self.finish(now, station, false);
        }
        terminal.window = (terminal.window * 2 + 1).min(self.settings.most_window);
        let backoff = self.draw(self.terminals.get(station.0)?.window);
        self.terminals.get_mut(station.0)?.backoff = backoff;
        None
    }

    /// A station is done with its first frame.
    fn finish(&mut self, now: Micros, station: Station, delivered: bool) -> Option<Finished> {
        let backoff = self.draw(self.settings.window);
        let terminal = self.terminals.get_mut(station.0)?;
        let frame = terminal.queue.pop_front()?;
        let attempts = terminal.failed + u32::from(delivered);
        terminal.window = self.settings.window;
        (terminal.failed, terminal.ready, terminal.backoff) = (0, now, backoff);
        Some(Finished {
            id: frame.id,
            at: now,
            attempts,
            delivered,
        })
    }

    fn draw(&mut self, window: u32) -> Micros {
        match self.settings.access {
            Access::Random => Micros::from(self.random.u32(0..=window)) * self.settings.slot,
            Access::Fair => self.settings.mean_backoff(),
        }
    }
}
