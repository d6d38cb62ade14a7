//! How much is read of a robot: so many bytes in a second, and no more at once than in one second.

use super::SECOND;

#[derive(Debug)]
pub(super) struct Budget {
    rate: i64,
    /// What is left, in bytes times µs, so that nothing is rounded away.
    left: i64,
    /// As of this time.
    at: i64,
}

impl Budget {
    pub(super) fn new(rate: u32) -> Budget {
        let rate = i64::from(rate.max(1));
        Budget {
            rate,
            left: rate * SECOND,
            at: i64::MIN,
        }
    }

    pub(super) fn refill(&mut self, now: i64) {
        // After a second all is there.
        let passed = now.saturating_sub(self.at).clamp(0, SECOND);
        self.left = (self.left + passed * self.rate).min(self.rate * SECOND);
        self.at = self.at.max(now);
    }

    pub(super) fn left(&mut self, now: i64) -> usize {
        self.refill(now);
        usize::try_from(self.left / SECOND).unwrap_or_default()
    }

    pub(super) fn spend(&mut self, now: i64, bytes: usize) {
        self.refill(now);
        let bytes = i64::try_from(bytes).unwrap_or(i64::MAX).min(self.rate);
        self.left = (self.left - bytes * SECOND).max(0);
    }

    /// When reading goes on after the budget is used up: with a tenth of it, so that there are not wakes for single bytes.
    pub(super) fn refilled_at(&self) -> Option<i64> {
        if self.left >= SECOND {
            return None;
        }
        let missing = (self.rate * SECOND / 10).max(SECOND) - self.left;
        Some(self.at.saturating_add(missing / self.rate + 1))
    }
}
