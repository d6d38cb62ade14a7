//! What each peer has used of one rate.

use std::collections::BTreeMap;
use std::sync::Arc;

use mom_proto::{Gcra, Micros, Pace, Wait};

use crate::Rate;

/// The highest rate and burst of a quota.
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

/// What each peer has used of one rate. A peer that has paid everything back needs no entry.
#[derive(Debug)]
pub(crate) struct RateCounts {
    rate: Rate,
    most: usize,
    used: BTreeMap<Arc<str>, Used>,
    /// While there is no room: nobody has paid everything back before this time.
    no_room_until: Micros,
}

/// What one peer has used.
#[derive(Clone, Copy, Debug, Default)]
struct Used {
    parcels: Gcra,
    bytes: Gcra,
}

impl RateCounts {
    /// Nothing used by anybody; at most so many peers are counted at once.
    pub(crate) fn new(rate: Rate, most: usize) -> RateCounts {
        RateCounts {
            rate,
            most,
            used: BTreeMap::new(),
            no_room_until: 0,
        }
    }

    pub(crate) fn rate(&self) -> Rate {
        self.rate
    }

    /// Takes one request of so many bytes, or nothing.
    pub(crate) fn take(&mut self, peer: &Arc<str>, bytes: usize, now: Micros) -> Result<(), Over> {
        let mut used = match self.used.get(peer) {
            Some(used) => *used,
            None => {
                self.make_room(now)?;
                Used::default()
            }
        };
        let (parcels, bytes_pace) = paces(&self.rate);
        let bytes = u64::try_from(bytes).unwrap_or(u64::MAX);
        let wait =
            over(used.parcels.peek(&parcels, 1, now))?.max(over(used.bytes.peek(&bytes_pace, bytes, now))?);
        if wait > 0 {
            return Err(Over::Until(now.saturating_add(wait)));
        }
        used.parcels.charge(&parcels, 1, now);
        used.bytes.charge(&bytes_pace, bytes, now);
        self.used.insert(Arc::clone(peer), used);
        Ok(())
    }

    /// Forgets peers that have paid everything back, if there is no room for another one.
    fn make_room(&mut self, now: Micros) -> Result<(), Over> {
        if self.used.len() < self.most {
            return Ok(());
        }
        if now >= self.no_room_until {
            let rate = self.rate;
            self.used.retain(|_, used| used.paid_at(&rate) > now);
            if self.used.len() < self.most {
                return Ok(());
            }
            // Taking only ever puts it off, so nobody need be looked at before.
            let first = self.used.values().map(|used| used.paid_at(&rate)).min();
            self.no_room_until = first.unwrap_or(now);
        }
        Err(Over::Crowded(self.no_room_until))
    }
}

impl Used {
    /// When everything is paid back if nothing more is used.
    fn paid_at(&self, rate: &Rate) -> Micros {
        let (parcels, bytes) = paces(rate);
        self.parcels.next(&parcels).max(self.bytes.next(&bytes))
    }
}

fn paces(rate: &Rate) -> (Pace, Pace) {
    (rate.parcels.pace(), rate.bytes.pace())
}

/// How long until there is enough, µs.
fn over(peeked: Result<(), Wait>) -> Result<Micros, Over> {
    match peeked {
        Ok(()) => Ok(0),
        Err(Wait::For(wait)) => Ok(wait),
        Err(Wait::Never) => Err(Over::Never),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Bucket;

    #[test]
    fn who_has_paid_everything_back_makes_room_for_another() {
        let rate = Rate {
            parcels: Bucket {
                per_second: 1,
                burst: 1,
            },
            bytes: Bucket::UNLIMITED,
        };
        let mut counts = RateCounts::new(rate, 2);
        let [alice, bob, carol] = ["alice", "bob", "carol"].map(Arc::<str>::from);
        let second = 1_000_000;
        assert_eq!(counts.take(&alice, 0, 0), Ok(()));
        assert_eq!(counts.take(&bob, 0, second / 2), Ok(()));
        assert_eq!(counts.take(&carol, 0, second / 2), Err(Over::Crowded(second)));
        assert_eq!(
            counts.take(&alice, 0, second / 2),
            Err(Over::Until(second)),
            "she is counted"
        );
        assert_eq!(counts.take(&carol, 0, second - 1), Err(Over::Crowded(second)));
        assert_eq!(counts.take(&carol, 0, second), Ok(()), "in alice's place");
        assert_eq!(counts.take(&alice, 0, second), Err(Over::Crowded(3 * second / 2)));
    }
}
