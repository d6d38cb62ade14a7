//! How much of a rate a sender has used: parcels, and bytes of content.

use std::time::Duration;

use mom_managers::{Bucket, Rate};
use mom_proto::{Code, Gcra, Micros, Wait, WireError};

/// What one sender has used of a rate.
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
    parcels: Gcra,
    bytes: Gcra,
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

impl Usage {
    /// Takes one parcel of this size, or nothing.
    ///
    /// # Errors
    /// `over-quota` with the time after which there is enough.
    pub fn charge(&mut self, rate: &Rate, size: usize, now: Micros) -> Result<(), WireError> {
        let size = u64::try_from(size).unwrap_or(u64::MAX);
        let (parcels, bytes) = (rate.parcels.pace(), rate.bytes.pace());
        match (
            self.parcels.peek(&parcels, 1, now),
            self.bytes.peek(&bytes, size, now),
        ) {
            (Ok(()), Ok(())) => {
                self.parcels.charge(&parcels, 1, now);
                self.bytes.charge(&bytes, size, now);
                Ok(())
            }
            (Err(wait), Ok(())) => Err(over("parcels", rate.parcels, wait)),
            (Ok(()), Err(wait)) => Err(over("bytes", rate.bytes, wait)),
            (Err(one), Err(other)) => Err(over("parcels", rate.parcels, one.max(other))),
        }
    }

    /// What may be taken now: as much as [`Usage::charge`] would let pass one after the other.
    pub fn budget(&self, rate: &Rate, now: Micros) -> Budget {
        Budget {
            rate: *rate,
            now,
            parcels: self.parcels.room(&rate.parcels.pace(), now),
            bytes: self.bytes.room(&rate.bytes.pace(), now),
            spent: (0, 0),
        }
    }

    /// Charges what was taken of a budget that was made of this.
    pub fn settle(&mut self, budget: &Budget) {
        let Budget { rate, now, spent, .. } = budget;
        // It fits, for nothing else was charged since.
        self.parcels.charge(&rate.parcels.pace(), spent.0, *now);
        self.bytes.charge(&rate.bytes.pace(), spent.1, *now);
    }
}

fn over(what: &str, bucket: Bucket, wait: Wait) -> WireError {
    let text = format!(
        "rate limit of this peer exceeded: {} {what} per second, {} at once",
        bucket.per_second, bucket.burst
    );
    let error = WireError::new(Code::OVER_QUOTA, text);
    match wait {
        Wait::For(wait) => error.retry_after(Duration::from_micros(wait)),
        Wait::Never => error,
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
    fn a_parcel_that_never_fits_is_not_told_to_come_back() {
        let bucket = |burst| Bucket { per_second: 1, burst };
        let rate = Rate {
            parcels: bucket(1),
            bytes: bucket(10),
        };
        let mut usage = Usage::default();
        assert!(usage.charge(&rate, 1, 0).is_ok());
        let retry = |size| usage.clone().charge(&rate, size, 0).unwrap_err().retry_in();
        assert_eq!(retry(1), Some(Duration::from_secs(1)), "parcels alone");
        assert_eq!(retry(11), None, "it has too many bytes for any time");
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
