//! Log lines of refused connections, which anybody can cause at will: the first is written at once, and of those that follow how many
//! there were.

use std::time::Duration;

use tokio::time::Instant;

/// One line in so long at most, for all robots of the program and each reason.
const EACH: Duration = Duration::from_secs(10);

/// Refusals for one reason.
#[derive(Debug, Default)]
pub(crate) struct Refusals {
    told: Option<Instant>,
    untold: u64,
}

impl Refusals {
    pub(crate) const NONE: Self = Self {
        told: None,
        untold: 0,
    };

    /// Counts one; how many were not told of before it, if a line is to be written now.
    pub(crate) fn count(&mut self, now: Instant) -> Option<u64> {
        if self.told.is_some_and(|told| now < told + EACH) {
            self.untold += 1;
            return None;
        }
        self.told = Some(now);
        Some(std::mem::take(&mut self.untold))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_line_is_written_and_then_a_count_at_intervals() {
        let (begin, mut refusals) = (Instant::now(), Refusals::NONE);
        let mut lines = Vec::new();
        for ms in 0..25_000 {
            lines.extend(refusals.count(begin + Duration::from_millis(ms)));
        }
        assert_eq!(lines, [0, 9999, 9999]);
        assert_eq!(refusals.count(begin + Duration::from_secs(60)), Some(4999));
    }
}
