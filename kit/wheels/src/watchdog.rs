//! When motors must stop because no command comes any more.

use crate::WheelTime;

/// Stops a robot that nobody commands: the paper's robot drives on when its connection is lost (W9).
///
/// ```
/// use mom_wheels::Watchdog;
///
/// let watchdog = Watchdog::default();
/// assert_eq!(watchdog.stops_at(2_000_000), Some(2_500_000));
/// assert!(watchdog.must_stop(2_000_000, 2_500_000));
/// assert_eq!(Watchdog::NONE.stops_at(2_000_000), None);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Watchdog {
    limit: Option<WheelTime>,
}

impl Watchdog {
    /// The usual limit: 500 ms, in µs.
    pub const LIMIT: WheelTime = 500_000;
    /// As the paper has it: motors run on until the next command (W9).
    pub const NONE: Self = Self { limit: None };

    /// One that lets motors run so many µs after a command; none if that is below 0, so that they stop at once.
    #[must_use]
    pub fn after(limit: WheelTime) -> Self {
        Self {
            limit: Some(limit.max(0)),
        }
    }

    /// The limit in µs; `None` if motors run on.
    #[must_use]
    pub const fn limit(self) -> Option<WheelTime> {
        self.limit
    }

    /// When the motors must stop, if the last command came at this time; `None`: not by themselves.
    #[must_use]
    pub fn stops_at(self, last_command: WheelTime) -> Option<WheelTime> {
        self.limit.map(|limit| last_command.saturating_add(limit))
    }

    /// Whether the motors must stand now, if the last command came at this time.
    #[must_use]
    pub fn must_stop(self, last_command: WheelTime, now: WheelTime) -> bool {
        self.stops_at(last_command).is_some_and(|stop| now >= stop)
    }
}

impl Default for Watchdog {
    fn default() -> Self {
        Self::after(Self::LIMIT)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn it_stops_at_the_limit_and_not_a_microsecond_earlier() {
        let watchdog = Watchdog::after(300);
        for (now, stop) in [
            (-1, false),
            (100, false),
            (399, false),
            (400, true),
            (WheelTime::MAX, true),
        ] {
            assert_eq!(watchdog.must_stop(100, now), stop, "{now}");
        }
    }

    #[test]
    fn a_limit_of_nothing_or_less_stops_at_once() {
        for limit in [0, -1, WheelTime::MIN] {
            assert!(Watchdog::after(limit).must_stop(7, 7), "{limit}");
            assert!(!Watchdog::after(limit).must_stop(7, 6), "{limit}");
        }
    }

    #[test]
    fn times_at_the_end_of_their_range_do_not_wrap() {
        let end = WheelTime::MAX;
        assert_eq!(Watchdog::default().stops_at(end - 1), Some(end));
        assert!(!Watchdog::after(end).must_stop(end - 1, end - 1));
    }

    proptest! {
        #[test]
        fn without_one_motors_never_stop(last in any::<WheelTime>(), now in any::<WheelTime>()) {
            prop_assert!(!Watchdog::NONE.must_stop(last, now));
        }

        #[test]
        fn a_later_command_never_stops_earlier(
            limit in 0..9_000_000_i64, last in 0..9_000_000_i64, later in 0..9_000_000_i64,
        ) {
            let watchdog = Watchdog::after(limit);
            prop_assert!(watchdog.stops_at(last + later) >= watchdog.stops_at(last));
            prop_assert_eq!(watchdog.stops_at(last), Some(last + limit));
        }
    }
}
