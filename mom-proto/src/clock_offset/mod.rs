//! The offset of another clock from one's own, with its error (M34): four stamps per exchange.
//!
//! Each exchange is used only for what is certain: a parcel is sent before it arrives. With `t1` sent and `t4`
//! received by one's own clock, `t2` received and `t3` replied by the other, the offset of the other clock lies
//! between `t3 − t4` and `t2 − t1`, however unequal the two delays were. The middle is the offset of NTP, and half the
//! width its error, at most half the round trip.

use std::collections::VecDeque;

use crate::{Parcel, Time, Value};

/// The number of exchanges that are kept; older ones are forgotten.
const WINDOW: usize = 16;

/// The greatest drift between two clocks, in millionths: two quartz clocks of ±50.
const DRIFT: u64 = 100;

/// Stamps are truncated to whole µs: each may be up to 1 µs too early.
const RESOLUTION: i64 = 1;

/// The four stamps of one question and its answer.
///
/// Time between a stamp and the wire counts as time on the way: it makes the bounds wider, not wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exchange {
    /// When one asked, by one's own clock.
    pub sent: Time,
    /// When the other had the question, by its clock.
    pub received: Time,
    /// When the other answered, by its clock.
    pub replied: Time,
    /// When one had the answer, by one's own clock.
    pub heard: Time,
}

/// How far another clock is ahead of one's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockOffset {
    /// The other clock's time minus one's own, µs.
    pub micros: i64,
    /// The error bound, µs.
    pub error: u64,
}

/// The offset of one other clock, from the exchanges with it.
///
/// It reads no clock: `at` and `now` are µs of a monotonic clock of one's own. The error grows with the time since an
/// exchange, by 100 µs a second, and shrinks with each exchange that says more. An exchange that contradicts earlier
/// ones shows that one of the clocks was set: from then on it counts alone. A step that hides within the error of the
/// estimate is not seen at once; the estimate is then wrong by at most the round trip of the last exchange, and only
/// until 16 exchanges have passed.
///
/// ```
/// use mom_proto::{Exchange, OffsetEstimator, Time};
/// let time = |micros| Time::from_micros(micros).unwrap();
/// let mut estimator = OffsetEstimator::new();
/// // The other clock is an hour ahead; the way there took 300 µs, the way back 100 µs.
/// let hour = 3_600_000_000;
/// let exchange = Exchange { sent: time(0), received: time(hour + 300), replied: time(hour + 320), heard: time(420) };
/// estimator.push(exchange, 420);
/// let offset = estimator.at(420).unwrap();
/// assert_eq!((offset.micros, offset.error), (hour + 100, 202));
/// ```
#[derive(Clone, Debug, Default)]
pub struct OffsetEstimator {
    window: VecDeque<OffsetBounds>,
    /// Where all of the window agree.
    agreed: Option<OffsetBounds>,
}

/// The offset lies between `low` and `high` at monotonic time `at`.
#[derive(Clone, Copy, Debug)]
struct OffsetBounds {
    low: i64,
    high: i64,
    at: u64,
}

impl Exchange {
    /// The exchange of a ping sent at `sent` and its pong, with the stamps `received` and `sent` of its content. None
    /// if it has no stamps, as pongs of simple peers.
    pub fn of(sent: Time, pong: &Parcel, heard: Time) -> Option<Exchange> {
        let content = pong.value();
        let stamp = |key| content.get(key).and_then(Value::as_time);
        Some(Exchange {
            sent,
            received: stamp("received")?,
            replied: stamp("sent")?,
            heard,
        })
    }

    /// The least and the greatest offset that it allows; none if a clock was set during the exchange.
    fn bounds(&self, at: u64) -> Option<OffsetBounds> {
        let difference = |one: Time, other: Time| one.micros() - other.micros();
        // The clocks drift during the exchange, too.
        let took = u64::try_from(difference(self.heard, self.sent)).unwrap_or_default();
        let doubt = RESOLUTION + parted(took);
        let low = difference(self.replied, self.heard) - doubt;
        let high = difference(self.received, self.sent) + doubt;
        let in_order = self.sent <= self.heard && self.received <= self.replied;
        (in_order && low <= high).then_some(OffsetBounds { low, high, at })
    }
}

impl OffsetBounds {
    /// The bounds at a later time, widened by the drift.
    fn at(self, now: u64) -> OffsetBounds {
        let parted = now
            .saturating_sub(self.at)
            .saturating_mul(DRIFT)
            .div_ceil(1_000_000);
        let parted = i64::try_from(parted).unwrap_or(i64::MAX);
        OffsetBounds {
            low: self.low.saturating_sub(parted),
            high: self.high.saturating_add(parted),
            at: self.at.max(now),
        }
    }

    /// Where both hold.
    fn and(self, other: OffsetBounds) -> Option<OffsetBounds> {
        let at = self.at.max(other.at);
        let (one, other) = (self.at(at), other.at(at));
        let (low, high) = (one.low.max(other.low), one.high.min(other.high));
        (low <= high).then_some(OffsetBounds { low, high, at })
    }
}

/// The greatest drift in so many µs, µs.
fn parted(micros: u64) -> i64 {
    let parted = micros.saturating_mul(DRIFT).div_ceil(1_000_000);
    i64::try_from(parted).unwrap_or(i64::MAX)
}

impl OffsetEstimator {
    /// Without an estimate, until the first exchange.
    pub fn new() -> OffsetEstimator {
        OffsetEstimator::default()
    }

    /// Takes an exchange that ended at monotonic time `at`; whether it could be used.
    pub fn push(&mut self, exchange: Exchange, at: u64) -> bool {
        let Some(bounds) = exchange.bounds(at) else {
            return false;
        };
        if self.agreed.is_some_and(|agreed| agreed.and(bounds).is_none()) {
            self.window.clear();
        }
        if self.window.len() == WINDOW {
            self.window.pop_front();
        }
        self.window.push_back(bounds);
        // They agree: an exchange that contradicted the others has emptied the window.
        self.agreed = self
            .window
            .iter()
            .copied()
            .reduce(|one, other| one.and(other).unwrap_or(other));
        true
    }

    /// The offset at monotonic time `now`; none before the first exchange.
    pub fn at(&self, now: u64) -> Option<ClockOffset> {
        let OffsetBounds { low, high, .. } = self.agreed?.at(now);
        let width = high.saturating_sub(low);
        Some(ClockOffset {
            micros: low.saturating_add(width / 2),
            error: u64::try_from(width).unwrap_or_default().div_ceil(2),
        })
    }

    /// How many exchanges the estimate rests on.
    pub fn exchanges(&self) -> usize {
        self.window.len()
    }
}

impl ClockOffset {
    /// The time by one's own clock at which the other clock shows `other`.
    pub fn own(&self, other: Time) -> i64 {
        other.micros().saturating_sub(self.micros)
    }

    /// The offset so many µs later, with the drift added to its error.
    #[must_use]
    pub fn later(self, micros: u64) -> ClockOffset {
        let parted = u64::try_from(parted(micros)).unwrap_or_default();
        ClockOffset {
            error: self.error.saturating_add(parted),
            ..self
        }
    }

    /// What the other clock shows when one's own shows `own`.
    pub fn other(&self, own: Time) -> i64 {
        own.micros().saturating_add(self.micros)
    }
}

#[cfg(test)]
mod tests;
