//! Small messages to many receivers, written a little later and together.
//!
//! In a channel of fifty talkers nearly all of the work is one system call for each message and receiver. Where the
//! next message is sure to follow at once, waiting for it costs each a fraction of a millisecond and saves half of the
//! calls. Whatever is urgent, large, for few, or alone is written in the turn of its reader as ever.

use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::Duration;

use parking_lot::{Condvar, Mutex};

use crate::outbox::Outbox;

/// How long the first one waits for others.
const WAIT: Duration = Duration::from_micros(200);

/// From so many receivers on; with fewer the calls are not what costs.
pub(crate) const RECEIVERS: usize = 8;

/// Of what is written together, in bytes: more fills a call by itself.
pub(crate) const SMALL: usize = 4096;

/// A channel in which nothing was said for so long (µs) does not expect the next message at once.
pub(crate) const LIVELY: u64 = 1000;

/// The thread that writes what was left for later; it starts with the first.
#[derive(Debug, Default)]
pub(crate) struct Gatherer {
    shared: Arc<Shared>,
    started: OnceLock<()>,
}

#[derive(Debug, Default)]
struct Shared {
    state: Mutex<State>,
    wake: Condvar,
}

#[derive(Debug, Default)]
struct State {
    waiting: Vec<Arc<Outbox>>,
    ended: bool,
}

impl Gatherer {
    /// Flushes these in a moment. Whatever else is put into them until then goes with it.
    pub(crate) fn defer(&self, outboxes: Vec<Arc<Outbox>>) {
        self.started.get_or_init(|| {
            let shared = Arc::clone(&self.shared);
            let run = move || shared.run();
            if let Err(error) = thread::Builder::new().name("mom-gather".to_owned()).spawn(run) {
                // Nobody would write them.
                self.shared.state.lock().ended = true;
                tracing::warn!(%error, "no thread to gather writes: each is made at once");
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

impl Drop for Gatherer {
    fn drop(&mut self) {
        self.shared.state.lock().ended = true;
        self.shared.wake.notify_one();
    }
}

impl Shared {
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
