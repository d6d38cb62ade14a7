//! Grabs that wait until it is their turn.

use mom_managers::Answer;
use mom_proto::event::{self, Reason};
use mom_proto::{Code, ContextNumber, Family, Map, Micros, Parcel, Verb, WireError};

use crate::asking::questions::Due;
use crate::asking::wish::Wish;
use crate::heard::Heard;
use crate::token::state::{Change, QueuedGrab};
use crate::values::{count, millis};
use crate::world::{Timer, World};
use crate::{Effect, PeerId};

impl World {
    /// Puts a grab into the queue.
    ///
    /// # Errors
    /// `full`, or `held` if the peer waits already.
    pub(crate) fn wait(
        &mut self,
        number: ContextNumber,
        waiter: QueuedGrab,
        out: &mut Vec<Effect>,
    ) -> Result<(), WireError> {
        let (peer, ticket, until) = (waiter.peer, waiter.ticket, waiter.until);
        let Some(token) = self.token_mut(number) else {
            return Err(self.faulted("queuing a grab of a token that does not exist"));
        };
        token.enqueue(waiter)?;
        if let Some(until) = until {
            self.timers.insert((until, Timer::Wait(number, ticket)));
        }
        self.involve(peer, number);
        // The owner of a lapsed lazy lease loses it at once now.
        self.retime(number);
        self.change_guarded_routes(number);
        self.tell_queue(number, out);
        Ok(())
    }

    /// Lets a grab wait on about which a peer was asked, with the answers that it has got, and has those behind it looked at.
    pub(crate) fn wait_on(&mut self, number: ContextNumber, ticket: u64, answers: &[Heard]) {
        let waiter = self.token_mut(number).and_then(|token| token.waiter_mut(ticket));
        let Some(waiter) = waiter else {
            return self.fault("continuing the wait of a grab that was not waiting");
        };
        waiter.asking = false;
        waiter.answers = answers.to_vec();
        self.stirred.insert(number);
    }

    /// Takes a waiting grab out of the queue, without an answer.
    pub(crate) fn take_waiter(&mut self, number: ContextNumber, ticket: u64) -> Option<QueuedGrab> {
        let waiter = self.token_mut(number)?.dequeue(ticket)?;
        if let Some(until) = waiter.until {
            self.timers.remove(&(until, Timer::Wait(number, ticket)));
        }
        self.uninvolve(waiter.peer, number);
        self.retime(number);
        self.change_guarded_routes(number);
        if waiter.asking {
            // Those behind it have waited for what is said of it.
            self.stirred.insert(number);
        }
        Some(waiter)
    }

    /// Answers the waiting grab of a peer on a token with an error; whether there was one.
    pub(crate) fn withdraw(
        &mut self,
        number: ContextNumber,
        peer: PeerId,
        error: &WireError,
        out: &mut Vec<Effect>,
    ) -> bool {
        let ticket = self.token(number).and_then(|token| token.ticket_of(peer));
        let Some(waiter) = ticket.and_then(|ticket| self.take_waiter(number, ticket)) else {
            return false;
        };
        self.refuse_all(&[(waiter.peer, waiter.id)], error, Verb::Grab, number, out);
        self.tell_queue(number, out);
        true
    }

    /// Ends a grab that has waited as long as it wanted to.
    pub(crate) fn end_wait(&mut self, number: ContextNumber, ticket: u64, out: &mut Vec<Effect>) {
        let Some(waiter) = self.take_waiter(number, ticket) else {
            return self.fault("ending a wait that was not begun");
        };
        let mut error = self.held(waiter.peer, number);
        error.code = Code::TIMED_OUT;
        error.text = format!("waited {} ms; {}", (self.now - waiter.since) / 1000, error.text);
        self.refuse_all(&[(waiter.peer, waiter.id)], &error, Verb::Grab, number, out);
        self.tell_queue(number, out);
    }

    /// Answers all grabs that wait for a token that is about to go.
    pub(crate) fn withdraw_all(&mut self, number: ContextNumber, error: &WireError, out: &mut Vec<Effect>) {
        let waiting = self.token(number).map(|token| token.queue.clone());
        for waiter in waiting.unwrap_or_default() {
            self.take_waiter(number, waiter.ticket);
            self.refuse_all(&[(waiter.peer, waiter.id)], error, Verb::Grab, number, out);
        }
    }

