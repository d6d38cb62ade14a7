//! Requests without an answer yet, and recent sends that need none.

use std::collections::{HashMap, VecDeque};
use std::fmt;

use mom_proto::{Parcel, Path};
use tokio::sync::oneshot;

use crate::ClientError;

/// How many sends are remembered, to report refusals to the right subscribers.
const RECENT: usize = 1024;

/// A reply, or why there is none.
pub(crate) type RequestResult = Result<Parcel, ClientError>;

/// Where an answer comes.
pub(crate) type Answered<T> = oneshot::Receiver<Result<T, ClientError>>;

/// Makes something of an answer, given with the id of what it answers; none if no answer comes.
pub(crate) struct TakeAnswer(Box<dyn FnOnce(Option<u64>, RequestResult) + Send>);

/// The receiver of an answer.
///
/// It may hold the last handle of the client, whose drop takes the lock of the state: complete and drop it outside
/// that lock.
#[derive(Debug)]
pub(crate) enum AnswerTo {
    /// A caller.
    Caller(oneshot::Sender<RequestResult>),
    /// A caller that wants what is made of the answer, as a token's guard. It is made before the next parcel is read, so it
    /// misses no event.
    Taker(TakeAnswer),
    /// All callers that want to be in a context, by its serial.
    Join(Path, u64),
    /// The holder of a token with this fence.
    Renewal(Path, u64),
    /// Nobody; the answer is consumed so that nobody else gets it.
    Nobody,
}

impl AnswerTo {
    /// Gives the answer to this function.
    pub(crate) fn taker(take: impl FnOnce(Option<u64>, RequestResult) + Send + 'static) -> AnswerTo {
        AnswerTo::Taker(TakeAnswer(Box::new(take)))
    }
}

impl TakeAnswer {
    pub(crate) fn take(self, id: Option<u64>, answer: RequestResult) {
        (self.0)(id, answer);
    }
}

impl fmt::Debug for TakeAnswer {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("TakeAnswer")
    }
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
