//! The queue of a token: grabs that wait until it is their turn.

use mom_managers::{Answer, Micros};
use mom_proto::event::{self, Reason};
use mom_proto::{Code, ContextNumber, Map, Verb, WireError};

use crate::asking::consult::Wish;
use crate::asking::questions::Heard;
use crate::hub::Timer;
use crate::ownership::change::{fence_value, millis};
use crate::ownership::grant::Change;
use crate::token::state::{Token, Waiter};
use crate::{Effect, Hub, PeerId};

/// Grabs that may wait for one token.
pub(crate) const MOST: usize = 4096;

/// Up to this place each step forward is told, beyond it every so many: a queue of a thousand must not cost a
/// thousand events for each grant.
const TOLD: usize = 8;

/// A grab that wants to wait.
pub(crate) struct Wait {
    pub(crate) peer: PeerId,
    pub(crate) id: Option<u64>,
    /// For how long; none = until it has the token.
    pub(crate) time: Option<Micros>,
    pub(crate) answers: Vec<Heard>,
}

impl Hub {
    /// Puts a grab into the queue.
    ///
    /// # Errors
    /// `full`, or `held` if the peer waits already.
    pub(crate) fn wait(
        &mut self,
        number: ContextNumber,
        wait: Wait,
        out: &mut Vec<Effect>,
    ) -> Result<(), WireError> {
        let level = self
            .peers
            .get(wait.peer)
            .map(|peer| peer.facts.level)
            .unwrap_or_default();
        let (now, ticket) = (self.now, self.last_waiter + 1);
        let Some(token) = self.token_mut(number) else {
            return Ok(());
        };
        if let Some(place) = place_of(token, wait.peer) {
            let text = "this peer waits for it already; release takes that back";
            let place = fence_value(place as u64 + 1);
            return Err(WireError::new(Code::HELD, text).detail("place", place));
        }
        if token.queue.len() >= MOST {
            let text = format!("{MOST} peers wait for it, as many as may");
            return Err(WireError::new(Code::FULL, text));
        }
        let until = wait.time.map(|time| now.saturating_add(time));
        let place = token.place_for(level);
        let waiter = Waiter {
            peer: wait.peer,
            ticket,
            id: wait.id,
            level,
            since: now,
            until,
            answers: wait.answers,
            told: 0,
        };
        token.queue.insert(place, waiter);
        self.last_waiter = ticket;
        if let Some(until) = until {
            self.timers.insert((until, Timer::Wait(number, ticket)));
        }
        self.involve(wait.peer, number);
        // Who owns it lazily has to go now once the lease is over.
        self.retime(number);
        self.change_guarded_routes(number);
        self.told_places(number, out);
        Ok(())
    }

    /// Takes a waiting grab out of the queue, without an answer.
    pub(crate) fn take_waiter(&mut self, number: ContextNumber, ticket: u64) -> Option<Waiter> {
        let token = self.token_mut(number)?;
        let place = token.queue.iter().position(|waiter| waiter.ticket == ticket)?;
        let waiter = token.queue.remove(place);
        if let Some(until) = waiter.until {
            self.timers.remove(&(until, Timer::Wait(number, ticket)));
        }
        self.uninvolve(waiter.peer, number);
        self.retime(number);
        self.change_guarded_routes(number);
        Some(waiter)
    }

    /// Answers all waiting grabs of a peer on a token with an error; whether there were some.
    pub(crate) fn withdraw(
        &mut self,
        number: ContextNumber,
        peer: PeerId,
        error: &WireError,
        out: &mut Vec<Effect>,
    ) -> bool {
        let waiting = self
            .token(number)
            .and_then(|token| token.queue.iter().find(|waiter| waiter.peer == peer));
        let Some(ticket) = waiting.map(|waiter| waiter.ticket) else {
            return false;
        };
        if let Some(waiter) = self.take_waiter(number, ticket) {
            self.refuse_all(&[(waiter.peer, waiter.id)], error, Verb::Grab, number, out);
        }
        self.told_places(number, out);
        true
    }

    /// A grab has waited as long as it wanted to.
    pub(crate) fn handle_waited(&mut self, number: ContextNumber, ticket: u64, out: &mut Vec<Effect>) {
        let Some(waiter) = self.take_waiter(number, ticket) else {
            return;
        };
        let mut error = self.held(waiter.peer, number);
        error.code = Code::TIMED_OUT;
        error.text = format!("waited {} ms; {}", (self.now - waiter.since) / 1000, error.text);
        self.refuse_all(&[(waiter.peer, waiter.id)], &error, Verb::Grab, number, out);
        self.told_places(number, out);
    }

