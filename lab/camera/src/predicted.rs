//! Where the robot is by now (M34): its states are late, so its motion is continued from them.

use std::collections::VecDeque;
use std::time::Duration;

use mom_client::{Model, Parcel, Predictor, Time};

use crate::DrawnPose;

/// The shortest time between the two states that tell the velocity, µs. States that were held up come together, and
/// where their age is not known they would seem to be a leap.
const APART: i64 = 40_000;
/// The most states that are kept while they come closer together than that.
const MOST: usize = 64;
/// A state that is so much older than the last, µs, is not late: the hub's clock was set back.
const CLOCK_STEP: i64 = 2_000_000;

/// Predicts the gripper's pose from its states.
///
/// While the robot moves, the motion between its last two states that are 40 ms or more apart goes on, for at most the
/// horizon; then the pose is held. A robot that says that it stands is where it says, and its next motion begins
/// without a velocity: the way from a pose of long ago says nothing about it. A corner of the path or a stop shows
/// only in the next state, so a prediction overshoots it by the velocity times the delay, or times the horizon.
///
/// Times are those of the hub's clock.
///
/// ```
/// use std::time::Duration;
/// use mom_camera::{DrawnPose, PosePredictor};
/// use mom_client::{Family, Parcel, Time};
///
/// let state = |at: i64| {
///     let mut parcel = Parcel::new(Family::Message, "state");
///     parcel.received = Time::from_micros(at);
///     parcel
/// };
/// let mut hand = PosePredictor::new(Duration::from_millis(500));
/// hand.observe(&state(1_000_000), &DrawnPose { x: 10.0, ..DrawnPose::default() }, Some(true));
/// hand.observe(&state(1_050_000), &DrawnPose { x: 17.5, ..DrawnPose::default() }, Some(true));
/// let now = Time::from_micros(1_350_000).unwrap();
/// assert!((hand.at(now).unwrap().x - 62.5).abs() < 1e-9);
/// ```
#[derive(Debug, Clone)]
pub struct PosePredictor {
    predictor: Predictor,
    /// States of the motion, oldest first: one that is at least [`APART`] before the last, and those after it.
    states: VecDeque<PoseState>,
    moving: bool,
}

/// A state as the predictor takes it.
#[derive(Debug, Clone)]
struct PoseState {
    /// When it was created by the hub's clock, µs.
    created: i64,
    /// The parcel's stamps.
    stamps: Parcel,
    /// x, y, z, spin and tilt; angles go on beyond ±180°, so that they have no leap.
    values: [f64; 5],
}

impl PosePredictor {
    /// Without a state yet. A state older than the horizon says nothing about present motion.
    #[must_use]
    pub fn new(horizon: Duration) -> PosePredictor {
        PosePredictor {
            predictor: Predictor::new(Model::ConstantVelocity { horizon }),
            states: VecDeque::new(),
            moving: false,
        }
    }

    /// Takes the pose of a state that came in this parcel, and whether the robot says that it moves; one that does not
    /// say so may. Returns whether it was used: a state without the hub's stamps, or one older than the last, is not. After one
    /// that is more than 2 s older, those before it are forgotten.
    pub fn observe(&mut self, parcel: &Parcel, pose: &DrawnPose, moving: Option<bool>) -> bool {
        let Some(received) = parcel.received else {
            return false;
        };
        let created = received.micros().saturating_sub(parcel.age.unwrap_or_default());
        let before = self.states.back().map(|last| last.values);
        if let Some(last) = self.states.back().map(|last| last.created) {
            if last.saturating_sub(created) > CLOCK_STEP {
                self.states.clear();
            } else if created <= last {
                return false;
            }
        }
        let moves = moving.unwrap_or(true);
        if !(self.moving && moves) {
            self.states.clear();
        }
        self.moving = moves;
        let mut stamps = Parcel::new(parcel.family, parcel.name());
        (stamps.received, stamps.age, stamps.age_error) = (parcel.received, parcel.age, parcel.age_error);
        self.states.push_back(PoseState {
            created,
            stamps,
            values: values(&pose.drawable(), before),
        });
        // The newest of those that are far enough before becomes the first.
        while self.states.len() > MOST
            || self
                .states
                .get(1)
                .is_some_and(|next| created - next.created >= APART)
        {
            self.states.pop_front();
        }
        self.fit(created);
        true
    }

