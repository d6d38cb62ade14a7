//! The period T that the middle chooses itself, between two, from what it measures (S10).

use std::ops::RangeInclusive;

/// Packets of the robot over which its loss is measured: what a change brings shows after so many.
const WINDOW: u64 = 128;
/// From such a loss on fewer packets may help; below the other they may come more often again.
const CROWDED: f32 = 0.05;
const CLEAR: f32 = 0.01;
/// µs that packets may wait in the network beyond twice the shortest way that was seen.
const QUEUED: u64 = 20_000;
/// µs for which nothing is tried again after it has not helped, nor taken back after it has.
const HOLD: u64 = 60_000_000;

/// Chooses a period for one robot.
#[derive(Debug)]
pub(super) struct Pace {
    range: RangeInclusive<u16>,
    /// When it is looked at next, µs.
    look_at: u64,
    /// The shortest way there and back, without the wait for a period, µs.
    shortest: Option<u64>,
    /// The loss before the period was made longer.
    before: Option<f32>,
    /// No change before.
    hold_until: u64,
}

impl Pace {
    pub(super) fn new(range: RangeInclusive<u16>) -> Pace {
        Pace {
            range,
            look_at: 0,
            shortest: None,
            before: None,
            hold_until: 0,
        }
    }

    /// The period from now on, if it is to be another: twice as long where packets are lost or wait, and back where that does not help,
    /// as in a radio link that loses some whatever is sent; shorter by a quarter where all arrive.
    pub(super) fn next(&mut self, now: u64, period: u16, loss: f32, round_trip: Option<u64>) -> Option<u16> {
        if now < self.look_at {
            return None;
        }
        let (least, most) = (*self.range.start(), *self.range.end());
        let way = round_trip.map(|trip| trip.saturating_sub(u64::from(period) * 1000));
        let shortest = self.shortest.into_iter().chain(way).min();
        self.shortest = shortest;
        let queued = way
            .zip(shortest)
            .is_some_and(|(way, shortest)| way > 2 * shortest + QUEUED);
        let crowded = loss > CROWDED || queued;
        let chosen = if let Some(before) = self.before.take() {
            // It was made longer one look ago.
            self.hold_until = now + HOLD;
            let helped = !queued && loss < 0.7 * before;
            if helped { period } else { least }
        } else if now < self.hold_until {
            period
        } else if crowded {
            let longer = period.saturating_mul(2).min(most);
            self.before = (longer > period).then_some(if queued { f32::MAX } else { loss });
            longer
        } else if loss < CLEAR {
            (period - period / 4).max(least)
        } else {
            period
        };
        let chosen = chosen.clamp(least, most);
        self.look_at = now + WINDOW * 1000 * u64::from(chosen.max(period));
        (chosen != period).then_some(chosen)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A network as the pace meets it: what is lost, and how long the way is, at a period.
    fn periods(network: impl Fn(u16) -> (f32, u64), looks: usize) -> Vec<u16> {
        let mut pace = Pace::new(20..=40);
        let (mut now, mut period) = (0, 20);
        let mut seen = Vec::new();
        for _ in 0..looks {
            let (loss, way) = network(period);
            let trip = Some(way + u64::from(period) * 1000);
            period = pace.next(now, period, loss, trip).unwrap_or(period);
            assert_eq!(
                pace.next(now + 1000, period, 1.0, trip),
                None,
                "nothing shows so soon"
            );
            seen.push(period);
            now += 128 * 1000 * 40;
        }
        seen
    }

    #[test]
    fn a_quiet_network_has_the_shortest_period() {
        assert_eq!(periods(|_| (0.0, 3000), 4), [20; 4]);
    }

    #[test]
    fn a_crowded_network_has_fewer_packets_and_keeps_them() {
        let crowded = |period| if period < 40 { (0.3, 3000) } else { (0.0, 3000) };
        let seen = periods(crowded, 12);
        assert_eq!(seen, [40; 12]);
        let standing = |period| if period < 40 { (0.0, 200_000) } else { (0.0, 3000) };
        // The shortest way is known once it was short.
        let mut pace = Pace::new(20..=40);
        assert_eq!(pace.next(0, 20, 0.0, Some(23_000)), None);
        let (loss, way) = standing(20);
        assert_eq!(pace.next(10_000_000, 20, loss, Some(way + 20_000)), Some(40));
    }

    #[test]
    fn where_the_radio_loses_some_anyway_fewer_packets_are_not_kept() {
        let seen = periods(|_| (0.1, 3000), 14);
        assert_eq!(seen[..2], [40, 20], "it is tried once, and taken back");
        let longer = seen.iter().filter(|period| **period == 40).count();
        assert!(longer <= 2, "and not again for a minute: {seen:?}");
    }

    #[test]
    fn what_was_made_longer_is_made_shorter_when_the_network_is_free_again() {
        let mut pace = Pace::new(20..=200);
        let second = 1_000_000;
        let mut now = 0;
        let mut period = 20;
        for loss in [0.4, 0.4, 0.0] {
            period = pace.next(now, period, loss, None).unwrap_or(period);
            now += 61 * second;
        }
        let mut seen = Vec::new();
        for _ in 0..4 {
            period = pace.next(now, period, 0.0, None).unwrap_or(period);
            seen.push(period);
            now += 61 * second;
        }
        assert!(
            seen.is_sorted_by(|one, next| next <= one) && seen[3] == 20,
            "{seen:?}"
        );
    }
}
