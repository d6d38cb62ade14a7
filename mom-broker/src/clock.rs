//! The broker's one clock: monotonic for what is decided, wall time for what is shown.

use std::time::{Instant, SystemTime, UNIX_EPOCH};

use mom_managers::Micros;
use mom_proto::Time;

/// Monotonic µs since the broker's start, and the wall time of that start.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clock {
    start: Instant,
    anchor: Time,
}

impl Clock {
    pub(crate) fn start() -> Clock {
        let wall = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let anchor = i64::try_from(wall.as_micros())
            .ok()
            .and_then(Time::from_micros)
            .unwrap_or_default();
        Clock {
            start: Instant::now(),
            anchor,
        }
    }

    /// µs since the start.
    pub(crate) fn now(&self) -> Micros {
        u64::try_from(self.start.elapsed().as_micros()).unwrap_or(u64::MAX)
    }

    /// Wall time at the start.
    pub(crate) fn anchor(&self) -> Time {
        self.anchor
    }

    /// Wall time now, by the monotonic clock: it does not jump.
    pub(crate) fn wall(&self) -> Time {
        self.wall_at(self.now())
    }

    /// Wall time at a monotonic time.
    pub(crate) fn wall_at(&self, now: Micros) -> Time {
        let micros = self
            .anchor
            .micros()
            .saturating_add(i64::try_from(now).unwrap_or(i64::MAX));
        Time::from_micros(micros).unwrap_or(Time::MAX)
    }

    /// The instant of a monotonic time.
    pub(crate) fn instant(&self, at: Micros) -> Instant {
        self.start + std::time::Duration::from_micros(at)
    }
}
