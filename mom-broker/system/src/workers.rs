//! Threads for work that takes long: what grows with the size of what one peer sends.
//!
//! The threads that serve connections only do work that is small for every parcel. Opening a large document, or writing
//! large content in another form, is given to these threads, which give way to all others.

use std::collections::VecDeque;
use std::fmt;
use std::sync::{Arc, OnceLock};
use std::thread;

use parking_lot::{Condvar, Mutex};

/// How far these threads give way. An idle core is still used by them.
const NICENESS: i32 = 10;

type Job = Box<dyn FnOnce() + Send>;

/// The threads; they start with the first job. Jobs are begun in the order in which they come.
#[derive(Debug)]
pub struct Workers {
    threads: usize,
    shared: Arc<Shared>,
    started: OnceLock<bool>,
}

#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    wake: Condvar,
}

#[derive(Default)]
struct State {
    jobs: VecDeque<Job>,
    ended: bool,
}

impl fmt::Debug for Shared {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Shared")
    }
}

impl Default for Workers {
    /// As many threads as leave a core to others, one at least.
    fn default() -> Workers {
        let cores = thread::available_parallelism().map_or(1, usize::from);
        Workers::new(cores.saturating_sub(1).clamp(1, 4))
    }
}

impl Workers {
    /// So many threads.
    pub fn new(threads: usize) -> Workers {
        Workers {
            threads,
            shared: Arc::default(),
            started: OnceLock::new(),
        }
    }

    /// Has a job done. The caller bounds how many: there is one for each connection at most that waits for it.
    pub fn run(&self, job: impl FnOnce() + Send + 'static) {
        if !*self.started.get_or_init(|| self.start()) {
            // Without threads it is done here, or nobody would do it.
            return job();
        }
        self.shared.state.lock().jobs.push_back(Box::new(job));
        self.shared.wake.notify_one();
    }

    fn start(&self) -> bool {
        let one = |_| {
            let shared = Arc::clone(&self.shared);
            let thread = thread::Builder::new().name("mom-work".to_owned());
            thread.spawn(move || shared.work()).is_ok()
        };
        (0..self.threads).filter(|number| one(*number)).count() > 0
    }
}

impl Drop for Workers {
    fn drop(&mut self) {
        self.shared.state.lock().ended = true;
        self.shared.wake.notify_all();
    }
}

impl Shared {
    fn work(&self) {
        give_way(NICENESS);
        loop {
            let mut state = self.state.lock();
            let job = loop {
                match state.jobs.pop_front() {
                    Some(job) => break job,
                    None if state.ended => return,
                    None => self.wake.wait(&mut state),
                }
            };
            drop(state);
            job();
        }
    }
}

/// Lowers the priority of the current thread for good.
pub fn give_way(niceness: i32) {
    // On Linux this applies to the thread, not to the process. It cannot fail: every process may raise its niceness.
    let _ = rustix::process::nice(niceness);
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use super::*;

    #[test]
    fn jobs_are_begun_in_order_and_done_elsewhere() {
        let workers = Workers::new(1);
        let (done, results) = mpsc::channel();
        for number in 0..100 {
            let done = done.clone();
            workers.run(move || {
                done.send((number, thread::current().id()))
                    .expect("the receiver is there");
            });
        }
        let results: Vec<_> = results.iter().take(100).collect();
        assert!(results.iter().map(|(number, _)| *number).eq(0..100));
        assert!(results.iter().all(|(_, id)| *id != thread::current().id()));
    }

    #[test]
    fn what_was_given_before_the_end_is_done() {
        let (done, results) = mpsc::channel();
        let workers = Workers::new(2);
        for number in 0..10 {
            let done = done.clone();
            workers.run(move || done.send(number).expect("the receiver is there"));
        }
        drop((workers, done));
        assert_eq!(results.iter().count(), 10);
    }
}
