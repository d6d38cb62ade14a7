//! The broker's clock: monotonic time for decisions, wall time for display.

use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use mom_proto::{Micros, Time};
use tokio::sync::watch;

/// Monotonic µs since the broker's start, and the wall time of that start.
///
/// Leases, expiries, resting names and all stamps use it. [`Clock::manual`] stands still until
/// [`Clock::advance`] moves it, for simulations and tests: a lease of three minutes is over at once.
/// Timeouts of a link (heartbeats, login deadlines) use the system's time with either.
///
/// ```
/// use std::time::Duration;
/// use mom_system::Clock;
/// use mom_proto::Time;
///
/// let clock = Clock::manual(Time::from_micros(0).unwrap());
/// clock.advance(Duration::from_secs(181));
/// assert_eq!(clock.wall().to_string(), "1970-01-01T00:03:01.000000Z");
/// ```
#[derive(Clone, Debug)]
pub struct Clock {
    anchor: Time,
    source: TimeSource,
}

#[derive(Clone, Debug)]
enum TimeSource {
    System(Instant),
    Manual(Arc<watch::Sender<Micros>>),
}

impl Clock {
    /// The system's time from now on.
    pub fn system() -> Clock {
        let wall = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let anchor = i64::try_from(wall.as_micros())
            .ok()
            .and_then(Time::from_micros)
            .unwrap_or_default();
        Clock {
            anchor,
            source: TimeSource::System(Instant::now()),
        }
    }

    /// A clock that stays at this wall time until it is advanced.
    pub fn manual(anchor: Time) -> Clock {
        Clock {
            anchor,
            source: TimeSource::Manual(Arc::new(watch::Sender::new(0))),
        }
    }

    /// Advances a manual clock, with all its clones, and wakes the tasks whose time has come. The system's clock is
    /// not changed.
    pub fn advance(&self, by: Duration) {
        if let TimeSource::Manual(now) = &self.source {
            now.send_modify(|now| *now = now.saturating_add(micros(by)));
        }
    }

    /// µs since the start.
    pub fn now(&self) -> Micros {
        match &self.source {
            TimeSource::System(start) => micros(start.elapsed()),
            TimeSource::Manual(now) => *now.borrow(),
        }
    }

    /// Wall time now, by the monotonic clock: it does not jump.
    pub fn wall(&self) -> Time {
        self.wall_at(self.now())
    }

    /// Wall time at the start.
    pub fn anchor(&self) -> Time {
        self.anchor
    }

    /// Wall time at a monotonic time.
    pub fn wall_at(&self, now: Micros) -> Time {
        let micros = self
            .anchor
            .micros()
            .saturating_add(i64::try_from(now).unwrap_or(i64::MAX));
        Time::from_micros(micros).unwrap_or(Time::MAX)
    }

    /// Waits until a monotonic time has come.
    pub async fn reach(&self, at: Micros) {
        match &self.source {
            TimeSource::System(start) => {
                let at = *start + Duration::from_micros(at);
                tokio::time::sleep_until(at.into()).await;
            }
            TimeSource::Manual(now) => {
                // The sender lives as long as this clock, so the wait ends only with the time.
                let _ = now.subscribe().wait_for(|now| *now >= at).await;
            }
        }
    }
}

fn micros(duration: Duration) -> Micros {
    u64::try_from(duration.as_micros()).unwrap_or(u64::MAX)
}
