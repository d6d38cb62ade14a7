//! Whether the device rests: measured, not meant.

use mom_client::{Map, Value};

use crate::DeviceTime;

/// Measurements that differ by less than the tolerance over so long, in µs, are those of a device at rest.
pub const REST: DeviceTime = 300_000;

/// µs between two looks at a device that may be coming to rest.
const LOOK: DeviceTime = 50_000;

/// µs between two looks at a device that rests, and that something may move.
pub const LOOK_AT_REST: DeviceTime = 150_000;

/// The key of a position that is an angle, degrees.
const HEADING: &str = "heading";

/// How it is known that the device rests.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AtRest {
    /// By measurements taken since it was to stand.
    Measured,
    /// It does not measure, and its stopping time has passed since it was to stand.
    NotMeasured,
}

impl AtRest {
    /// The word in its state.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Measured => "measured",
            Self::NotMeasured => "not-measured",
        }
    }
}

/// What is measured of the device at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// When it was measured, at the earliest.
    pub at: DeviceTime,
    /// And at the latest.
    until: DeviceTime,
    /// Each number of its position.
    values: Vec<f64>,
}

impl Sample {
    /// Of these numbers, always in the same order.
    #[must_use]
    pub fn new(values: Vec<f64>, at: DeviceTime) -> Sample {
        Sample {
            at,
            until: at,
            values,
        }
    }

    /// The same where it was measured then at the latest, such as when it came.
    #[must_use]
    pub fn until(mut self, until: DeviceTime) -> Sample {
        self.until = until.max(self.at);
        self
    }

    /// Of its position; none if that has no number.
    #[must_use]
    pub fn of(position: &Map, at: DeviceTime) -> Option<Sample> {
        let number = |value: &Value| match value {
            Value::Int(number) => Some(*number as f64),
            Value::Double(number) => Some(*number),
            _ => None,
        };
        let mut values = Vec::new();
        for (key, value) in position.iter() {
            match (number(value), key) {
                // Degrees that go on from 359 at 0: on a circle on which a small turn is as long as its angle.
                (Some(angle), HEADING) => {
                    let (sine, cosine) = angle.to_radians().sin_cos();
                    values.extend([sine.to_degrees(), cosine.to_degrees()]);
                }
                (number, _) => values.extend(number),
            }
        }
        (!values.is_empty()).then(|| Sample::new(values, at))
    }

    /// Whether it has moved by less than this, all of its numbers together: a turn must not hide behind two that each change a little less.
    fn is_near(&self, other: &Sample, tolerance: f64) -> bool {
        let pairs = self.values.iter().zip(&other.values);
        let way = pairs
            .map(|(one, other)| (one - other).powi(2))
            .sum::<f64>()
            .sqrt();
        self.values.len() == other.values.len() && way < tolerance
    }
}

/// Watches a device come to rest. What was measured before it was to stand is worth nothing.
#[derive(Debug)]
pub struct Rest {
    tolerance: f64,
    stopping_time: DeviceTime,
    /// When something moved it last, or it was to stand; none before it was looked at.
    since: Option<DeviceTime>,
    /// The first of the measurements that differ by less than the tolerance.
    first: Option<Sample>,
    known: Option<AtRest>,
}

impl Rest {
    /// Of a device whose numbers differ by less than the tolerance at rest, and that stands so many µs after it was to.
    #[must_use]
    pub fn new(tolerance: f64, stopping_time: DeviceTime) -> Rest {
        Rest {
            tolerance,
            stopping_time,
            since: None,
            first: None,
            known: None,
        }
    }

    /// Something moves it, or may: that it rests is to be found out anew.
    pub fn disturb(&mut self, now: DeviceTime) {
        (self.since, self.first, self.known) = (Some(now), None, None);
    }

    /// Takes in what is measured now; without a measurement its stopping time is waited for.
    pub fn observe(&mut self, sample: Option<Sample>, now: DeviceTime) {
        let since = *self.since.get_or_insert(now);
        // What is not a number is not a measurement.
        let is_finite = |sample: &Sample| sample.values.iter().all(|value| value.is_finite());
        let Some(sample) = sample.filter(is_finite) else {
            self.first = None;
            let passed = now.saturating_sub(since) >= self.stopping_time;
            self.known = passed.then_some(AtRest::NotMeasured);
            return;
        };
        if sample.at < since {
            return;
        }
        match self
            .first
            .as_ref()
            .filter(|first| sample.is_near(first, self.tolerance))
        {
            Some(first) if sample.at.saturating_sub(first.until) >= REST => {
                self.known = Some(AtRest::Measured);
            }
            // It is not known yet, or was before it stopped to measure.
            Some(_) => self.known = self.known.filter(|known| *known == AtRest::Measured),
            None => (self.first, self.known) = (Some(sample), None),
        }
    }

    /// How it is known that it rests, if it is.
    #[must_use]
    pub fn known(&self) -> Option<AtRest> {
        self.known
    }

