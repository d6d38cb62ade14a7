//! Simulated links: what is true must lie within what is estimated.

use proptest::collection::vec;
use proptest::prelude::*;

use super::*;

/// Two clocks and the time that passes for both, µs.
#[derive(Clone, Debug)]
struct Link {
    now: i64,
    own: Clock,
    other: Clock,
}

/// A clock that is set `ahead` and runs too fast by so many millionths.
#[derive(Clone, Debug)]
struct Clock {
    ahead: i64,
    fast: i64,
}

impl Clock {
    fn at(&self, now: i64) -> i64 {
        self.ahead + now + now * self.fast / 1_000_000
    }
}

/// One round: a pause, the way there, the time at the other end, the way back.
type Round = (i64, i64, i64, i64);

impl Link {
    fn time(clock: &Clock, now: i64) -> Time {
        Time::from_micros(clock.at(now)).expect("a time of this century")
    }

    /// µs of one's own monotonic clock, which nobody sets.
    fn monotonic(&self) -> u64 {
        u64::try_from(self.now + self.now * self.own.fast / 1_000_000).expect("after the start")
    }

    fn exchange(&mut self, (pause, there, stay, back): Round) -> Exchange {
        self.now += pause;
        let sent = Link::time(&self.own, self.now);
        self.now += there;
        let received = Link::time(&self.other, self.now);
        self.now += stay;
        let replied = Link::time(&self.other, self.now);
        self.now += back;
        let heard = Link::time(&self.own, self.now);
        Exchange {
            sent,
            received,
            replied,
            heard,
        }
    }

    fn truth(&self) -> i64 {
        self.other.at(self.now) - self.own.at(self.now)
    }

    /// How far the truth is outside of the estimate, µs.
    fn outside(&self, estimator: &OffsetEstimator) -> i64 {
        let offset = estimator.at(self.monotonic()).expect("an exchange was made");
        let error = i64::try_from(offset.error).expect("a small error");
        // Whole µs of four clocks' readings.
        ((self.truth() - offset.micros).abs() - error - 2).max(0)
    }
}

const HOUR: i64 = 3_600_000_000;

fn link() -> impl Strategy<Value = Link> {
    let clock = || (-HOUR..HOUR, -49_i64..=49).prop_map(|(ahead, fast)| Clock { ahead, fast });
    (clock(), clock()).prop_map(|(mut own, mut other)| {
        // So that no reading is before the epoch.
        own.ahead += 10 * HOUR;
        other.ahead += 10 * HOUR;
        Link { now: 0, own, other }
    })
}

fn round() -> impl Strategy<Value = Round> {
    let way = || prop_oneof![4 => 0..2_000_i64, 2 => 0..200_000_i64, 1 => 0..5_000_000_i64];
    (0..30_000_000_i64, way(), 0..50_000_i64, way())
}

