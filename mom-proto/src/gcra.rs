//! How much of a rate is used: the generic cell rate algorithm, in whole numbers.
//!
//! Everything that limits how often something may be done counts by this: the hub what a sender sends, a quota what a
//! peer asks for, the broker requests and failed logins. What differs is which rate it is, whose, and what happens to
//! one that is over it.

use crate::Micros;

/// A rate, and how much may be used at once.
///
/// What is used is a debt. Each use adds to it, each µs pays some of it back, and there is a most that it may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pace {
    /// The debt of one.
    each: u64,
    /// What a µs pays back.
    back: u64,
    /// The most debt; a burst for which it is too small a number is not a limit.
    most: u64,
}

/// How long until as much as was asked for may be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Wait {
    /// So many µs.
    For(Micros),
    /// It is more than may ever be used at once, or nothing comes back.
    Never,
}

/// What one user of a [`Pace`] has used of it.
///
/// ```
/// use mom_proto::{Gcra, Pace, Wait};
///
/// let pace = Pace::per_second(2, 3);
/// let mut used = Gcra::default();
/// assert_eq!(used.take(&pace, 3, 0), Ok(()));
/// assert_eq!(used.take(&pace, 1, 100_000), Err(Wait::For(400_000)));
/// assert_eq!(used.take(&pace, 1, 500_000), Ok(()));
/// assert_eq!(used.peek(&pace, 4, 9_000_000), Err(Wait::Never));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Gcra {
    /// The debt at that time.
    debt: u64,
    at: Micros,
}

/// Debt of one where so many come back each second: it makes of a µs a whole number.
const PART: u64 = 1_000_000;

impl Pace {
    /// No limit.
    pub const UNLIMITED: Pace = Pace {
        each: 0,
        back: 0,
        most: 0,
    };

    /// So many each second, and so many at once.
    pub const fn per_second(count: u64, burst: u64) -> Pace {
        Pace {
            each: PART,
            back: count,
            most: burst.saturating_mul(PART),
        }
    }

    /// One each so many µs, and so many at once.
    pub const fn every(interval: Micros, burst: u64) -> Pace {
        Pace {
            each: interval,
            back: 1,
            most: interval.saturating_mul(burst),
        }
    }

    /// One each so many µs, and as many at once as come back in this time, and one.
    pub const fn every_within(interval: Micros, time: Micros) -> Pace {
        Pace {
            each: interval,
            back: 1,
            most: interval.saturating_add(time),
        }
    }

    fn of(&self, count: u64) -> u64 {
        self.each.saturating_mul(count)
    }

    /// How long a debt takes to be paid back.
    fn time(&self, debt: u64) -> Wait {
        match (debt, self.back) {
            (0, _) => Wait::For(0),
            (_, 0) => Wait::Never,
            (_, back) => Wait::For(debt.div_ceil(back)),
        }
    }
}

impl Gcra {
    /// Of a pace of one each so many µs: everything is paid back at this time.
    pub fn paid_at(time: Micros) -> Gcra {
        Gcra { debt: time, at: 0 }
    }

    /// When everything is paid back if nothing more is used.
    pub fn next(&self, pace: &Pace) -> Micros {
        match pace.time(self.debt) {
            Wait::For(time) => self.at.saturating_add(time),
            Wait::Never => Micros::MAX,
        }
    }

    /// Whether so many may be used now.
    ///
    /// # Errors
    /// After which time they may.
    pub fn peek(&self, pace: &Pace, count: u64, now: Micros) -> Result<(), Wait> {
        let more = pace.of(count);
        let debt = self.debt_at(pace, now).saturating_add(more);
        if debt <= pace.most || pace.each == 0 {
            return Ok(());
        }
        if more > pace.most {
            return Err(Wait::Never);
        }
        Err(pace.time(debt - pace.most))
    }

    /// Uses so many, whether they may be used or not.
    pub fn charge(&mut self, pace: &Pace, count: u64, now: Micros) {
        if pace.each == 0 {
            return;
        }
        let debt = self.debt_at(pace, now).saturating_add(pace.of(count));
        *self = Gcra {
            debt,
            at: now.max(self.at),
        };
    }

    /// Uses so many if they may be used.
    ///
    /// # Errors
    /// After which time they may. Nothing is used.
    pub fn take(&mut self, pace: &Pace, count: u64, now: Micros) -> Result<(), Wait> {
        self.peek(pace, count, now)?;
        self.charge(pace, count, now);
        Ok(())
    }

    /// How many may be used now; [`u64::MAX`] where there is no limit.
    pub fn room(&self, pace: &Pace, now: Micros) -> u64 {
        if pace.each == 0 {
            return u64::MAX;
        }
        pace.most.saturating_sub(self.debt_at(pace, now)) / pace.each
    }

