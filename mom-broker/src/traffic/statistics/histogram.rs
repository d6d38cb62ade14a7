//! How ages are spread, in little memory.

/// Bits of a number that tell buckets of one power of two apart: a bucket is a quarter of it wide at most.
const FINE: u32 = 2;

/// Ages from here on, µs (19 hours), are counted as this one.
const MOST: u64 = 1 << 36;

/// Buckets up to the one of [`MOST`].
const BUCKETS: usize = ((36 - FINE as usize) << FINE) + (1 << FINE) + 1;

/// Counts of ages in µs, in buckets that grow with the age: what is read is at most a quarter too high.
#[derive(Clone, Debug)]
pub(crate) struct Histogram {
    buckets: [u32; BUCKETS],
    count: u64,
    most: u64,
}

impl Histogram {
    pub(crate) fn new() -> Histogram {
        Histogram {
            buckets: [0; BUCKETS],
            count: 0,
            most: 0,
        }
    }

    /// Counts one; what is below 0 by the error of a clock counts as 0.
    pub(crate) fn note(&mut self, age: i64) {
        let age = u64::try_from(age).unwrap_or_default();
        let bucket = &mut self.buckets[bucket(age)];
        *bucket = bucket.saturating_add(1);
        self.count += 1;
        self.most = self.most.max(age);
    }

    /// Counts what another has counted.
    pub(crate) fn add(&mut self, other: &Histogram) {
        for (bucket, count) in self.buckets.iter_mut().zip(other.buckets) {
            *bucket = bucket.saturating_add(count);
        }
        self.count += other.count;
        self.most = self.most.max(other.most);
    }

    pub(crate) fn count(&self) -> u64 {
        self.count
    }

    /// The greatest.
    pub(crate) fn most(&self) -> u64 {
        self.most
    }

    /// What so many of 100 are not above; none where nothing was counted.
    pub(crate) fn percentile(&self, percent: u64) -> Option<u64> {
        let all: u64 = self.buckets.iter().map(|count| u64::from(*count)).sum();
        let wanted = (all * percent).div_ceil(100).max(1);
        let mut sum = 0;
        let found = self.buckets.iter().position(|count| {
            sum += u64::from(*count);
            sum >= wanted
        })?;
        Some(highest(found).min(self.most))
    }
}

/// The bucket of an age: below 4 one each, then 4 for each power of two.
fn bucket(age: u64) -> usize {
    let age = age.min(MOST);
    let power = age.max(1).ilog2();
    let bucket = match power.checked_sub(FINE) {
        Some(shift) => (u64::from(shift + 1) << FINE) + ((age >> shift) & ((1 << FINE) - 1)),
        None => age,
    };
    usize::try_from(bucket).unwrap_or(BUCKETS - 1).min(BUCKETS - 1)
}

/// The greatest age of a bucket.
fn highest(bucket: usize) -> u64 {
    let bucket = bucket as u64;
    match (bucket >> FINE).checked_sub(1) {
        Some(shift) => (((1 << FINE) + (bucket & ((1 << FINE) - 1)) + 1) << shift) - 1,
        None => bucket,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buckets_are_narrow_and_in_order() {
        let mut last = 0;
        for age in
            (0..5000).chain((13..36).flat_map(|power| [(1 << power) - 1, 1 << power, (1 << power) + 1]))
        {
            let found = bucket(age);
            assert!(found >= last && found < BUCKETS, "{age}");
            last = found;
            let above = highest(found);
            assert!(age <= above && above <= age + age / 4, "{age}: {above}");
        }
        assert_eq!((bucket(MOST), bucket(u64::MAX)), (BUCKETS - 1, BUCKETS - 1));
    }

    #[test]
    fn percentiles_are_read_from_above() {
        let mut ages = Histogram::new();
        assert_eq!((ages.percentile(50), ages.count()), (None, 0));
        for age in 1..=1000 {
            ages.note(age);
        }
        ages.note(-5);
        for (percent, exact) in [(50, 500), (99, 990), (100, 1000)] {
            let found = ages.percentile(percent).unwrap();
            assert!(
                (exact..=exact + exact / 4).contains(&found),
                "p{percent} is {found}"
            );
        }
        assert_eq!((ages.most(), ages.count()), (1000, 1001));
        assert_eq!(ages.percentile(0), Some(0), "the least");
        ages.note(i64::MAX);
        assert_eq!(ages.percentile(100), Some(highest(BUCKETS - 1)));
    }
}