    /// Whether the robot moves, as far as it has said.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        self.moving && !self.states.is_empty()
    }

    /// The pose at a time of the hub; the last one if the robot stands. None without a state.
    #[must_use]
    pub fn at(&self, hub: Time) -> Option<DrawnPose> {
        let values = self.predictor.at(hub.micros())?.values;
        let [x, y, z, spin, tilt] = values[..] else {
            return None;
        };
        let (spin, tilt) = (within_turn(spin), within_turn(tilt));
        Some(DrawnPose { x, y, z, spin, tilt })
    }

    fn fit(&mut self, newest: i64) {
        self.predictor.clear();
        let far = |state: &&PoseState| newest - state.created >= APART;
        let pair = [self.states.front().filter(far), self.states.back()];
        for state in pair.into_iter().flatten() {
            self.predictor.observe(&state.stamps, &state.values);
        }
    }
}

/// The pose's values, with angles next to those before.
fn values(pose: &DrawnPose, before: Option<[f64; 5]>) -> [f64; 5] {
    let DrawnPose { x, y, z, spin, tilt } = *pose;
    match before {
        Some([.., last_spin, last_tilt]) => [x, y, z, near(spin, last_spin), near(tilt, last_tilt)],
        None => [x, y, z, spin, tilt],
    }
}

/// The same direction as `angle`, at most half a turn from `last`.
fn near(angle: f64, last: f64) -> f64 {
    last + within_turn(angle - last)
}

/// Above -180° and up to 180°.
fn within_turn(angle: f64) -> f64 {
    180.0 - (180.0 - angle).rem_euclid(360.0)
}

#[cfg(test)]
mod tests {
    use mom_client::Family;

    use super::*;

    const MS: i64 = 1000;
    const HORIZON: Duration = Duration::from_millis(500);

    fn at(ms: i64) -> Time {
        Time::from_micros(ms * MS).unwrap()
    }

    /// A state of this time that reached the hub so many ms later.
    fn state(created: i64, late: i64, known: bool) -> Parcel {
        let mut parcel = Parcel::new(Family::Message, "state");
        parcel.received = Some(at(created + late));
        parcel.age = known.then_some(late * MS);
        parcel
    }

    fn x(x: f64) -> DrawnPose {
        DrawnPose {
            x,
            ..DrawnPose::default()
        }
    }

    /// The largest errors of the measured and of the predicted tip, mm, while the truth moves and its states are late.
    fn errors(truth: impl Fn(f64) -> DrawnPose, delay: i64, from: i64, to: i64) -> (f64, f64) {
        let mut hand = PosePredictor::new(HORIZON);
        let (mut measured, mut worst) = (None, (0.0_f64, 0.0_f64));
        for now in from..to {
            let then = now - delay;
            if then >= from && then % 50 == 0 {
                let pose = truth(then as f64 / 1e3);
                assert!(hand.observe(&state(then, delay, true), &pose, Some(true)));
                measured = Some(pose);
            }
            // The first two states tell no velocity.
            let (Some(measured), true) = (measured, then >= from + 100) else {
                continue;
            };
            let here = truth(now as f64 / 1e3);
            let off = |pose: DrawnPose| (pose.x - here.x).hypot(pose.y - here.y).hypot(pose.z - here.z);
            worst.0 = worst.0.max(off(measured));
            worst.1 = worst.1.max(off(hand.at(at(now)).unwrap()));
        }
        worst
    }

    #[test]
    fn at_150_mm_a_second_and_300_ms_it_is_where_it_is() {
        let line = |t: f64| x(150.0 * t);
        let (measured, predicted) = errors(line, 300, 0, 2000);
        // 45 mm, and what has passed since the last of the states, which come every 50 ms.
        assert!((45.0..53.0).contains(&measured), "{measured}");
        assert!(predicted < 0.01, "{predicted}");
        // Around a circle of 100 mm the direction changes by 26 degrees meanwhile.
        let circle = |t: f64| DrawnPose {
            x: 100.0 * (1.5 * t).cos(),
            y: 100.0 * (1.5 * t).sin(),
            ..DrawnPose::default()
        };
        let (measured, predicted) = errors(circle, 300, 0, 3000);
        assert!(
            (44.0..53.0).contains(&measured) && predicted < 17.0,
            "{measured} {predicted}"
        );
        let (_, near) = errors(circle, 50, 0, 3000);
        assert!(near < 2.0, "{near}");
    }

