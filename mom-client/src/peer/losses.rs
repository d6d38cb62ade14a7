//! Messages that will not be sent, or not again, and who is told.

use std::collections::BTreeMap;
use std::sync::Arc;

use mom_net::DropReason;
use mom_proto::event as names;
use mom_proto::{Code, Family, Map, Parcel, Path, WireError};

use crate::peer::shared::Shared;
use crate::peer::state::State;
use crate::wire::outbox::{Capacity, Dropped, Entry};
use crate::{ClientError, Event};

impl Shared {
    /// Tells of what will not be sent, or not again: callers that wait for an answer by that, all others where the context is heard.
    pub(crate) fn tell_dropped(&self, dropped: &Dropped) {
        if dropped.is_empty() {
            return;
        }
        let mut failed = Vec::new();
        let mut state = self.lock();
        let capacity = state.lose(dropped);
        for (entry, reason) in dropped {
            let Some(error) = unsent(*reason) else { continue };
            entry.id.into_iter().for_each(|id| state.guards.ended(id));
            let waiter = entry.id.and_then(|id| state.pending.take(id));
            failed.extend(waiter.map(|waiter| (waiter, error)));
        }
        drop(state);
        self.give_capacity(capacity);
        for (waiter, error) in failed {
            self.fail(waiter, &error);
        }
    }
}

impl State {
    /// Tells of messages that will not be sent; gives their capacity.
    pub(crate) fn lose(&mut self, messages: &[(Arc<Entry>, DropReason)]) -> Capacity {
        let mut counts: BTreeMap<(&Path, &str), u64> = BTreeMap::new();
        let mut capacity = Capacity::default();
        for (message, reason) in messages {
            capacity += message.take_capacity();
            let word = match reason {
                DropReason::Closed => names::Reason::Disconnected.word(),
                reason => reason.word(),
            };
            match message.path() {
                Some(path) if *reason == DropReason::Replaced => {
                    *self.replaced.entry(path.clone()).or_default() += 1;
                }
                Some(path) => *counts.entry((path, word)).or_default() += 1,
                None => {}
            }
        }
        for ((path, word), count) in counts {
            let event = dropped(path, word, count);
            self.subscribers.deliver(std::slice::from_ref(path), event);
        }
        capacity
    }

    /// Tells how many messages newer ones have replaced since this was last done.
    pub(crate) fn tell_replaced(&mut self) {
        for (path, count) in std::mem::take(&mut self.replaced) {
            let event = dropped(&path, DropReason::Replaced.word(), count);
            self.subscribers.deliver(std::slice::from_ref(&path), event);
        }
    }
}

/// The event that the hub would send for parcels dropped on its side.
pub(crate) fn dropped(path: &Path, reason: &str, count: u64) -> Event {
    let content = Map::new()
        .with("reason", reason)
        .with("count", i64::try_from(count).unwrap_or(i64::MAX));
    Event::Dropped {
        reason: reason.to_owned(),
        count,
        parcel: Parcel::new(Family::Event, names::DROPPED)
            .context(path.clone())
            .content(content),
    }
}

/// What who waits for an answer hears of a parcel that will not be sent, or not again; none where a lost link tells it.
fn unsent(reason: DropReason) -> Option<ClientError> {
    let local = |code, text: &str| Some(ClientError::Local(WireError::new(code, text)));
    match reason {
        DropReason::Withdrawn => local(
            Code::WITHDRAWN,
            "a stop came after this unstop, before it was sent",
        ),
        DropReason::Replaced => local(Code::WITHDRAWN, "a newer one superseded it before it was sent"),
        DropReason::Expired => local(Code::EXPIRED, "it expired before it was sent"),
        DropReason::Lost => {
            let text =
                "the connection was lost before this was sent, and it would arrive too late: it is not sent";
            Some(ClientError::Connection(text.to_owned()))
        }
        DropReason::Unknown => {
            let text = "the connection was lost after it had left, whether the hub has read it cannot be known, and it is not sent again";
            Some(ClientError::Unknown(WireError::new(Code::DISCONNECTED, text)))
        }
        _ => None,
    }
}
