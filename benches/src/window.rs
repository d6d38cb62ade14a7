//! The closed window: so many parcels are on their way at most, so that nothing has to be dropped.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::Error;
use crate::driver::PATIENCE;

/// Bytes on their way to one receiver at most, counted as brokers count them: half of what waits for a MOM
/// peer before it is too slow.
const BYTES: usize = 2 * 1024 * 1024;
/// What a queued parcel costs beside its bytes.
const OVERHEAD: usize = 128;
const MOST: usize = 8192;
/// Deliveries on their way to all receivers at most: a hub that makes fifty thousand in a second has to get through.
const TOGETHER: usize = 500_000;

/// What sender and receivers of one stream know of each other.
#[derive(Debug)]
pub(crate) struct Window {
    size: u32,
    state: Mutex<State>,
    moved: Condvar,
}

#[derive(Debug, Default)]
struct State {
    /// What the slowest receiver has.
    arrived: u32,
    failure: Option<Error>,
    failed: bool,
}

impl Window {
    pub(crate) fn new(frame: usize, receivers: usize) -> Window {
        let most = MOST.min(TOGETHER / receivers.max(1)).max(2);
        let size = (BYTES / (frame + OVERHEAD)).clamp(2, most);
        Window::of(u32::try_from(size).unwrap_or(u32::MAX))
    }

    /// A window of so many.
    pub(crate) fn of(size: u32) -> Window {
        Window {
            size,
            state: Mutex::default(),
            moved: Condvar::new(),
        }
    }

    /// How many may be sent now, `sent` being on their way or there; waits until it is worth a write. None
    /// once something has failed.
    pub(crate) fn open(&self, sent: u32) -> Result<Option<u32>, Error> {
        let worth = (self.size / 4).max(1);
        self.wait("the stream", |state| {
            if state.failed {
                return Some(None);
            }
            let room = self.size - (sent - state.arrived);
            (room >= worth).then_some(Some(room))
        })
    }

    /// Waits until all is there.
    pub(crate) fn drained(&self, sent: u32) -> Result<(), Error> {
        self.wait("the end of the stream", |state| {
            (state.failed || state.arrived >= sent).then_some(())
        })
    }

    /// The slowest receiver has so many.
    pub(crate) fn advance(&self, arrived: u32) {
        let mut state = self.lock();
        if arrived > state.arrived {
            state.arrived = arrived;
            drop(state);
            self.moved.notify_all();
        }
    }

    /// Ends the stream; the first reason is the one that is told.
    pub(crate) fn fail(&self, error: Error) {
        let mut state = self.lock();
        state.failed = true;
        state.failure.get_or_insert(error);
        drop(state);
        self.moved.notify_all();
    }

    /// The failure, if there was one.
    pub(crate) fn result(&self) -> Result<(), Error> {
        self.lock().failure.take().map_or(Ok(()), Err)
    }

    fn wait<T>(&self, what: &str, ready: impl Fn(&State) -> Option<T>) -> Result<T, Error> {
        let mut state = self.lock();
        let mut waited = Duration::ZERO;
        loop {
            if let Some(ready) = ready(&state) {
                return Ok(ready);
            }
            if waited >= PATIENCE {
                return Err(Error::Stalled {
                    what: what.to_owned(),
                    after: PATIENCE,
                });
            }
            let before = state.arrived;
            let step = Duration::from_millis(100);
            let (next, timeout) = self
                .moved
                .wait_timeout(state, step)
                .unwrap_or_else(PoisonError::into_inner);
            state = next;
            waited = match (timeout.timed_out(), state.arrived == before) {
                (true, true) => waited + step,
                (_, true) => waited,
                (_, false) => Duration::ZERO,
            };
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // A panic elsewhere leaves counts that are still counts.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_more_than_the_window_is_on_its_way() {
        let window = Window::new(64 * 1024, 1);
        let size = window.open(0).unwrap().unwrap();
        assert_eq!(size, 31);
        window.advance(10);
        assert_eq!(window.open(size).unwrap(), Some(10));
        window.advance(size);
        window.drained(size).unwrap();
        window.fail(Error::Order { expected: 1, got: 2 });
        assert_eq!(window.open(size).unwrap(), None);
        assert!(window.result().is_err() && window.result().is_ok());
    }

    #[test]
    fn many_receivers_share_what_is_on_its_way() {
        assert_eq!(Window::new(256, 100).open(0).unwrap(), Some(5000));
        assert_eq!(Window::new(256, 1000).open(0).unwrap(), Some(500));
    }
}
