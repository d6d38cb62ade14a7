//! Dispatches arriving parcels: replies to their callers, events to their subscribers.

use mom_proto::event as names;
use mom_proto::{Family, HUB, Map, Parcel, Path, WireError};

use crate::peer::pending::AnswerTo;
use crate::peer::shared::Shared;
use crate::peer::state::State;
use crate::wire::trace;
use crate::words::{map_of, number, text};
use crate::{Event, Lost};

/// The message by which a device says how a command goes: `peer` and `id` of the command, `state`.
const STATUS: &str = "status";

impl Shared {
    /// Takes one parcel of the hub.
    pub(crate) fn receive(&self, parcel: Parcel) {
        match parcel.family {
            Family::Reply | Family::Error => self.receive_answer(parcel),
            Family::Time if parcel.name() == "ping" => self.pong(parcel.id),
            Family::Time if parcel.name() == "ack" => self.acknowledged(&parcel),
            Family::Time => self.receive_pong(&parcel),
            Family::Event => self.receive_event(parcel),
            Family::Manager if parcel.name() == "consult" => self.receive_consult(parcel),
            _ => {
                trace::received(&parcel);
                let paths: Vec<Path> = parcel.context.iter().cloned().collect();
                let is_stop = [names::STOP, names::UNSTOP].contains(&parcel.name());
                let status = (parcel.name() == STATUS && !parcel.is_history()).then(|| map_of(&parcel));
                let is_halt = parcel.name() == names::HALT && parcel.sender.as_deref() == Some(HUB);
                let halt = is_halt.then(|| map_of(&parcel));
                let event = Event::from_parcel(parcel);
                let mut state = self.lock();
                if let Some(path) = paths.first().filter(|_| is_stop) {
                    state.places.note_stops(path, &event);
                }
                if let (Some(path), Some(halt)) = (paths.first(), &halt) {
                    state.places.note_guard(path, halt);
                }
                status.into_iter().for_each(|status| state.note_status(&status));
                state.subscribers.deliver(&paths, event);
            }
        }
    }

    /// A malformed frame of the hub: it is reported as a loss.
    pub(crate) fn receive_malformed(&self, error: WireError) {
        tracing::warn!(%error, "malformed parcel from the hub");
        self.lock()
            .subscribers
            .deliver_unaddressed(Event::Refused(error, None));
    }

    fn receive_answer(&self, parcel: Parcel) {
        let mut state = self.lock();
        if parcel.family == Family::Error {
            let error = WireError::from_parcel(&parcel);
            if error.code.closes() {
                state.closing = Some(error);
            }
            parcel.reference.into_iter().for_each(|id| state.guards.ended(id));
        }
        let waiter = parcel
            .reference
            .and_then(|reference| state.pending.take(reference));
        match waiter {
            Some(waiter) => {
                drop(state);
                self.complete(waiter, parcel);
            }
            None if parcel.family == Family::Error => state.deliver_refused(&parcel),
            None => tracing::debug!(
                reference = parcel.reference,
                "a reply to a request that was given up"
            ),
        }
    }

    /// Pings the hub: a sign of life, and an exchange of stamps.
    pub(crate) fn measure(&self) {
        let id = self.next_id();
        let ping = Parcel::new(Family::Time, "ping")
            .id(id)
            .content(self.clock.ask(id));
        let mut state = self.lock();
        // Nothing is sent after the farewell, and a lost link needs no heartbeat.
        if !state.outbox.is_finished() {
            self.tell_read(&mut state);
            let _ = self.ask_in(&mut state, ping, &mut Some(AnswerTo::Nobody));
        }
        drop(state);
        self.outgoing.notify_one();
    }

    fn pong(&self, reference: Option<u64>) {
        let mut pong = Parcel::new(Family::Time, "pong").content(self.clock.answer());
        pong.reference = reference;
        let mut state = self.lock();
        self.tell_read(&mut state);
        // A lost link needs no pong, and a pong has no answer.
        let _ = self.ask_in(&mut state, pong, &mut None);
        drop(state);
        self.outgoing.notify_one();
    }

