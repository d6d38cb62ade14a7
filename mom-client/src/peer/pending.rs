//! Requests without an answer yet, and recent sends that need none.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use mom_proto::{Parcel, Path};
use tokio::sync::oneshot;

use crate::contexts::membership::Membership;
use crate::peer::handover::Handover;
use crate::{ClientError, Given, InhibitGuard, TokenGuard};

/// How many sends are remembered, to report refusals to the right subscribers.
const RECENT: usize = 1024;

/// Where an answer goes.
pub(crate) type Answering<T> = oneshot::Sender<Result<T, ClientError>>;

/// The receiver of an answer.
///
/// It may hold the last handle of the client, whose drop takes the lock of the state: complete and drop it outside
/// that lock.
#[derive(Debug)]
pub(crate) enum AnswerTo {
    /// A caller.
    Caller(Answering<Parcel>),
    /// A caller that wants a token. The guard is made before the next parcel is read, so it misses no event;
    /// a caller that went away drops it, which gives the token back.
    Obtain {
        member: Membership,
        answer: Answering<TokenGuard>,
    },
    /// A caller that wants a part in a shared hold; likewise.
    Inhibit {
        member: Membership,
        answer: Answering<InhibitGuard>,
    },
    /// An owner that offers its token; likewise.
    Give {
        member: Membership,
        handover: Arc<Handover>,
        answer: Answering<Given>,
    },
    /// All callers that want to be in a context, by its serial.
    Join(Path, u64),
    /// The holder of a token with this fence.
    Renewal(Path, u64),
    /// Nobody; the answer is consumed so that nobody else gets it.
    Nobody,
}

/// The requests by their ids.
#[derive(Debug, Default)]
pub(crate) struct OpenRequests {
    waiters: HashMap<u64, AnswerTo>,
    recent: VecDeque<(u64, Path)>,
}

impl OpenRequests {
    pub(crate) fn insert(&mut self, id: u64, waiter: AnswerTo) {
        self.waiters.insert(id, waiter);
    }

    pub(crate) fn take(&mut self, id: u64) -> Option<AnswerTo> {
        self.waiters.remove(&id)
    }

    pub(crate) fn take_all(&mut self) -> Vec<AnswerTo> {
        self.recent.clear();
        self.waiters.drain().map(|(_, waiter)| waiter).collect()
    }

    /// Notes a send that awaits no answer.
    pub(crate) fn note(&mut self, id: u64, path: Path) {
        if self.recent.len() == RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back((id, path));
    }

    /// The context of such a send. Refusals come soon, so the newest is searched first.
    pub(crate) fn context_of(&self, id: u64) -> Option<&Path> {
        self.recent
            .iter()
            .rev()
            .find(|(known, _)| *known == id)
            .map(|(_, path)| path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_sends_are_remembered() {
        let mut pending = OpenRequests::default();
        let path = Path::parse("/chat").unwrap();
        for id in 0..=RECENT as u64 {
            pending.note(id, path.clone());
        }
        assert_eq!(pending.context_of(0), None, "the oldest went");
        assert_eq!(pending.context_of(1), Some(&path));
        assert_eq!(pending.context_of(RECENT as u64), Some(&path));
    }
}
