//! How much of a rate a peer has used: two token buckets in integer arithmetic.

use mom_managers::{Bucket, Micros, Rate};
use mom_proto::{Code, WireError};
use std::time::Duration;

/// One unit in a bucket: a parcel or a byte, in millionths, so that µs of refill are whole numbers.
const UNIT: u128 = 1_000_000;

/// What is left in the buckets of one sender.
///
/// ```
/// use mom_hub::Usage;
/// use mom_managers::{Bucket, Rate};
///
/// let rate = Rate { parcels: Bucket { per_second: 2, burst: 1 }, bytes: Bucket::UNLIMITED };
/// let mut usage = Usage::default();
/// assert!(usage.charge(&rate, 100, 0).is_ok());
/// let error = usage.charge(&rate, 100, 1000).unwrap_err();
/// assert_eq!(error.code, mom_proto::Code::OVER_QUOTA);
/// assert_eq!(error.retry_in(), Some(std::time::Duration::from_millis(499)));
/// assert!(usage.charge(&rate, 100, 500_000).is_ok());
/// ```
#[derive(Clone, Debug, Default)]
pub struct Usage {
    parcels: Left,
    bytes: Left,
}

/// What a sender may send at one moment, where many parcels are charged together: [`Usage`] is worked out once for all
/// of them.
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    rate: Rate,
    now: Micros,
    /// What is left of each; [`u64::MAX`] where there is no bound.
    parcels: u64,
    bytes: u64,
    spent: (u64, u64),
}

