//! The queue of a token: the order of the grabs that wait, and what they are told.

use mom_proto::{Code, Micros, WireError};

use super::record::Holder;
use super::state::{QueuedGrab, Token};
use crate::PeerId;
use crate::values::count;

/// Grabs that may wait for one token.
pub(crate) const MOST: usize = 4096;

/// Up to this place every step forward is told, beyond it every eighth one: a queue of a thousand must not cost a
/// thousand events for each grant.
const TOLD: usize = 8;

/// So long after the owner was told the end of its turn a later one is told, µs.
const NEWS: Micros = 1_000_000;

/// A waiter's place that it was not told yet.
pub(crate) struct PlaceNews {
    pub(crate) peer: PeerId,
    /// From 1.
    pub(crate) place: usize,
    /// µs until its turn.
    pub(crate) expected: Option<Micros>,
}

/// The end of the owner's turn, where it has changed.
pub(crate) struct TurnNews {
    pub(crate) owner: PeerId,
    pub(crate) end: Micros,
    pub(crate) waiting: usize,
}

impl Token {
    /// When the owner has had its turn, because others wait.
    pub(crate) fn hold_end(&self) -> Option<Micros> {
        let owner = self.owner.as_ref()?;
        let hold = self.terms.hold?;
        let first = self.queue.iter().map(|waiter| waiter.since).min()?;
        let noticed = first.saturating_add(self.terms.notice);
        Some(owner.turn.saturating_add(hold).max(noticed))
    }

    /// The place at which a peer waits, from 0.
    pub(crate) fn place_of(&self, peer: PeerId) -> Option<usize> {
        self.queue.iter().position(|waiter| waiter.peer == peer)
    }

    /// The place at which a waiter of this level would be put, from 0.
    pub(crate) fn place_for(&self, level: i32) -> usize {
        if !self.terms.by_level {
            return self.queue.len();
        }
        let before = |waiter: &&QueuedGrab| waiter.level >= level;
        self.queue.iter().take_while(before).count()
    }

    /// The ticket under which a peer waits.
    pub(crate) fn ticket_of(&self, peer: PeerId) -> Option<u64> {
        self.place_of(peer).map(|place| self.queue[place].ticket)
    }

    /// Puts a grab into the queue.
    ///
    /// # Errors
    /// `full`, or `held` if the peer waits already.
    pub(crate) fn enqueue(&mut self, waiter: QueuedGrab) -> Result<(), WireError> {
        if let Some(place) = self.place_of(waiter.peer) {
            let text = "this peer is already waiting for it; release cancels the wait";
            return Err(WireError::new(Code::HELD, text).detail("place", count(place + 1)));
        }
        if self.queue.len() >= MOST {
            let text = format!("{MOST} peers are waiting for it, the limit");
            return Err(WireError::new(Code::FULL, text));
        }
        self.queue.insert(self.place_for(waiter.level), waiter);
        Ok(())
    }

    /// Takes a waiting grab out of the queue.
    pub(crate) fn dequeue(&mut self, ticket: u64) -> Option<QueuedGrab> {
        let place = self.queue.iter().position(|waiter| waiter.ticket == ticket)?;
        Some(self.queue.remove(place))
    }

    /// The first of the queue from `place` on that may have the token if it is free, with its place. After a restart that
    /// need not be the first of all: the former owner may have come back behind others.
    pub(crate) fn next_waiter(
        &self,
        place: usize,
        holder: impl Fn(PeerId) -> Option<Holder>,
        now: Micros,
    ) -> Option<(usize, &QueuedGrab)> {
        let kept = |waiter: &QueuedGrab| self.kept_by_restart(holder(waiter.peer).as_ref(), now).is_some();
        let queue = self.queue.iter().enumerate().skip(place);
        let mut queue = queue.filter(|_| self.is_free());
        queue.find(|(_, waiter)| !kept(waiter))
    }

    /// Notes that a peer is being asked about a waiter, or not any more.
    pub(crate) fn set_asking(&mut self, ticket: u64, asking: bool) {
        if let Some(waiter) = self.waiter_mut(ticket) {
            waiter.asking = asking;
        }
    }

    /// A waiting grab.
    pub(crate) fn waiter_mut(&mut self, ticket: u64) -> Option<&mut QueuedGrab> {
        self.queue.iter_mut().find(|waiter| waiter.ticket == ticket)
    }

    /// The places that have changed since their waiters were told, which from now on count as told.
    pub(crate) fn take_place_news(&mut self, now: Micros) -> Vec<PlaceNews> {
        let turns = Turns::of(self, now);
        let mut news = Vec::new();
        for (index, waiter) in self.queue.iter_mut().enumerate() {
            let place = index + 1;
            if waiter.told == place || (waiter.told > 0 && place > TOLD && !place.is_multiple_of(TOLD)) {
                continue;
            }
            waiter.told = place;
            news.push(PlaceNews {
                peer: waiter.peer,
                place,
                expected: turns.expected(index),
            });
        }
        news
    }

    /// The end of the owner's turn if the owner has to be told, which from now on counts as told.
    pub(crate) fn take_turn_news(&mut self, now: Micros) -> Option<TurnNews> {
        let (end, waiting) = (self.hold_end()?, self.queue.len());
        // That it is later after all is told now and then: who waits and gives up again and again does not fill what waits for the owner.
        let is_news = |(told, at)| end < told || (end > told && now.saturating_sub(at) >= NEWS);
        let owner = self
            .owner
            .as_mut()
            .filter(|owner| owner.noticed.is_none_or(is_news))?;
        owner.noticed = Some((end, now));
        Some(TurnNews {
            owner: owner.peer,
            end,
            waiting,
        })
    }
}

/// How long waiters have to wait if nobody renews and everybody takes the whole turn.
pub(crate) struct Turns {
    first: Option<Micros>,
    each: Option<Micros>,
}

impl Turns {
    pub(crate) fn of(token: &Token, now: Micros) -> Turns {
        let owner = token.owner.as_ref();
        let ends = [
            token.hold_end(),
            owner.and_then(|owner| owner.lease_end),
            owner.and_then(|owner| owner.until),
        ];
        Turns {
            first: ends
                .into_iter()
                .flatten()
                .min()
                .map(|end| end.saturating_sub(now)),
            each: token.terms.hold.or(token.terms.lease),
        }
    }

    /// µs until the turn of the waiter at this place, from 0.
    pub(crate) fn expected(&self, index: usize) -> Option<Micros> {
        let before = u64::try_from(index).unwrap_or(u64::MAX);
        match (self.first, self.each, before) {
            (Some(first), _, 0) => Some(first),
            (Some(first), Some(each), _) => Some(first.saturating_add(each.saturating_mul(before))),
            _ => None,
        }
    }
}
