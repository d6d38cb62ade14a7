//! Locks that measure for how long they are held, in CPU time: a thread that the system has put aside is not counted.
//!
//! It answers one question: whether any critical section grows with what a peer has sent (docs/security.md, Work).

use std::collections::BTreeMap;
use std::fmt;
use std::ops::{Deref, DerefMut};
use std::sync::atomic::{AtomicU64, Ordering};

use rustix::time::{ClockId, clock_gettime};

/// Powers of two of ns.
const BUCKETS: usize = 40;

/// The times of all locks around one type.
#[derive(Debug)]
struct Times {
    counts: [AtomicU64; BUCKETS],
    worst: AtomicU64,
}

static TIMES: parking_lot::Mutex<BTreeMap<&str, &Times>> = parking_lot::Mutex::new(BTreeMap::new());

/// As `parking_lot::Mutex`.
pub struct Mutex<T> {
    inner: parking_lot::Mutex<T>,
    times: &'static Times,
}

/// As `parking_lot::MutexGuard`.
#[derive(Debug)]
pub struct MutexGuard<'a, T> {
    inner: parking_lot::MutexGuard<'a, T>,
    since: u64,
    times: &'static Times,
}

/// As `parking_lot::Condvar`; who waits does not hold the lock.
#[derive(Debug, Default)]
pub struct Condvar(parking_lot::Condvar);

impl Times {
    fn of<T>() -> &'static Times {
        let mut all = TIMES.lock();
        all.entry(std::any::type_name::<T>()).or_insert_with(|| {
            Box::leak(Box::new(Times {
                counts: [const { AtomicU64::new(0) }; BUCKETS],
                worst: AtomicU64::new(0),
            }))
        })
    }

    fn add(&self, nanos: u64) {
        let bucket = nanos.checked_ilog2().map_or(0, |bits| bits as usize);
        self.counts[bucket.min(BUCKETS - 1)].fetch_add(1, Ordering::Relaxed);
        self.worst.fetch_max(nanos, Ordering::Relaxed);
    }

    /// The end of the bucket below which this part of all times lies, ns.
    fn quantile(&self, part: f64) -> u64 {
        let counts = self.counts.each_ref().map(|count| count.load(Ordering::Relaxed));
        let all: u64 = counts.iter().sum();
        let rank = (part * all as f64).ceil() as u64;
        let mut below = 0;
        let reached = |count: &u64| {
            below += count;
            below >= rank
        };
        let bucket = counts.iter().position(reached).unwrap_or_default();
        (2_u64 << bucket).min(self.worst.load(Ordering::Relaxed))
    }
}

/// For each type that a lock is around: how often it was held, and for how long.
pub fn lock_times() -> Vec<String> {
    let micros = |nanos: u64| nanos as f64 / 1000.0;
    let line = |(name, times): (&&str, &&Times)| {
        let count: u64 = times
            .counts
            .iter()
            .map(|count| count.load(Ordering::Relaxed))
            .sum();
        let [middle, high] = [0.5, 0.999].map(|part| micros(times.quantile(part)));
        let worst = micros(times.worst.load(Ordering::Relaxed));
        (count > 0).then(|| {
            format!(
                "lock {name}: held {count} times; p50 {middle:.1} µs, p99.9 {high:.1} µs, worst {worst:.1} µs"
            )
        })
    };
    TIMES.lock().iter().filter_map(line).collect()
}

fn now() -> u64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    let [seconds, nanos] = [time.tv_sec, time.tv_nsec].map(|part| u64::try_from(part).unwrap_or_default());
    seconds * 1_000_000_000 + nanos
}

impl<T> Mutex<T> {
    /// As its model.
    pub fn new(value: T) -> Mutex<T> {
        Mutex {
            inner: parking_lot::Mutex::new(value),
            times: Times::of::<T>(),
        }
    }

    /// As its model.
    pub fn lock(&self) -> MutexGuard<'_, T> {
        self.held(self.inner.lock())
    }

    /// As its model.
    pub fn try_lock(&self) -> Option<MutexGuard<'_, T>> {
        self.inner.try_lock().map(|inner| self.held(inner))
    }

    fn held<'a>(&self, inner: parking_lot::MutexGuard<'a, T>) -> MutexGuard<'a, T> {
        MutexGuard {
            inner,
            since: now(),
            times: self.times,
        }
    }
}

impl<T: Default> Default for Mutex<T> {
    fn default() -> Mutex<T> {
        Mutex::new(T::default())
    }
}

impl<T: fmt::Debug> fmt::Debug for Mutex<T> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.inner.fmt(formatter)
    }
}

impl<T> Drop for MutexGuard<'_, T> {
    fn drop(&mut self) {
        self.times.add(now().saturating_sub(self.since));
    }
}

impl<T> Deref for MutexGuard<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.inner
    }
}

impl<T> DerefMut for MutexGuard<'_, T> {
    fn deref_mut(&mut self) -> &mut T {
        &mut self.inner
    }
}

impl Condvar {
    /// As its model.
    pub fn new() -> Condvar {
        Condvar::default()
    }

    /// As its model.
    pub fn wait<T>(&self, guard: &mut MutexGuard<'_, T>) {
        guard.times.add(now().saturating_sub(guard.since));
        self.0.wait(&mut guard.inner);
        guard.since = now();
    }

    /// As its model.
    pub fn notify_all(&self) -> usize {
        self.0.notify_all()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Slow;

    #[test]
    fn who_holds_a_lock_is_measured_by_its_type() {
        let lock = Mutex::new(Slow);
        let guard = lock.lock();
        let start = now();
        while now() < start + 2_000_000 {}
        drop(guard);
        drop(lock.lock());
        let lines = lock_times();
        let line = lines
            .iter()
            .find(|line| line.contains("::Slow"))
            .expect("it was held");
        assert!(line.contains("held 2 times"), "{line}");
        let times = Times::of::<Slow>();
        assert!(times.worst.load(Ordering::Relaxed) >= 2_000_000, "{line}");
        assert!(times.quantile(0.5) < 2_000_000, "{line}");
    }
}