    fn receive_pong(&self, pong: &Parcel) {
        let waiter = pong
            .reference
            .and_then(|reference| self.lock().pending.take(reference));
        // Only pings are answered this way.
        drop(waiter);
        if self.clock.answered(pong) {
            self.measure();
        }
    }

    fn receive_consult(&self, parcel: Parcel) {
        let mut state = self.lock();
        let paths: Vec<Path> = parcel.context.iter().cloned().collect();
        // Nobody here answers questions: the hub asks others, or refuses when the time is over.
        if let Some(question) = state.subscribers.deliver_consult(Event::Other(parcel)) {
            state.subscribers.deliver(&paths, question);
        }
    }

    fn receive_event(&self, parcel: Parcel) {
        let mut state = self.lock();
        let Some(path) = parcel.context.clone() else {
            return state.subscribers.deliver_unaddressed(Event::from_parcel(parcel));
        };
        match parcel.name() {
            names::JOINED if state.is_own_arrival(&path, &parcel) => {}
            names::GRABBED | names::RELEASED => {
                self.note_ownership(&mut state, &path, &parcel);
                let paths = state.learn_ownership(&path, &parcel);
                state.subscribers.deliver(&paths, Event::from_parcel(parcel));
            }
            names::DELETED => {
                // The session's members are told too.
                let paths: Vec<Path> = [Some(path.clone()), path.parent()]
                    .into_iter()
                    .flatten()
                    .collect();
                state.subscribers.deliver(&paths, Event::from_parcel(parcel));
                state.handovers.lose_within(&path, &Lost::new("deleted", None));
                state.places.remove_within(&path);
                state.subscribers.close_within(&path);
            }
            names::EXPELLED if state.is_me(&parcel) => {
                let paths = std::slice::from_ref(&path);
                let by = text(&map_of(&parcel), "by").map(str::to_owned);
                state.subscribers.deliver(paths, Event::from_parcel(parcel));
                state.handovers.lose_within(&path, &Lost::new("revoked", by));
                state.places.remove_within(&path);
                state.subscribers.close_within(&path);
            }
            names::STOPPED | names::UNSTOPPED => {
                let event = Event::from_parcel(parcel);
                state.places.note_stops(&path, &event);
                state.subscribers.deliver(&[path], event);
            }
            name => {
                match name {
                    names::QUEUED => self.note_place(&mut state, &path, &parcel),
                    names::LAPSED => state.note_lapsed(&path, &parcel),
                    names::UNINHIBITED => state.note_uninhibited(&path, &parcel),
                    _ => {}
                }
                state.subscribers.deliver(&[path], Event::from_parcel(parcel));
            }
        }
    }
}

impl State {
    /// Takes in how a device says that a command of this peer ended.
    fn note_status(&self, status: &Map) {
        let ended = matches!(text(status, "state"), Some("finished" | "error"));
        let own = text(status, "peer") == Some(self.me.peer.as_str());
        if let Some(id) = number(status, "id").filter(|_| ended && own) {
            self.guards.ended(id);
        }
    }

    /// An error about a parcel that nobody awaits, or about none in particular.
    fn deliver_refused(&mut self, parcel: &Parcel) {
        let known = parcel
            .reference
            .and_then(|id| self.pending.context_of(id))
            .cloned();
        let paths: Vec<Path> = known.or_else(|| parcel.context.clone()).into_iter().collect();
        let event = Event::Refused(WireError::from_parcel(parcel), parcel.reference);
        self.subscribers.deliver(&paths, event);
    }

    /// Whether this is what the reply to our own join says too.
    fn is_own_arrival(&self, path: &Path, parcel: &Parcel) -> bool {
        self.places.is_joining(path) && self.is_me(parcel)
    }

    /// Whether an event is about this peer.
    fn is_me(&self, parcel: &Parcel) -> bool {
        text(&map_of(parcel), "peer") == Some(self.me.peer.as_str())
    }

    /// Informs the gates of the channels that the token guards; gives all contexts concerned.
    fn learn_ownership(&self, token: &Path, parcel: &Parcel) -> Vec<Path> {
        let mut paths = vec![token.clone()];
        for (path, gate) in self.places.guarded_by(token) {
            gate.observe(parcel);
            paths.push(path.clone());
        }
        paths
    }
}