    /// When it is to be looked at next; none once it rests.
    #[must_use]
    pub fn next_look(&self, now: DeviceTime) -> Option<DeviceTime> {
        self.known.is_none().then(|| now.saturating_add(LOOK))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const STOPPING: DeviceTime = 500_000;

    fn sample(x: f64, at: DeviceTime) -> Option<Sample> {
        Sample::of(&Map::new().with("x", Value::Double(x)).with("name", "a"), at)
    }

    #[test]
    fn a_whole_number_is_a_position_too_and_words_are_those_of_the_wire() {
        let map = Map::new().with("x", 5);
        assert_eq!(Sample::of(&map, 0), Some(Sample::new(vec![5.0], 0)));
        assert_eq!(Sample::of(&Map::new().with("name", "a"), 0), None);
        assert_eq!(AtRest::Measured.word(), "measured");
        assert_eq!(AtRest::NotMeasured.word(), "not-measured");
    }

    #[test]
    fn what_rolls_does_not_rest_and_what_stands_rests_after_three_tenths_of_a_second() {
        let mut rest = Rest::new(1.0, STOPPING);
        rest.disturb(100_000);
        // Measured before it was to stand.
        rest.observe(sample(0.0, 90_000), 500_000);
        assert_eq!(rest.known(), None);
        for step in 0..20 {
            let now = 100_000 + step * 50_000;
            rest.observe(sample(step as f64 * 2.0, now), now);
            assert_eq!(rest.known(), None, "it rolls at 40 mm/s");
        }
        let stands = 100_000 + 19 * 50_000;
        rest.observe(sample(38.5, stands + REST - 1), stands + REST - 1);
        assert_eq!(rest.known(), None);
        rest.observe(sample(38.5, stands + REST), stands + REST);
        assert_eq!(rest.known(), Some(AtRest::Measured));
        // Pushed.
        rest.observe(sample(60.0, stands + 900_000), stands + 900_000);
        assert_eq!(rest.known(), None);
    }

    #[test]
    fn without_a_measurement_the_stopping_time_is_waited_for() {
        let mut rest = Rest::new(1.0, STOPPING);
        rest.disturb(1_000);
        rest.observe(None, STOPPING);
        assert_eq!(
            (rest.known(), rest.next_look(STOPPING)),
            (None, Some(STOPPING + LOOK))
        );
        rest.observe(None, 1_000 + STOPPING);
        assert_eq!(
            (rest.known(), rest.next_look(1)),
            (Some(AtRest::NotMeasured), None)
        );
        rest.observe(sample(3.0, 700_000), 700_000);
        assert_eq!(rest.known(), None, "what is measured counts");
    }

    #[test]
    fn a_heading_goes_on_at_the_full_turn_and_what_is_no_number_is_no_measurement() {
        let heading = |angle: f64, at| Sample::of(&Map::new().with("heading", Value::Double(angle)), at);
        let mut rest = Rest::new(2.0, STOPPING);
        for (step, angle) in [359.0, 0.0, 359.6, 0.4, 359.0].into_iter().enumerate() {
            let now = 100_000 * step as i64;
            rest.observe(heading(angle, now), now);
        }
        assert_eq!(rest.known(), Some(AtRest::Measured));
        rest.observe(heading(3.0, 500_000), 500_000);
        assert_eq!(rest.known(), None, "it has turned by more than two degrees");
        let mut rest = Rest::new(2.0, STOPPING);
        for step in 0..=10 {
            rest.observe(sample(f64::NAN, step * 50_000), step * 50_000);
        }
        assert_eq!(rest.known(), Some(AtRest::NotMeasured));
    }

    #[test]
    fn the_stopping_time_begins_when_it_is_looked_at_first() {
        let mut rest = Rest::new(1.0, STOPPING);
        rest.observe(None, 600_000_000);
        assert_eq!(rest.known(), None);
        rest.observe(None, 600_000_000 + STOPPING);
        assert_eq!(rest.known(), Some(AtRest::NotMeasured));
    }

    proptest! {
        /// Whatever it does and whenever it is looked at: where it rests by its word, it has moved by less than twice the tolerance in the
        /// last 0.3 s of measurements.
        #[test]
        fn who_rests_has_not_moved(steps in proptest::collection::vec((1_000..200_000_i64, -1.5..1.5_f64), 1..200)) {
            let (mut rest, mut seen) = (Rest::new(1.0, STOPPING), Vec::new());
            let (mut now, mut x) = (0, 0.0);
            for (pause, step) in steps {
                (now, x) = (now + pause, x + step);
                rest.observe(sample(x, now), now);
                seen.push((now, x));
                if rest.known().is_some() {
                    for (_, then) in seen.iter().filter(|(at, _)| *at >= now - REST) {
                        prop_assert!((x - then).abs() < 2.0, "{:?}", seen);
                    }
                }
            }
        }
    }
}