    fn debt_at(&self, pace: &Pace, now: Micros) -> u64 {
        let elapsed = now.saturating_sub(self.at);
        self.debt.saturating_sub(pace.back.saturating_mul(elapsed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_burst_and_then_the_rate() {
        let pace = Pace::per_second(10, 5);
        let mut used = Gcra::default();
        let taken = (0..100).filter(|_| used.take(&pace, 1, 7_000).is_ok()).count();
        assert_eq!((taken, used.room(&pace, 7_000)), (5, 0));
        assert_eq!(used.peek(&pace, 1, 7_000), Err(Wait::For(100_000)));
        assert_eq!(used.peek(&pace, 1, 107_000), Ok(()));
        assert_eq!(used.peek(&pace, 5, 7_000), Err(Wait::For(500_000)));
        assert_eq!(used.next(&pace), 507_000);
        assert_eq!(used.room(&pace, 507_000), 5);
    }

    #[test]
    fn what_is_more_than_the_burst_never_fits() {
        let used = Gcra::default();
        assert_eq!(used.peek(&Pace::per_second(10, 5), 6, 0), Err(Wait::Never));
        let mut used = Gcra::default();
        let once = Pace::per_second(0, 1);
        assert_eq!(used.take(&once, 1, 0), Ok(()));
        assert_eq!(
            used.take(&once, 1, Micros::MAX),
            Err(Wait::Never),
            "nothing comes back"
        );
        assert_eq!(used.next(&once), Micros::MAX);
        assert!(Wait::Never > Wait::For(Micros::MAX));
    }

    #[test]
    fn without_a_limit_everything_fits() {
        let mut used = Gcra::default();
        assert_eq!(used.take(&Pace::UNLIMITED, u64::MAX, 0), Ok(()));
        assert_eq!(used.room(&Pace::UNLIMITED, 0), u64::MAX);
        assert_eq!(used, Gcra::default());
    }

    #[test]
    fn nothing_overflows() {
        let pace = Pace::per_second(u64::MAX, u64::MAX);
        let mut used = Gcra::default();
        for now in [0, 1, Micros::MAX] {
            assert_eq!(
                used.take(&pace, u64::MAX, now),
                Ok(()),
                "so high a burst is not a limit"
            );
        }
        let pace = Pace::per_second(1_000_000_000_000, 1_000_000_000_000);
        let mut used = Gcra::default();
        assert_eq!(used.take(&pace, u64::MAX, 0), Err(Wait::Never));
        assert_eq!(used.take(&pace, 1_000_000_000_000, 0), Ok(()));
        assert_eq!(used.take(&pace, 1_000_000_000_000, 999_999), Err(Wait::For(1)));
        assert_eq!(used.take(&pace, 1_000_000_000_000, 1_000_000), Ok(()));
        used.charge(&pace, u64::MAX, 1_000_000);
        assert_eq!(used.peek(&pace, 1, Micros::MAX), Ok(()));
    }

    #[test]
    fn failures_are_charged_also_beyond_the_burst() {
        let pace = Pace::every(10, 3);
        let mut used = Gcra::default();
        for _ in 0..5 {
            used.charge(&pace, 1, 100);
        }
        assert_eq!(
            (used.next(&pace), used.peek(&pace, 1, 100)),
            (150, Err(Wait::For(30)))
        );
        assert_eq!(Gcra::paid_at(150).peek(&pace, 1, 100), Err(Wait::For(30)));
        assert_eq!(Gcra::paid_at(50).peek(&pace, 3, 100), Ok(()));
    }

    #[test]
    fn a_clock_that_stands_or_steps_back_gives_nothing_away() {
        let pace = Pace::every(10, 1);
        let mut used = Gcra::default();
        assert_eq!(used.take(&pace, 1, 100), Ok(()));
        assert_eq!(used.take(&pace, 1, 90), Err(Wait::For(10)));
        used.charge(&pace, 1, 90);
        assert_eq!(used.next(&pace), 120);
    }

    proptest! {
        /// Over any time no more passes than the burst and what comes back, and who waits as told is not told to wait
        /// again.
        #[test]
        fn the_rate_holds(
            per_second in 1_u64..5_000,
            burst in 1_u64..50,
            steps in prop::collection::vec((0_u64..20_000, 1_u64..60), 1..200),
        ) {
            let pace = Pace::per_second(per_second, burst);
            let (mut used, mut now, mut passed) = (Gcra::default(), 0, 0);
            for (time, count) in steps {
                now += time;
                let room = used.room(&pace, now);
                let took = used.take(&pace, count, now);
                prop_assert_eq!(took.is_ok(), count <= room);
                match took {
                    Ok(()) => passed += count,
                    Err(Wait::Never) => prop_assert!(count > burst),
                    Err(Wait::For(wait)) => {
                        prop_assert!(wait > 0 && used.peek(&pace, count, now + wait - 1).is_err());
                        prop_assert_eq!(used.peek(&pace, count, now + wait), Ok(()));
                    }
                }
                let most = u128::from(burst) * 1_000_000 + u128::from(per_second) * u128::from(now);
                prop_assert!(u128::from(passed) * 1_000_000 <= most);
            }
        }
    }
}
