//! µs since 1970 that never go back, however the system's time is set.

use std::time::{Duration, SystemTime};

use tokio::time::Instant;

#[derive(Debug)]
pub(super) struct Clock {
    start: Instant,
    /// The time at the start, in µs since 1970.
    epoch: i64,
}

impl Clock {
    pub(super) fn start() -> Clock {
        let since_1970 = SystemTime::now()
            .duration_since(SystemTime::UNIX_EPOCH)
            .unwrap_or_default();
        Clock {
            start: Instant::now(),
            epoch: i64::try_from(since_1970.as_micros()).unwrap_or_default(),
        }
    }

    pub(super) fn now(&self) -> i64 {
        let passed = i64::try_from(self.start.elapsed().as_micros()).unwrap_or(i64::MAX);
        self.epoch.saturating_add(passed)
    }

    /// The moment of a time; `None` if it is too far away to ever come.
    pub(super) fn instant(&self, time: i64) -> Option<Instant> {
        let micros = u64::try_from(time.saturating_sub(self.epoch)).unwrap_or_default();
        self.start.checked_add(Duration::from_micros(micros))
    }
}