    #[test]
    fn a_robot_that_stands_is_where_it_says() {
        let mut hand = PosePredictor::new(HORIZON);
        assert_eq!((hand.at(at(0)), hand.is_moving()), (None, false));
        for (time, place, moving) in [(0, 0.0, true), (50, 7.5, true), (100, 15.0, false)] {
            assert!(hand.observe(&state(time, 10, true), &x(place), Some(moving)));
        }
        assert_eq!(hand.at(at(400)), Some(x(15.0)), "no overshoot");
        assert!(!hand.is_moving());
        // After ten seconds at rest the way from there is no velocity.
        hand.observe(&state(10_000, 10, true), &x(16.0), Some(true));
        assert_eq!(hand.at(at(10_100)), Some(x(16.0)));
        hand.observe(&state(10_050, 10, true), &x(23.5), Some(true));
        assert!((hand.at(at(10_150)).unwrap().x - 38.5).abs() < 1e-9);
        assert!(
            (hand.at(at(19_000)).unwrap().x - 98.5).abs() < 1e-9,
            "held at the horizon"
        );
        assert!(
            !hand.observe(&state(10_040, 10, true), &x(0.0), Some(false)),
            "older"
        );
        assert!(hand.is_moving());
    }

    #[test]
    fn states_that_come_together_are_no_leap() {
        // Held up for 400 ms, and nobody knows their age: all seem to be of now.
        let mut hand = PosePredictor::new(HORIZON);
        hand.observe(&state(0, 0, false), &x(0.0), None);
        for step in 1..=8 {
            hand.observe(&state(400, step, false), &x(7.5 * step as f64), None);
        }
        let predicted = hand.at(at(708)).unwrap();
        assert!((predicted.x - 104.0).abs() < 3.0, "{predicted:?}");
        let mut flooded = PosePredictor::new(HORIZON);
        (0..30_000).for_each(|i| {
            let mut parcel = state(100, 0, false);
            parcel.received = Time::from_micros(100_000 + i);
            flooded.observe(&parcel, &x(0.0), None);
        });
        assert!(flooded.states.len() <= MOST);
    }

    #[test]
    fn states_go_on_when_the_hubs_clock_is_set_back() {
        let mut hand = PosePredictor::new(HORIZON);
        hand.observe(&state(10_000, 0, true), &x(0.0), Some(true));
        hand.observe(&state(10_050, 0, true), &x(7.5), Some(true));
        assert!(
            !hand.observe(&state(9_000, 0, true), &x(-1.0), Some(true)),
            "late"
        );
        assert!(hand.observe(&state(1_000, 0, true), &x(15.0), Some(true)));
        assert_eq!(hand.at(at(1_040)), Some(x(15.0)), "one state tells no velocity");
        assert!(hand.observe(&state(1_050, 0, true), &x(22.5), Some(true)));
        assert!((hand.at(at(1_100)).unwrap().x - 30.0).abs() < 1e-9);
    }

    #[test]
    fn angles_go_on_over_half_a_turn() {
        let turned = |spin: f64| DrawnPose {
            spin,
            ..DrawnPose::default()
        };
        let mut hand = PosePredictor::new(HORIZON);
        for (step, spin) in [170.0, 175.0, 180.0, -175.0].into_iter().enumerate() {
            hand.observe(&state(50 * step as i64, 0, true), &turned(spin), Some(true));
        }
        let spin = hand.at(at(200)).unwrap().spin;
        assert!((spin + 170.0).abs() < 1e-9, "{spin}");
        hand.observe(&state(200, 0, true), &turned(-180.0), Some(true));
        let spin = hand.at(at(250)).unwrap().spin;
        assert!((spin - 175.0).abs() < 1e-9, "{spin}");
        for (angle, within) in [(540.0, 180.0), (-180.0, 180.0), (-179.0, -179.0), (0.0, 0.0)] {
            assert_eq!(within_turn(angle), within);
        }
    }

    #[test]
    fn without_stamps_nothing_is_known() {
        let mut hand = PosePredictor::new(HORIZON);
        assert!(!hand.observe(&Parcel::new(Family::Message, "state"), &x(1.0), Some(true)));
        assert_eq!(hand.at(at(0)), None);
        // Numbers that are none do not spread.
        hand.observe(&state(0, 0, true), &x(f64::NAN), Some(true));
        hand.observe(&state(50, 0, true), &x(f64::INFINITY), Some(true));
        assert!(hand.at(at(90)).unwrap().x.is_finite());
    }
}
