//! Token buckets by peer, counted in whole numbers.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::{Bucket, Micros, Rate};

/// Parts of one request or byte: enough that each µs refills a whole number of them.
const PARTS: u64 = 1_000_000;

/// The highest rate and burst that are counted: its parts still fit the integer.
pub(crate) const HIGHEST: u64 = 1_000_000_000_000;

/// Why a request is over the quota.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Over {
    /// Enough will be left at this time.
    Until(Micros),
    /// It is larger than the burst.
    Never,
    /// Too many other peers are counted, at least until this time.
    Crowded(Micros),
}

/// The remaining quota of each peer at one rate. A peer whose buckets are full needs no entry.
#[derive(Debug)]
pub(crate) struct RateCounts {
    rate: Rate,
    most: usize,
    left: BTreeMap<Arc<str>, BucketsLeft>,
    /// While the table is full: no bucket is full again before this time.
    no_room_until: Micros,
}

/// Parts left in both buckets at a time.
#[derive(Clone, Copy, Debug)]
struct BucketsLeft {
    parcels: u64,
    bytes: u64,
    at: Micros,
}

impl RateCounts {
    /// Full buckets for every peer; at most so many peers are counted at once.
    pub(crate) fn new(rate: Rate, most: usize) -> RateCounts {
        RateCounts {
            rate,
            most,
            left: BTreeMap::new(),
            no_room_until: 0,
        }
    }

    pub(crate) fn rate(&self) -> Rate {
        self.rate
    }

    /// Takes one request of so many bytes, or nothing.
    pub(crate) fn take(&mut self, peer: &Arc<str>, bytes: usize, now: Micros) -> Result<(), Over> {
        let Rate {
            parcels: of_parcels,
            bytes: of_bytes,
        } = self.rate;
        let mut left = match self.left.get(peer) {
            Some(left) => left.at(&self.rate, now),
            None => {
                self.make_room(now)?;
                BucketsLeft::full(&self.rate, now)
            }
        };
        let bytes = u64::try_from(bytes).unwrap_or(u64::MAX);
        let wait = missing(of_parcels, left.parcels, 1)?.max(missing(of_bytes, left.bytes, bytes)?);
        if wait > 0 {
            return Err(Over::Until(now.saturating_add(wait)));
        }
        left.parcels = less(of_parcels, left.parcels, 1);
        left.bytes = less(of_bytes, left.bytes, bytes);
        self.left.insert(Arc::clone(peer), left);
        Ok(())
    }

    /// Removes peers whose buckets are full again, if the table is full.
    fn make_room(&mut self, now: Micros) -> Result<(), Over> {
        if self.left.len() < self.most {
            return Ok(());
        }
        if now >= self.no_room_until {
            let rate = self.rate;
            self.left.retain(|_, left| left.full_at(&rate) > now);
            if self.left.len() < self.most {
                return Ok(());
            }
            // Taking only delays it, so no earlier check can help.
            let first = self.left.values().map(|left| left.full_at(&rate)).min();
            self.no_room_until = first.unwrap_or(now);
        }
        Err(Over::Crowded(self.no_room_until))
    }
}

impl BucketsLeft {
    fn full(rate: &Rate, now: Micros) -> BucketsLeft {
        BucketsLeft {
            parcels: capacity(rate.parcels),
            bytes: capacity(rate.bytes),
            at: now,
        }
    }

    /// The remaining quota at a later time.
    fn at(&self, rate: &Rate, now: Micros) -> BucketsLeft {
        let elapsed = now.saturating_sub(self.at);
        let more = |bucket: Bucket, left: u64| {
            let back = elapsed.saturating_mul(bucket.per_second);
            left.saturating_add(back).min(capacity(bucket))
        };
        BucketsLeft {
            parcels: more(rate.parcels, self.parcels),
            bytes: more(rate.bytes, self.bytes),
            at: now,
        }
    }

    /// When both will be full if nothing more is taken.
    fn full_at(&self, rate: &Rate) -> Micros {
        let wait = |bucket: Bucket, left: u64| (capacity(bucket) - left).div_ceil(bucket.per_second);
        let longest = wait(rate.parcels, self.parcels).max(wait(rate.bytes, self.bytes));
        self.at.saturating_add(longest)
    }
}

fn is_unlimited(bucket: Bucket) -> bool {
    bucket == Bucket::UNLIMITED
}

/// The parts of a full bucket; an unlimited one is never checked.
fn capacity(bucket: Bucket) -> u64 {
    match is_unlimited(bucket) {
        true => 0,
        false => bucket.burst.saturating_mul(PARTS),
    }
}

/// How long until there is enough, µs.
fn missing(bucket: Bucket, left: u64, amount: u64) -> Result<Micros, Over> {
    if is_unlimited(bucket) {
        return Ok(0);
    }
    if amount > bucket.burst {
        return Err(Over::Never);
    }
    let needed = amount.saturating_mul(PARTS);
    Ok(needed.saturating_sub(left).div_ceil(bucket.per_second))
}

fn less(bucket: Bucket, left: u64, amount: u64) -> u64 {
    match is_unlimited(bucket) {
        true => left,
        false => left.saturating_sub(amount.saturating_mul(PARTS)),
    }
}