proptest! {
    /// However unequal the ways, and however the clocks part within the bound.
    #[test]
    fn the_truth_is_within_the_error(mut link in link(), rounds in vec(round(), 1..60), wait in 0..HOUR) {
        let mut estimator = OffsetEstimator::new();
        for round in rounds {
            let exchange = link.exchange(round);
            prop_assert!(estimator.push(exchange, link.monotonic()));
            prop_assert_eq!(link.outside(&estimator), 0);
        }
        link.now += wait;
        prop_assert_eq!(link.outside(&estimator), 0, "after {} s without an exchange", wait / 1_000_000);
    }

    /// The error is never above half the round trip of the last exchange.
    #[test]
    fn the_error_is_at_most_half_a_round_trip(mut link in link(), rounds in vec(round(), 1..40)) {
        let mut estimator = OffsetEstimator::new();
        for round in rounds {
            let exchange = link.exchange(round);
            estimator.push(exchange, link.monotonic());
            let error = estimator.at(link.monotonic()).unwrap().error;
            let trip = u64::try_from(round.1 + round.3).unwrap();
            let drift = 2 * (trip + u64::try_from(round.2).unwrap()) * DRIFT / 1_000_000;
            prop_assert!(error <= trip / 2 + drift + 4, "{error} µs of a round trip of {trip} µs");
        }
    }

    /// A step of either clock is seen by the next exchange if it is larger than what was in doubt.
    #[test]
    fn a_step_is_seen(
        mut link in link(),
        before in vec(round(), 1..30),
        step in 1_000_000..HOUR,
        back in any::<bool>(),
        mine in any::<bool>(),
        after in vec(round(), 1..30),
    ) {
        let mut estimator = OffsetEstimator::new();
        for round in before {
            let exchange = link.exchange(round);
            estimator.push(exchange, link.monotonic());
        }
        let doubt = 2 * i64::try_from(estimator.at(link.monotonic()).unwrap().error).unwrap();
        let (_, there, stay, way_back) = after[0];
        let pause = 30_000_000 + there + stay + way_back;
        let clock = if mine { &mut link.own } else { &mut link.other };
        let step = doubt + there + way_back + pause / 1_000 + step;
        clock.ahead += if back { -step } else { step };
        for round in after {
            let exchange = link.exchange(round);
            prop_assert!(estimator.push(exchange, link.monotonic()));
            prop_assert_eq!(link.outside(&estimator), 0);
        }
    }

    /// A step that hides in the error is wrong by a round trip at most, and forgotten after the window.
    #[test]
    fn a_small_step_is_forgotten(
        mut link in link(),
        before in vec(round(), 1..30),
        step in -100_000..100_000_i64,
        after in vec(round(), 16..24),
    ) {
        let mut estimator = OffsetEstimator::new();
        for round in before {
            let exchange = link.exchange(round);
            estimator.push(exchange, link.monotonic());
        }
        link.other.ahead += step;
        for (count, round) in after.into_iter().enumerate() {
            let exchange = link.exchange(round);
            estimator.push(exchange, link.monotonic());
            let (trip, outside) = (round.1 + round.3, link.outside(&estimator));
            prop_assert!(outside <= trip + 4, "{outside} µs with a round trip of {trip} µs");
            if count + 1 >= WINDOW {
                prop_assert_eq!(outside, 0);
            }
        }
    }
}

#[test]
fn a_short_round_trip_outlasts_longer_ones() {
    let clock = |ahead| Clock { ahead, fast: 0 };
    let mut link = Link {
        now: 0,
        own: clock(HOUR),
        other: clock(2 * HOUR),
    };
    let mut estimator = OffsetEstimator::new();
    assert_eq!(estimator.at(0), None);
    for round in [
        (0, 100, 10, 100),
        (1_000_000, 90_000, 10, 100),
        (1_000_000, 100, 10, 90_000),
    ] {
        let exchange = link.exchange(round);
        assert!(estimator.push(exchange, link.monotonic()));
    }
    let offset = estimator.at(link.monotonic()).expect("three exchanges");
    assert!(offset.error < 500, "{offset:?}");
    assert_eq!(link.outside(&estimator), 0);
    assert_eq!(estimator.exchanges(), 3);
}

#[test]
fn stamps_that_cannot_be_are_not_used() {
    let time = |micros| Time::from_micros(micros).expect("a time");
    let exchange = |sent, received, replied, heard| Exchange {
        sent: time(sent),
        received: time(received),
        replied: time(replied),
        heard: time(heard),
    };
    let mut estimator = OffsetEstimator::new();
    for (bad, why) in [
        (exchange(10, 5, 6, 9), "heard before it was sent"),
        (exchange(0, 6, 5, 10), "replied before it was received"),
        (exchange(0, 100, 200, 10), "away for longer than it was missing"),
    ] {
        assert!(!estimator.push(bad, 0), "{why}");
    }
    assert_eq!(estimator.at(0), None);
    let far = Exchange {
        sent: Time::MIN,
        received: Time::MAX,
        replied: Time::MAX,
        heard: Time::MIN,
    };
    assert!(estimator.push(far, u64::MAX), "far, but possible");
    assert!(estimator.at(0).is_some() && estimator.at(u64::MAX).is_some());
}
