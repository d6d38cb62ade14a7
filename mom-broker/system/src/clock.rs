//! The broker's clock: monotonic time for decisions, a time of day for stamps, and the wall clock that it follows.

use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use mom_proto::{Micros, Time};
use tokio::sync::watch;

/// A wall clock that is off by less is where it was: reading two clocks takes time.
const STEP: u64 = 250_000;

/// Monotonic µs since the broker's start, the wall time of that start, and the wall clock.
///
/// Leases, expiries, resting names and all stamps use the monotonic time. What is about the time of day (the expiry of a
/// token of an issuer, a calendar, the audit log) uses [`Clock::civil`], which follows the wall clock when it is set.
/// [`Clock::manual`] stands still until [`Clock::advance`] moves it, for simulations and tests: a lease of three minutes
/// is over at once. Timeouts of a link (heartbeats, login deadlines) use the system's time with either.
///
/// ```
/// use std::time::Duration;
/// use mom_system::Clock;
/// use mom_proto::Time;
///
/// let clock = Clock::manual(Time::from_micros(0).unwrap());
/// clock.advance(Duration::from_secs(181));
/// assert_eq!(clock.wall().to_string(), "1970-01-01T00:03:01.000000Z");
/// clock.step(3_600_000_000);
/// assert_eq!(clock.wall().to_string(), "1970-01-01T00:03:01.000000Z");
/// assert_eq!(clock.civil().to_string(), "1970-01-01T01:03:01.000000Z");
/// ```
#[derive(Clone, Debug)]
pub struct Clock {
    // Each connection has one.
    shared: Arc<ClockState>,
}

#[derive(Debug)]
struct ClockState {
    anchor: Time,
    source: TimeSource,
    /// By how many µs the wall clock is ahead of [`Clock::wall`], as far as it was looked at.
    ahead: watch::Sender<i64>,
}

#[derive(Debug)]
enum TimeSource {
    System(Instant),
    Runtime(tokio::time::Instant),
    Manual(watch::Sender<Micros>),
}

/// When something ends that ends at a time of day: as soon as the wall clock shows it, and no later than it seemed to be
/// when this was made, should the wall clock be set back meanwhile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Expiry {
    civil: Time,
    at: Micros,
}

impl Clock {
    /// The system's time from now on.
    pub fn system() -> Clock {
        Clock::new(system_time(), TimeSource::System(Instant::now()))
    }

    /// The time of the runtime that this is called on, from this wall time on: virtual where that is paused, for simulations.
    pub fn of_runtime(anchor: Time) -> Clock {
        Clock::new(anchor, TimeSource::Runtime(tokio::time::Instant::now()))
    }

    /// A clock that stays at this wall time until it is advanced.
    pub fn manual(anchor: Time) -> Clock {
        Clock::new(anchor, TimeSource::Manual(watch::Sender::new(0)))
    }

    fn new(anchor: Time, source: TimeSource) -> Clock {
        let shared = ClockState {
            anchor,
            source,
            ahead: watch::Sender::new(0),
        };
        Clock {
            shared: Arc::new(shared),
        }
    }

    /// Advances a manual clock, with all its clones, and wakes the tasks whose time has come. The system's clock is
    /// not changed.
    pub fn advance(&self, by: Duration) {
        if let TimeSource::Manual(now) = &self.shared.source {
            now.send_modify(|now| *now = now.saturating_add(micros(by)));
        }
    }

    /// Sets the wall clock forth or back by so many µs, unless it is the system's; monotonic time goes on as it was.
    pub fn step(&self, by: i64) {
        if !matches!(self.shared.source, TimeSource::System(_)) {
            self.shared
                .ahead
                .send_modify(|ahead| *ahead = ahead.saturating_add(by));
        }
    }

    /// µs since the start.
    pub fn now(&self) -> Micros {
        match &self.shared.source {
            TimeSource::System(start) => micros(start.elapsed()),
            TimeSource::Runtime(start) => micros(start.elapsed()),
            TimeSource::Manual(now) => *now.borrow(),
        }
    }

    /// The hub's time, for stamps: wall time at the start, and by the monotonic clock from then on. It does not jump.
    pub fn wall(&self) -> Time {
        self.wall_at(self.now())
    }

    /// The time of day by the wall clock, which may have been set a moment ago.
    pub fn civil(&self) -> Time {
        match &self.shared.source {
            TimeSource::System(_) => system_time(),
            TimeSource::Runtime(_) | TimeSource::Manual(_) => plus(self.wall(), *self.shared.ahead.borrow()),
        }
    }

