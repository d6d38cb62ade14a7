//! Predicts a device's present state from earlier ones (M34: measure, age of information, prediction).

use std::time::Duration;

use mom_proto::Parcel;

use crate::{Age, HubClock};

/// The model for the time since the last state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// Holds the last state.
    LastValue,
    /// Continues the motion between the last two states, for at most this long after the last; then holds.
    ConstantVelocity {
        /// An older state says nothing about present motion.
        horizon: Duration,
    },
}

/// Predicts the values of a device's states, such as the angles of its joints.
///
/// Times are those of creation, on the hub's clock, so states that arrive late, in bursts, or over different links
/// are ordered correctly.
///
/// ```
/// use std::time::Duration;
/// use mom_client::{Family, Model, Parcel, Predictor, Time};
///
/// let state = |at, age| {
///     let mut parcel = Parcel::new(Family::Message, "state");
///     parcel.received = Time::from_micros(at);
///     parcel.age = Some(age);
///     parcel.age_error = Some(500);
///     parcel
/// };
/// let mut joint = Predictor::new(Model::ConstantVelocity { horizon: Duration::from_millis(300) });
/// // Created at 1.00 s and 1.10 s, but the second was 40 ms under way.
/// joint.observe(&state(1_000_000, 0), &[20.0]);
/// joint.observe(&state(1_140_000, 40_000), &[21.0]);
/// let now = joint.at(1_200_000).unwrap();
/// assert_eq!(now.values, [22.0]);
/// assert_eq!((now.age.micros, now.age.error_micros), (100_000, Some(500)));
/// ```
///
/// On a live link [`Predictor::now`] takes the time from [`Client::clock`](crate::Client::clock).
#[derive(Clone, Debug)]
pub struct Predictor {
    model: Model,
    last: Option<Observation>,
    before: Option<Observation>,
}

/// A prediction and its basis.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// The values for now.
    pub values: Vec<f64>,
    /// The age of the state that this bridges.
    pub age: Age,
    /// Whether the state is older than the model's horizon: the values are those at the horizon.
    pub beyond: bool,
}

#[derive(Clone, Debug)]
struct Observation {
    /// When it was created by the hub's clock, µs since the epoch.
    created: i64,
    error: Option<u64>,
    values: Vec<f64>,
}

impl Predictor {
    /// Without a state yet.
    pub fn new(model: Model) -> Predictor {
        Predictor {
            model,
            last: None,
            before: None,
        }
    }

    /// Takes the values of a state that came in this parcel. A state older than the last is ignored, and another
    /// number of values starts over. Returns whether it was used; a parcel without the hub's stamps is not.
    pub fn observe(&mut self, parcel: &Parcel, values: &[f64]) -> bool {
        let Some(received) = parcel.received else {
            return false;
        };
        let state = Observation {
            created: received.micros().saturating_sub(parcel.age.unwrap_or_default()),
            error: parcel.age_error,
            values: values.to_vec(),
        };
        if let Some(last) = self.last.take() {
            if last.values.len() != values.len() {
                self.before = None;
            } else if state.created <= last.created {
                self.last = Some(last);
                return false;
            } else {
                self.before = Some(last);
            }
        }
        self.last = Some(state);
        true
    }

    /// Forgets all states, as after a jump.
    pub fn clear(&mut self) {
        (self.last, self.before) = (None, None);
    }

    /// The prediction for now; none without a state, or without an estimate of the hub's clock.
    pub fn now(&self, clock: &HubClock) -> Option<Prediction> {
        let (now, error) = clock.now()?;
        let mut prediction = self.at(now.micros())?;
        let more = u64::try_from(error.as_micros()).unwrap_or(u64::MAX);
        let age = &mut prediction.age;
        age.error_micros = age.error_micros.map(|error| error.saturating_add(more));
        Some(prediction)
    }

