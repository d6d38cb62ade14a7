//! Small messages to many receivers, written a little later and together.
//!
//! In a channel of fifty talkers nearly all of the work is one system call for each message and receiver. Where the
//! next message is sure to follow at once, waiting for it costs each a fraction of a millisecond and saves half of the
//! calls. Whatever is urgent, large, for few receivers, or alone is written at once by its reader.

use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::Duration;

use parking_lot::{Condvar, Mutex};

use crate::traffic::outbox::Outbox;

/// How long the first one waits for others.
const WAIT: Duration = Duration::from_micros(200);

/// From so many receivers on; with fewer the calls are not what costs.
pub(crate) const RECEIVERS: usize = 8;

/// A channel in which nothing was said for so long (µs) does not expect the next message at once.
const LIVELY: u64 = 1000;

/// Messages in that time beyond which nothing waits either: they come together by themselves, and who writes them at
/// once reads more of them the next time. A reader that leaves all writing to others reads them one by one.
const CROWDED: u32 = 32;

/// How fast messages follow each other in a channel.
#[derive(Debug, Default)]
pub(crate) struct BatchPace {
    last: u64,
    /// Since when messages are counted, and how many there were.
    since: u64,
    count: u32,
}

impl BatchPace {
    /// Notes messages; whether another is sure to follow at once, and worth waiting for.
    pub(crate) fn is_lively(&mut self, count: u32, now: u64) -> bool {
        let before = std::mem::replace(&mut self.last, now);
        if now.saturating_sub(self.since) >= LIVELY {
            (self.since, self.count) = (now, 0);
        }
        self.count = self.count.saturating_add(count);
        now.saturating_sub(before) < LIVELY && self.count <= CROWDED
    }
}

/// The thread that writes deferred batches; it starts with the first.
#[derive(Debug, Default)]
pub(crate) struct BatchWriter {
    shared: Arc<BatchShared>,
    started: OnceLock<()>,
}

#[derive(Debug, Default)]
struct BatchShared {
    state: Mutex<BatchState>,
    wake: Condvar,
}

#[derive(Debug, Default)]
struct BatchState {
    waiting: Vec<Arc<Outbox>>,
    ended: bool,
}

impl BatchWriter {
    /// Flushes these in a moment. Whatever else is put into them until then goes with it.
    pub(crate) fn defer(&self, outboxes: Vec<Arc<Outbox>>) {
        self.started.get_or_init(|| {
            let shared = Arc::clone(&self.shared);
            let run = move || shared.run();
            if let Err(error) = thread::Builder::new().name("mom-gather".to_owned()).spawn(run) {
                // Nobody would write them.
                self.shared.state.lock().ended = true;
                tracing::warn!(%error, "cannot start the thread that batches writes: each is written at once");
            }
        });
        let mut state = self.shared.state.lock();
        if state.ended {
            drop(state);
            outboxes.iter().for_each(|outbox| outbox.flush());
            return;
        }
        let first = state.waiting.is_empty();
        state.waiting.extend(outboxes);
        drop(state);
        if first {
            self.shared.wake.notify_one();
        }
    }
}

impl Drop for BatchWriter {
    fn drop(&mut self) {
        self.shared.state.lock().ended = true;
        self.shared.wake.notify_one();
    }
}

impl BatchShared {
    fn run(&self) {
        loop {
            let mut state = self.state.lock();
            while state.waiting.is_empty() && !state.ended {
                self.wake.wait(&mut state);
            }
            let ended = state.ended;
            drop(state);
            if !ended {
                thread::sleep(WAIT);
            }
            let outboxes = std::mem::take(&mut self.state.lock().waiting);
            outboxes.iter().for_each(|outbox| outbox.flush());
            if ended {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_messages_that_follow_each_other_soon_and_singly_wait() {
        let mut pace = BatchPace::default();
        assert!(!pace.is_lively(1, 5000), "the first in a while");
        assert!(pace.is_lively(1, 5200), "the next is near");
        assert!(!pace.is_lively(1, 6500), "alone again");
        // Fifty talkers with a hundred messages a second each.
        assert!((0..50).all(|number| pace.is_lively(1, 6700 + number * 200)));
        assert!(!pace.is_lively(100, 16_600), "they come together");
        // One that sends as fast as it can: a few wait in each millisecond, the others go.
        let waiting = (0..1000_u64).filter(|number| pace.is_lively(1, 20_000 + number * 3));
        assert!(waiting.count() <= 3 * CROWDED as usize);
    }
}