impl Budget {
    /// Takes one parcel of this size; false if there is not enough.
    pub fn take(&mut self, size: usize) -> bool {
        let size = u64::try_from(size).unwrap_or(u64::MAX);
        let left = (self.parcels.checked_sub(1), self.bytes.checked_sub(size));
        let (Some(parcels), Some(bytes)) = left else {
            return false;
        };
        (self.parcels, self.bytes) = (parcels, bytes);
        self.spent = (self.spent.0 + 1, self.spent.1.saturating_add(size));
        true
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct Left {
    /// What was taken and has not come back, in units.
    taken: u128,
    /// Up to when it has come back.
    at: Micros,
}

impl Usage {
    /// Takes one parcel of this size, or nothing.
    ///
    /// # Errors
    /// `over-quota` with the time after which there is enough.
    pub fn charge(&mut self, rate: &Rate, size: usize, now: Micros) -> Result<(), WireError> {
        let size = u64::try_from(size).unwrap_or(u64::MAX);
        let (parcels, bytes) = (
            self.parcels.after(&rate.parcels, 1, now),
            self.bytes.after(&rate.bytes, size, now),
        );
        match (parcels, bytes) {
            (Ok(parcels), Ok(bytes)) => {
                (self.parcels, self.bytes) = (parcels, bytes);
                Ok(())
            }
            (Err(wait), Ok(_)) => Err(over("parcels", rate.parcels, wait)),
            (Ok(_), Err(wait)) => Err(over("bytes", rate.bytes, wait)),
            (Err(one), Err(other)) => Err(over("parcels", rate.parcels, one.max(other))),
        }
    }
}

impl Usage {
    /// What may be taken now: as much as [`Usage::charge`] would let pass one after the other.
    pub fn budget(&self, rate: &Rate, now: Micros) -> Budget {
        Budget {
            rate: *rate,
            now,
            parcels: self.parcels.room(&rate.parcels, now),
            bytes: self.bytes.room(&rate.bytes, now),
            spent: (0, 0),
        }
    }

    /// Charges what was taken of a budget that was made of this.
    pub fn settle(&mut self, budget: &Budget) {
        let Budget { rate, now, spent, .. } = budget;
        if let Ok(parcels) = self.parcels.after(&rate.parcels, spent.0, *now) {
            self.parcels = parcels;
        }
        if let Ok(bytes) = self.bytes.after(&rate.bytes, spent.1, *now) {
            self.bytes = bytes;
        }
    }
}

impl Left {
    /// How much there is in the bucket.
    fn room(self, bucket: &Bucket, now: Micros) -> u64 {
        if *bucket == Bucket::UNLIMITED {
            return u64::MAX;
        }
        let full = u128::from(bucket.burst) * UNIT;
        let room = full.saturating_sub(self.not_back(bucket, now)) / UNIT;
        u64::try_from(room).unwrap_or(u64::MAX)
    }

    /// What was taken and has not come back by now.
    fn not_back(self, bucket: &Bucket, now: Micros) -> u128 {
        let back = u128::from(bucket.per_second) * u128::from(now.saturating_sub(self.at));
        self.taken.saturating_sub(back)
    }

    /// The bucket after `count` was taken from it, or for how long there is not enough in it.
    fn after(self, bucket: &Bucket, count: u64, now: Micros) -> Result<Left, Option<Micros>> {
        if *bucket == Bucket::UNLIMITED {
            return Ok(self);
        }
        let taken = self.not_back(bucket, now) + u128::from(count) * UNIT;
        let full = u128::from(bucket.burst) * UNIT;
        if taken <= full {
            return Ok(Left { taken, at: now });
        }
        // What is larger than the whole bucket never fits.
        if u128::from(count) > u128::from(bucket.burst) || bucket.per_second == 0 {
            return Err(None);
        }
        let wait = (taken - full).div_ceil(u128::from(bucket.per_second));
        Err(Some(Micros::try_from(wait).unwrap_or(Micros::MAX)))
    }
}

/// None is the longest wait: there is no end to it.
fn over(what: &str, bucket: Bucket, wait: Option<Micros>) -> WireError {
    let text = format!(
        "more than this peer's share: {} {what} per second, {} at once",
        bucket.per_second, bucket.burst
    );
    let error = WireError::new(Code::OVER_QUOTA, text);
    match wait {
        Some(wait) => error.retry_after(Duration::from_micros(wait)),
        None => error,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_buckets_have_to_have_enough() {
        let rate = Rate {
            parcels: Bucket {
                per_second: 10,
                burst: 5,
            },
            bytes: Bucket {
                per_second: 1000,
                burst: 1000,
            },
        };
        let mut usage = Usage::default();
        let passed = |usage: &mut Usage, size, now| usage.charge(&rate, size, now).is_ok();
        assert!(passed(&mut usage, 900, 0));
        assert!(!passed(&mut usage, 200, 0), "bytes");
        assert!((0..4).all(|_| passed(&mut usage, 10, 0)));
        assert!(!passed(&mut usage, 10, 0), "parcels");
        let error = usage.charge(&rate, 2000, 10_000_000).unwrap_err();
        assert_eq!(error.retry_in(), None, "larger than the bucket: never");
        assert!(passed(&mut usage, 1000, 10_000_000));
    }

    #[test]
    fn a_budget_is_what_charging_one_by_one_would_let_pass() {
        let buckets = [
            Bucket::UNLIMITED,
            Bucket {
                per_second: 3,
                burst: 5,
            },
            Bucket {
                per_second: 700,
                burst: 900,
            },
        ];
        for (parcels, bytes) in buckets.iter().flat_map(|one| buckets.map(|other| (*one, other))) {
            let rate = Rate { parcels, bytes };
            let (mut one_by_one, mut together) = (Usage::default(), Usage::default());
            for now in (0..5_000_000).step_by(333_333) {
                let sizes = (0..12_usize).map(|number| number * 37 % 101);
                let passed = |size: &usize| one_by_one.charge(&rate, *size, now).is_ok();
                let passed = sizes.clone().take_while(passed).count();
                let mut budget = together.budget(&rate, now);
                let taken = sizes.take_while(|size| budget.take(*size)).count();
                together.settle(&budget);
                assert_eq!(taken, passed, "{rate:?} at {now}");
            }
        }
    }

    #[test]
    fn over_a_long_time_the_rate_holds() {
        let rate = Rate {
            parcels: Bucket {
                per_second: 50,
                burst: 7,
            },
            bytes: Bucket::UNLIMITED,
        };
        let mut usage = Usage::default();
        let passed = (0..10_000_000_u64)
            .step_by(1_237)
            .filter(|now| usage.charge(&rate, 1, *now).is_ok());
        let passed = passed.count();
        assert!((500..=507).contains(&passed), "{passed}");
    }
}