    /// Answers all grabs that wait for a token that is about to go.
    pub(crate) fn withdraw_all(&mut self, number: ContextNumber, error: &WireError, out: &mut Vec<Effect>) {
        let waiting = self.token(number).map(|token| token.queue.clone());
        for waiter in waiting.unwrap_or_default() {
            self.take_waiter(number, waiter.ticket);
            self.refuse_all(&[(waiter.peer, waiter.id)], error, Verb::Grab, number, out);
        }
    }

    /// Gives a free token to the first of its queue whom the manager lets have it.
    pub(crate) fn advance_queue(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        let mut refused = false;
        while let Some(waiter) = self.first_for_free(number) {
            let answers = std::mem::replace(&mut self.answers, waiter.answers.clone());
            let verdict = self.consult(waiter.peer, &Wish::new(Verb::Grab, number));
            self.answers = answers;
            let error = match verdict.answer {
                Answer::Allow(grant) => {
                    self.take_waiter(number, waiter.ticket);
                    let change = Change {
                        until: grant.until,
                        rule: verdict.rule,
                        answers: vec![(waiter.peer, waiter.id)],
                        ..Change::to(waiter.peer, Reason::Released)
                    };
                    self.hand(number, change, out);
                    continue;
                }
                // Free, and yet not for this one now: it waits on, for as long as it wanted to.
                Answer::Queue(_) => break,
                Answer::Deny(denial) if denial.code == Code::HELD => break,
                Answer::Deny(denial) => self.explain(waiter.peer, &Wish::new(Verb::Grab, number), &denial),
                Answer::Defer(defer) => {
                    let text = "the answer of who had to be asked holds no more";
                    WireError::new(Code::DENIED, text).rule(&defer.label)
                }
            };
            self.take_waiter(number, waiter.ticket);
            self.refuse_all(&[(waiter.peer, waiter.id)], &error, Verb::Grab, number, out);
            refused = true;
        }
        // Once for all: each of thousands that may be refused moves all behind it. Also after a grant that could not be
        // stored or whose peer was gone, which left the queue for nothing; one that is being stored tells at its end.
        let storing = self.token(number).is_some_and(|token| token.storing.is_some());
        if refused || !storing {
            self.told_places(number, out);
        }
    }

    /// The first of the queue of a free token from whom no restart keeps it: who had it before may have come back
    /// behind others.
    fn first_for_free(&self, number: ContextNumber) -> Option<Waiter> {
        let token = self.token(number).filter(|token| token.is_free())?;
        let mut queue = token.queue.iter();
        queue
            .find(|waiter| self.kept_by_restart(token, waiter.peer).is_none())
            .cloned()
    }

    /// Tells those who wait their places, and the owner the end of its turn, as far as these have changed.
    pub(crate) fn told_places(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        self.tell_waiting(number, out);
        self.tell_owner(number, out);
    }

    /// Who has the token for a turn only has it for as long as it likes while nobody waits: it has to hear when that
    /// is over.
    fn tell_owner(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        let Some(token) = self.token_mut(number) else {
            return;
        };
        let (end, waiting) = (token.hold_end(), token.queue.len());
        let Some(owner) = token.owner.as_mut().filter(|owner| owner.noticed != end) else {
            return;
        };
        owner.noticed = end;
        let peer = owner.peer;
        let path = self.tree.get(number).map(|context| context.path.clone());
        if let Some((end, path)) = end.zip(path) {
            let content = Map::new()
                .with("within", self.millis_until(end))
                .with("waiting", fence_value(waiting as u64));
            self.push_event(event::NOTICE, &path, vec![peer], content, out);
        }
    }

    fn tell_waiting(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        let now = self.now;
        let Some(token) = self.token_mut(number) else {
            return;
        };
        let mut news = Vec::new();
        let turns = Turns::of(token, now);
        for (index, waiter) in token.queue.iter_mut().enumerate() {
            let place = index + 1;
            if waiter.told == place || (waiter.told > 0 && place > TOLD && !place.is_multiple_of(TOLD)) {
                continue;
            }
            waiter.told = place;
            news.push((waiter.peer, place, turns.expected(index)));
        }
        let Some(path) = self.tree.get(number).map(|context| context.path.clone()) else {
            return;
        };
        for (peer, place, expected) in news {
            let mut content = Map::new().with("place", fence_value(place as u64));
            if let Some(expected) = expected {
                content.set("expected", millis(expected));
            }
            self.push_event(event::QUEUED, &path, vec![peer], content, out);
        }
    }
}

/// How long those who wait have to, if nobody renews and everybody takes the whole turn.
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

/// The place at which a peer waits, from 0.
pub(crate) fn place_of(token: &Token, peer: PeerId) -> Option<usize> {
    token.queue.iter().position(|waiter| waiter.peer == peer)
}
