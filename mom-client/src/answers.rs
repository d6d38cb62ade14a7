//! What an answer means to the one who waits for it.

use std::sync::Arc;
use std::time::Duration;

use mom_proto::{Code, Family, Parcel, Path, WireError};
use tokio::time::Instant;

use crate::guards::Terms;
use crate::info::map_of;
use crate::pending::Waiter;
use crate::places::Phase;
use crate::shared::{Shared, verb};
use crate::{ClientError, Event, Lost};

type Answer = Result<Parcel, ClientError>;

/// Until a renewal is tried again which the hub refused for now without saying for how long.
const RETRY: Duration = Duration::from_secs(1);

impl Shared {
    /// Gives an answer to the one who waits for it. Without the lock: see [`Waiter`].
    pub(crate) fn complete(&self, waiter: Waiter, parcel: Parcel) {
        let id = parcel.reference;
        let answer = match parcel.family {
            Family::Error => Err(ClientError::Refused(WireError::from_parcel(&parcel))),
            _ => Ok(parcel),
        };
        match waiter {
            // One that went away needs no answer.
            Waiter::Caller(sender) => drop(sender.send(answer)),
            Waiter::Obtain {
                member,
                answer: sender,
            } => self.complete_obtain(id, member, sender, answer),
            Waiter::Inhibit {
                member,
                answer: sender,
            } => self.complete_inhibit(member, sender, answer),
            Waiter::Give {
                member,
                handover,
                answer: sender,
            } => self.complete_give(member, handover, sender, answer),
            Waiter::Join(path, serial) => self.complete_join(&path, serial, answer),
            Waiter::Renewal(path, fence) => self.complete_renewal(&path, fence, answer),
            Waiter::Nobody => {}
        }
    }

    /// Tells the one who waits that there is no link any more.
    pub(crate) fn fail(&self, waiter: Waiter, error: &ClientError) {
        match waiter {
            Waiter::Caller(sender) => drop(sender.send(Err(error.clone()))),
            Waiter::Obtain { answer, .. } => drop(answer.send(Err(error.clone()))),
            Waiter::Inhibit { answer, .. } => drop(answer.send(Err(error.clone()))),
            Waiter::Give { answer, .. } => drop(answer.send(Err(error.clone()))),
            // The places and guards know already.
            Waiter::Join(..) | Waiter::Renewal(..) | Waiter::Nobody => {}
        }
    }

    fn complete_join(&self, path: &Path, serial: u64, answer: Answer) {
        let mut state = self.lock();
        let Some(place) = state.places.get(path, serial) else {
            return;
        };
        let before = std::mem::replace(&mut place.phase, Phase::Away);
        let Phase::Joining { again, waiters } = before else {
            place.phase = before;
            return;
        };
        let joined = answer.map(|parcel| Arc::new(map_of(&parcel)));
        match &joined {
            Ok(info) => {
                place.gate.joined(info);
                place.phase = Phase::Joined(Arc::clone(info));
                match again {
                    true => state.subscribers.deliver_only(path, &Event::Rejoined),
                    false => state.subscribers.keep_early(path),
                }
            }
            Err(error) => {
                state.places.remove(path);
                if let (true, Some(error)) = (again, error.wire()) {
                    let event = Event::Refused(error.clone(), None);
                    state.subscribers.deliver(std::slice::from_ref(path), event);
                    state.subscribers.close_within(path);
                }
            }
        }
        if again {
            state.note_rejoin();
        }
        for waiter in waiters {
            drop(waiter.send(joined.clone()));
        }
    }

    fn complete_renewal(&self, path: &Path, fence: u64, answer: Answer) {
        let now = Instant::now();
        let mut state = self.lock();
        match answer {
            Ok(parcel) => state
                .guards
                .renewed(path, fence, Terms::read(&map_of(&parcel)), now),
            Err(error) => {
                let Some(error) = error.wire() else { return };
                if error.code.may_retry() {
                    state
                        .guards
                        .retry(path, fence, now + error.retry_in().unwrap_or(RETRY));
                } else {
                    let owner = error
                        .get("owner")
                        .and_then(mom_proto::Value::as_str)
                        .map(str::to_owned);
                    let was_held = state
                        .guards
                        .lose(path, fence, Lost::new(error.code.word(), owner));
                    // Whoever is told that it is over must not still be the owner at the hub.
                    if was_held && error.code != Code::NOT_OWNER {
                        let release = verb(Family::Token, "release", path);
                        let _ = self.ask_in(&mut state, release, &mut Some(Waiter::Nobody));
                    }
                }
            }
        }
        drop(state);
        self.outgoing.notify_one();
        self.keeping.notify_one();
    }
}

impl crate::shared::State {
    /// One join after a lost link is answered.
    fn note_rejoin(&mut self) {
        self.rejoining = self.rejoining.saturating_sub(1);
        if self.rejoining == 0 {
            self.subscribers.deliver_unaddressed(Event::Rejoined);
        }
    }
}
