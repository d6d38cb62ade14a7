//! Grabs with `wait`: their places in the queue, and their withdrawal.

use std::collections::{HashMap, VecDeque};

use mom_proto::Path;
use tokio::sync::watch;

use crate::Place;

/// The grabs without an answer that are willing to wait, by token, the oldest first.
///
/// The event `queued` names no request. The hub lets one grab of a peer wait for a token at a time and answers in
/// order, so the oldest is meant.
#[derive(Debug, Default)]
pub(crate) struct Waits {
    tokens: HashMap<Path, VecDeque<WaitingGrab>>,
}

#[derive(Debug)]
struct WaitingGrab {
    id: u64,
    place: watch::Sender<Option<Place>>,
    stage: WaitStage,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum WaitStage {
    /// Its caller waits for it.
    Wanted,
    /// Its caller is gone, but it may not be in the queue yet: `release` might end an ownership instead.
    GivenUp,
    /// The hub was told.
    Withdrawn,
}

impl Waits {
    /// A grab that may wait is about to be sent.
    pub(crate) fn add(&mut self, path: &Path, id: u64) -> watch::Receiver<Option<Place>> {
        let (place, places) = watch::channel(None);
        self.tokens
            .entry(path.clone())
            .or_default()
            .push_back(WaitingGrab {
                id,
                place,
                stage: WaitStage::Wanted,
            });
        places
    }

    /// The hub reported a place; returns whether the grab is to be withdrawn now.
    pub(crate) fn queued(&mut self, path: &Path, place: Place) -> bool {
        let Some(wait) = self.tokens.get_mut(path).and_then(VecDeque::front_mut) else {
            return false;
        };
        wait.place.send_replace(Some(place));
        wait.stage == WaitStage::GivenUp && wait.withdraw()
    }

    /// The caller of a grab is gone; returns whether it is to be withdrawn now.
    pub(crate) fn give_up(&mut self, path: &Path, id: u64) -> bool {
        let waits = self.tokens.get_mut(path).into_iter().flatten();
        let Some(wait) = waits.into_iter().find(|wait| wait.id == id) else {
            return false;
        };
        wait.stage = WaitStage::GivenUp;
        let is_queued = wait.place.borrow().is_some();
        is_queued && wait.withdraw()
    }

    /// A grab was answered; returns whether it was withdrawn before, so that its grant is released already.
    pub(crate) fn answered(&mut self, path: &Path, id: u64) -> bool {
        let Some(waits) = self.tokens.get_mut(path) else {
            return false;
        };
        let position = waits.iter().position(|wait| wait.id == id);
        let wait = position.and_then(|position| waits.remove(position));
        if waits.is_empty() {
            self.tokens.remove(path);
        }
        wait.is_some_and(|wait| wait.stage == WaitStage::Withdrawn)
    }

    /// The tokens for which a grab is withdrawn and not answered.
    pub(crate) fn withdrawn(&self) -> Vec<Path> {
        let withdrawn = |wait: &WaitingGrab| wait.stage == WaitStage::Withdrawn;
        let tokens = self
            .tokens
            .iter()
            .filter(|(_, waits)| waits.iter().any(withdrawn));
        tokens.map(|(path, _)| path.clone()).collect()
    }

    /// The link is gone, and with it the queue.
    pub(crate) fn clear(&mut self) {
        self.tokens.clear();
    }
}

impl WaitingGrab {
    fn withdraw(&mut self) -> bool {
        self.stage = WaitStage::Withdrawn;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path() -> Path {
        Path::parse("/t").unwrap()
    }

    fn place(place: u64) -> Place {
        Place {
            place,
            expected: None,
        }
    }

    #[test]
    fn a_place_is_that_of_the_oldest_grab() {
        let mut waits = Waits::default();
        let (one, two) = (waits.add(&path(), 1), waits.add(&path(), 2));
        assert!(!waits.queued(&path(), place(3)));
        assert_eq!((*one.borrow(), *two.borrow()), (Some(place(3)), None));
        assert!(!waits.answered(&path(), 1));
        assert!(!waits.queued(&path(), place(4)));
        assert_eq!(*two.borrow(), Some(place(4)));
        assert!(!waits.answered(&path(), 2));
        assert!(!waits.queued(&path(), place(1)), "of nobody here");
    }

    #[test]
    fn only_what_is_in_the_queue_is_withdrawn_and_once() {
        let mut waits = Waits::default();
        let _one = waits.add(&path(), 1);
        assert!(!waits.give_up(&path(), 1), "it may be granted at once");
        assert!(waits.queued(&path(), place(2)), "now it waits");
        assert!(!waits.queued(&path(), place(1)), "withdrawn already");
        assert!(waits.answered(&path(), 1));

        let _two = waits.add(&path(), 2);
        assert!(!waits.queued(&path(), place(2)));
        assert!(waits.withdrawn().is_empty());
        assert!(waits.give_up(&path(), 2));
        assert_eq!(waits.withdrawn(), [path()]);
        assert!(waits.answered(&path(), 2));
        assert!(!waits.give_up(&path(), 2), "answered");
    }
}
