//! Completes requests with their answers.

use std::sync::Arc;
use std::time::Duration;

use mom_proto::{Code, Family, Parcel, Path, WireError};
use tokio::time::Instant;

use crate::peer::holds::HoldingKind;
use crate::peer::pending::{AnswerTo, RequestResult};
use crate::peer::shared::Shared;
use crate::peer::state::State;
use crate::peer::wanted::JoinPhase;
use crate::said::ownership::RenewalTerms;
use crate::words::map_of;
use crate::{ClientError, Event, Lost};

/// The delay before retrying a renewal that the hub refused with `try-later` but no time.
const RETRY: Duration = Duration::from_secs(1);

impl Shared {
    /// Gives an answer to its receiver. Called without the lock: see [`AnswerTo`].
    pub(crate) fn complete(&self, waiter: AnswerTo, parcel: Parcel) {
        let id = parcel.reference;
        let answer = match parcel.family {
            Family::Error => Err(ClientError::Refused(WireError::from_parcel(&parcel))),
            _ => Ok(parcel),
        };
        match waiter {
            AnswerTo::Join(path, serial) => self.complete_join(&path, serial, answer),
            AnswerTo::Renewal(path, fence) => self.complete_renewal(&path, fence, answer),
            waiter => settle(waiter, id, answer),
        }
    }

    /// Tells the receiver that no answer comes. Called without the lock, too.
    pub(crate) fn fail(&self, waiter: AnswerTo, error: &ClientError) {
        match waiter {
            // The places and guards know already.
            AnswerTo::Join(..) | AnswerTo::Renewal(..) => {}
            waiter => settle(waiter, None, Err(error.clone())),
        }
    }

    fn complete_join(&self, path: &Path, serial: u64, answer: RequestResult) {
        let mut state = self.lock();
        let Some(place) = state.places.get(path, serial) else {
            return;
        };
        let before = std::mem::replace(&mut place.phase, JoinPhase::Away);
        let JoinPhase::Joining { again, waiters } = before else {
            place.phase = before;
            return;
        };
        let joined = answer.map(|parcel| Arc::new(map_of(&parcel)));
        match &joined {
            Ok(info) => {
                place.gate.joined(info);
                place.phase = JoinPhase::Joined(Arc::clone(info));
                let word = state.places.first_word(path, info);
                if !again {
                    state.subscribers.keep_early(path);
                }
                // A device moves nothing before it has heard how it stands.
                for event in word.iter().chain(again.then_some(&Event::Rejoined)) {
                    state.subscribers.deliver_only(path, event);
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

    fn complete_renewal(&self, path: &Path, fence: u64, answer: RequestResult) {
        let now = Instant::now();
        let mut state = self.lock();
        match answer {
            Ok(parcel) => state
                .guards
                .renewed(path, fence, RenewalTerms::read(&map_of(&parcel)), now),
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
                    // When a guard is told that ownership is over, the hub must not still count this peer as owner.
                    if was_held && error.code != Code::NOT_OWNER {
                        self.end_in(&mut state, HoldingKind::Ownership, path, Some(fence));
                    }
                }
            }
        }
        drop(state);
        self.outgoing.notify_one();
        self.keeping.notify_one();
    }
}

impl State {
    /// One join after a lost link is answered.
    fn note_rejoin(&mut self) {
        self.rejoining = self.rejoining.saturating_sub(1);
        if self.rejoining == 0 {
            self.subscribers.deliver_unaddressed(Event::Rejoined);
        }
    }
}

fn settle(waiter: AnswerTo, id: Option<u64>, answer: RequestResult) {
    match waiter {
        // A caller that went away needs no answer.
        AnswerTo::Caller(sender) => drop(sender.send(answer)),
        AnswerTo::Taker(taker) => taker.take(id, answer),
        AnswerTo::Join(..) | AnswerTo::Renewal(..) | AnswerTo::Nobody => {}
    }
}