    /// The prediction for a time of the hub, µs since the epoch; none without a state.
    pub fn at(&self, micros: i64) -> Option<Prediction> {
        let last = self.last.as_ref()?;
        let since = micros.saturating_sub(last.created);
        let (bridged, beyond) = match self.model {
            Model::LastValue => (0, false),
            Model::ConstantVelocity { horizon } => {
                let most = i64::try_from(horizon.as_micros()).unwrap_or(i64::MAX);
                (since.clamp(0, most), since > most)
            }
        };
        Some(Prediction {
            values: self.moved(last, bridged),
            age: Age {
                micros: since,
                error_micros: last.error,
            },
            beyond,
        })
    }

    /// The values this many µs after the last state.
    fn moved(&self, last: &Observation, bridged: i64) -> Vec<f64> {
        let Some(before) = self.before.as_ref().filter(|_| bridged > 0) else {
            return last.values.clone();
        };
        // A fraction of the last step, so that no time is divided by what may be 0: steps are of at least 1 µs.
        let step = seconds(last.created.saturating_sub(before.created));
        let part = seconds(bridged) / step;
        let values = last.values.iter().zip(&before.values);
        values
            .map(|(last, before)| last + (last - before) * part)
            .collect()
    }
}

fn seconds(micros: i64) -> f64 {
    let whole = Duration::from_micros(micros.unsigned_abs());
    whole.as_secs_f64()
}

#[cfg(test)]
mod tests {
    use super::*;
    use mom_proto::{Family, Time};

    fn state(created: i64, age: i64) -> Parcel {
        let mut parcel = Parcel::new(Family::Message, "state");
        parcel.received = Time::from_micros(created + age);
        parcel.age = Some(age);
        parcel
    }

    /// States as (created, age, value), and what is predicted for a time as (value, age, beyond).
    fn check(model: Model, states: &[(i64, i64, f64)], at: i64, expected: (f64, i64, bool)) {
        let mut predictor = Predictor::new(model);
        for (created, age, value) in states {
            predictor.observe(&state(*created, *age), &[*value, -*value]);
        }
        let found = predictor.at(at).unwrap();
        let (value, age, beyond) = expected;
        assert!(
            (found.values[0] - value).abs() < 1e-9,
            "{found:?} instead of {expected:?}"
        );
        assert!((found.values[1] + value).abs() < 1e-9, "{found:?}");
        assert_eq!((found.age.micros, found.beyond), (age, beyond));
        assert_eq!(
            found.age.error(),
            None,
            "the hub did not know the clock of the sender"
        );
    }

    const GOES_ON: Model = Model::ConstantVelocity {
        horizon: Duration::from_millis(200),
    };

    #[test]
    fn values_go_on_as_they_did_up_to_the_horizon() {
        let steps = [(0, 0, 1.0), (100_000, 70_000, 2.0)];
        check(GOES_ON, &steps, 100_000, (2.0, 0, false));
        check(GOES_ON, &steps, 150_000, (2.5, 50_000, false));
        check(GOES_ON, &steps, 300_000, (4.0, 200_000, false));
        check(GOES_ON, &steps, 900_000, (4.0, 800_000, true));
        check(GOES_ON, &steps, 50_000, (2.0, -50_000, false));
        check(Model::LastValue, &steps, 900_000, (2.0, 800_000, false));
    }

    #[test]
    fn what_is_older_than_the_last_is_not_used() {
        let late = [
            (0, 0, 1.0),
            (100_000, 0, 2.0),
            (50_000, 90_000, 9.0),
            (100_000, 0, 9.0),
        ];
        check(GOES_ON, &late, 200_000, (3.0, 100_000, false));
        check(GOES_ON, &late[..1], 200_000, (1.0, 200_000, false));
    }

    #[test]
    fn other_states_begin_anew() {
        let mut predictor = Predictor::new(GOES_ON);
        assert_eq!(predictor.at(0), None);
        assert!(
            !predictor.observe(&Parcel::new(Family::Message, "state"), &[1.0]),
            "no stamp"
        );
        assert!(predictor.observe(&state(0, 0), &[1.0]) && predictor.observe(&state(1_000, 0), &[2.0]));
        assert!(predictor.observe(&state(2_000, 0), &[7.0, 8.0]));
        assert_eq!(predictor.at(3_000).unwrap().values, [7.0, 8.0]);
        predictor.clear();
        assert_eq!(predictor.at(3_000), None);
    }
}