    /// Wall time at the start.
    pub fn anchor(&self) -> Time {
        self.shared.anchor
    }

    /// The hub's time at a monotonic time.
    pub fn wall_at(&self, now: Micros) -> Time {
        plus(self.shared.anchor, i64::try_from(now).unwrap_or(i64::MAX))
    }

    /// Looks whether the wall clock was set, and wakes who waits for that.
    pub fn follow(&self) {
        if !matches!(self.shared.source, TimeSource::System(_)) {
            return;
        }
        let before = self.now();
        let civil = self.civil();
        let now = self.now();
        // A process that was stopped between two looks at clocks knows nothing of how far they are apart.
        if now - before > STEP / 2 {
            return;
        }
        let ahead = civil.micros().saturating_sub(self.wall_at(now).micros());
        self.shared.ahead.send_if_modified(|known| {
            let steps = known.abs_diff(ahead) >= STEP;
            if steps {
                *known = ahead;
            }
            steps
        });
    }

    /// By how many µs the wall clock is ahead of [`Clock::wall`]; changes when it is set.
    pub fn steps(&self) -> watch::Receiver<i64> {
        self.shared.ahead.subscribe()
    }

    /// What ends when the wall clock shows this.
    pub fn expiry(&self, civil: Time) -> Expiry {
        let left = civil.micros().saturating_sub(self.civil().micros());
        let left = u64::try_from(left).unwrap_or_default();
        Expiry {
            civil,
            at: self.now().saturating_add(left),
        }
    }

    /// Whether it has ended.
    pub fn is_over(&self, expiry: Expiry) -> bool {
        self.now() >= expiry.at || self.civil() >= expiry.civil
    }

    /// Waits until it has ended.
    pub async fn reach_expiry(&self, expiry: Expiry) {
        let mut steps = self.steps();
        while !self.is_over(expiry) {
            tokio::select! {
                () = self.reach(expiry.at) => return,
                // The sender lives as long as this clock.
                _ = steps.changed() => {}
            }
        }
    }

    /// Waits until a monotonic time has come.
    pub async fn reach(&self, at: Micros) {
        match &self.shared.source {
            TimeSource::System(start) => {
                let at = *start + Duration::from_micros(at);
                tokio::time::sleep_until(at.into()).await;
            }
            TimeSource::Runtime(start) => tokio::time::sleep_until(*start + Duration::from_micros(at)).await,
            TimeSource::Manual(now) => {
                // The sender lives as long as this clock, so the wait ends only with the time.
                let _ = now.subscribe().wait_for(|now| *now >= at).await;
            }
        }
    }
}

fn system_time() -> Time {
    let wall = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let wall = i64::try_from(wall.as_micros()).ok();
    wall.and_then(Time::from_micros).unwrap_or_default()
}

fn plus(time: Time, micros: i64) -> Time {
    let sum = time.micros().saturating_add(micros);
    Time::from_micros(sum).unwrap_or(if sum < 0 { Time::default() } else { Time::MAX })
}

fn micros(duration: Duration) -> Micros {
    u64::try_from(duration.as_micros()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR: i64 = 3_600_000_000;

    #[tokio::test]
    async fn an_expiry_comes_with_either_clock() {
        let clock = Clock::manual(Time::from_micros(100 * HOUR).unwrap());
        let until = Time::from_micros(101 * HOUR).unwrap();
        let expiry = clock.expiry(until);
        assert!(!clock.is_over(expiry));
        // Set forth: over at once, although no time has passed.
        clock.step(HOUR);
        assert!(clock.is_over(expiry));
        clock.reach_expiry(expiry).await;
        // Set back: no later than it was when it was made.
        clock.step(-2 * HOUR);
        assert!(!clock.is_over(expiry));
        let waiting = tokio::spawn({
            let clock = clock.clone();
            async move { clock.reach_expiry(expiry).await }
        });
        clock.advance(Duration::from_secs(3600));
        waiting.await.unwrap();
        assert!(clock.is_over(expiry));
        assert!(clock.civil() < until);
    }

    #[test]
    fn a_system_clock_that_was_not_set_has_no_steps() {
        let clock = Clock::system();
        let steps = clock.steps();
        clock.follow();
        assert!(!steps.has_changed().unwrap());
        assert!(clock.civil().micros().abs_diff(clock.wall().micros()) < STEP);
    }
}