    /// Grants a free token to the first waiter that the manager allows to have it.
    pub(crate) fn advance_queue(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        // Nothing waits for what is not a token, or none any more.
        if self.token(number).is_none_or(|token| token.queue.is_empty()) {
            return;
        }
        let (mut place, mut refused) = (0, false);
        let mut again: Option<Micros> = None;
        while let Some((at, waiter)) = self.next_waiter(number, place) {
            if waiter.asking {
                break;
            }
            // Others of its user have had it too often: it waits on, and others have their turn.
            if let Err(too_often) = self.check_turn(waiter.peer, number) {
                again = again.into_iter().chain([too_often.wait]).min();
                place = at + 1;
                continue;
            }
            let wish = Wish::new(Verb::Grab, number);
            let verdict = self.consult(waiter.peer, &wish, &waiter.answers);
            let error = match verdict.answer {
                Answer::Allow(grant) => {
                    self.take_waiter(number, waiter.ticket);
                    let change = Change {
                        until: grant.until,
                        rule: verdict.rule,
                        answers: vec![(waiter.peer, waiter.id)],
                        ..Change::to(waiter.peer, Reason::Released)
                    };
                    self.begin_grant(number, change, out);
                    continue;
                }
                // The token is free, and yet not for this one now: it waits on, and is in the way of nobody behind it.
                Answer::Queue(_) => {
                    place = at + 1;
                    continue;
                }
                Answer::Deny(denial) if denial.code == Code::HELD => {
                    place = at + 1;
                    continue;
                }
                Answer::Deny(denial) => self.explain(waiter.peer, &wish, &denial),
                // Those who have to be asked were not asked before, as the token could not be granted then.
                Answer::Defer(_) => {
                    if let Some(token) = self.token_mut(number) {
                        token.set_asking(waiter.ticket, true);
                    }
                    self.to_ask.push((number, waiter.ticket));
                    break;
                }
            };
            self.take_waiter(number, waiter.ticket);
            self.refuse_all(&[(waiter.peer, waiter.id)], &error, Verb::Grab, number, out);
            refused = true;
        }
        if let Some(wait) = again {
            self.timers.insert((self.after(wait), Timer::Turn(number)));
        }
        // Once for all: each of thousands that may be refused moves all behind it. Also after a grant that could not be
        // stored or whose peer was gone, which left the queue for nothing; one that is being stored tells at its end.
        let granting = self.token(number).is_some_and(|token| token.granting.is_some());
        if refused || !granting {
            self.tell_queue(number, out);
        }
    }

    /// Has the queues looked at of those tokens to whose grants the ownership of this one may matter.
    pub(crate) fn stir_neighbours(&mut self, number: ContextNumber) {
        for path in self.neighbours(number) {
            self.stirred
                .extend(self.tree.find(&path).map(|context| context.number));
        }
    }

    /// Has all queues looked at: their managers may decide otherwise from now on.
    pub(crate) fn stir_all(&mut self) {
        let waited_for = self
            .tree
            .iter()
            .filter(|context| context.token().is_some_and(|token| !token.queue.is_empty()));
        self.stirred.extend(waited_for.map(|context| context.number));
    }

    /// Whether this grab waits.
    pub(crate) fn waits(&self, number: ContextNumber, ticket: u64) -> bool {
        let mut queue = self.token(number).into_iter().flat_map(|token| &token.queue);
        queue.any(|waiter| waiter.ticket == ticket)
    }

    /// A waiting grab as the request that it was, with the answers that it has got.
    pub(crate) fn due_grab(&self, number: ContextNumber, ticket: u64) -> Option<Due> {
        let context = self.tree.get(number)?;
        let mut queue = context.token()?.queue.iter();
        let waiter = queue.find(|waiter| waiter.ticket == ticket)?;
        let mut parcel = Parcel::new(Family::Token, Verb::Grab.word()).context(context.path.clone());
        parcel.id = waiter.id;
        Some(Due {
            answers: waiter.answers.clone(),
            waiter: Some((number, ticket)),
            ..Due::new(waiter.peer, parcel)
        })
    }

    fn next_waiter(&self, number: ContextNumber, place: usize) -> Option<(usize, QueuedGrab)> {
        let token = self.token(number)?;
        let next = token.next_waiter(place, |peer| self.holder(peer), self.now);
        next.map(|(place, waiter)| (place, waiter.clone()))
    }

    /// Tells waiters their places, and the owner the end of its turn, as far as these have changed.
    pub(crate) fn tell_queue(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        let now = self.now;
        let Some(context) = self.tree.get_mut(number) else {
            return self.fault("reporting the queue of a token that does not exist");
        };
        let path = context.path.clone();
        let Some(token) = context.token_mut() else {
            return self.fault("reporting the queue of a context that is not a token");
        };
        let (places, turn) = (token.take_place_news(now), token.take_turn_news(now));
        for news in places {
            let mut content = Map::new().with("place", count(news.place));
            if let Some(expected) = news.expected {
                content.set("expected", millis(expected));
            }
            self.push_event(event::QUEUED, &path, vec![news.peer], content, out);
        }
        // As long as nobody waits, an owner keeps the token beyond its turn: it has to hear when that is over.
        if let Some(turn) = turn {
            let content = Map::new()
                .with("within", self.millis_until(turn.end))
                .with("waiting", count(turn.waiting));
            self.push_event(event::NOTICE, &path, vec![turn.owner], content, out);
        }
    }
}
