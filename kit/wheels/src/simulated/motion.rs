//! How a differential drive moves on a floor without walls, as a pure function of time.
//!
//! Each wheel follows its motor with a lag of first order: its speed is `u + (v − u) e^(−t/lag)`, where v is the speed at the
//! beginning and u what the motor is set to. So are the speed of the axle's middle and the turning speed, as they are sums
//! of the wheels', and the heading, which is an integral of the latter, is known in closed form.
//!
//! The position is not, as long as the wheels' speeds change. It is integrated by Gauss–Legendre quadrature with 3 points
//! in steps of half the lag and half a radian at most (its error is of the order 6): halving the step moves the end by less
//! than 0.001 mm. When both wheels are within 0.001 mm/s of what they are set to, which takes 14 times the lag or less
//! for the LinuxBot, they have it, and the rest is a line or an arc in closed form. This moves the end by less than 0.0001 mm,
//! and turns it by less than 0.0001°.

use crate::{Chassis, Motors};

/// mm/s, the difference between a wheel's speed and its motor's setting that counts as none.
const SETTLED: f64 = 0.001;
/// Steps of the quadrature take no more of the lag than this.
const STEP_OF_LAG: f64 = 0.5;
/// Steps of the quadrature turn no further than this, in radians.
const STEP_OF_TURN: f64 = 0.5;
/// The points of the quadrature in a step from 0 to 1, and their weights.
const POINTS: [(f64, f64); 3] = [
    (0.112_701_665_379_258_3, 5.0 / 18.0),
    (0.5, 8.0 / 18.0),
    (0.887_298_334_620_741_7, 5.0 / 18.0),
];

/// A pose for computing: the heading in radians, and not brought into half a turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spot {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) heading: f64,
}

/// The speeds of a drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Speeds {
    /// mm/s of the axle's middle; positive is forward.
    pub(super) ahead: f64,
    /// rad/s; positive is counterclockwise.
    pub(super) turn: f64,
}

impl Speeds {
    pub(super) const NONE: Self = Self {
        ahead: 0.0,
        turn: 0.0,
    };

    /// What motors lead to, in the end.
    pub(super) fn of(motors: Motors, chassis: &Chassis) -> Self {
        let per_mille = chassis.full_speed / f64::from(crate::MOTOR_LIMIT);
        let (left, right) = (f64::from(motors.left()), f64::from(motors.right()));
        Self {
            ahead: (left + right) / 2.0 * per_mille,
            turn: (right - left) * per_mille / chassis.wheel_base,
        }
    }

    /// mm/s of the wheels, left and right.
    pub(super) fn wheels(self, wheel_base: f64) -> [f64; 2] {
        let rim = self.turn * wheel_base / 2.0;
        [self.ahead - rim, self.ahead + rim]
    }
}

/// What a drive does after its motors were set, in seconds from then on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Motion {
    from: Spot,
    speeds: Speeds,
    targets: Speeds,
    wheel_base: f64,
    lag: f64,
    settles: f64,
    settled: Spot,
}

impl Motion {
    pub(super) fn new(from: Spot, speeds: Speeds, targets: Speeds, chassis: &Chassis) -> Self {
        let mut motion = Self {
            from,
            speeds,
            targets,
            wheel_base: chassis.wheel_base,
            lag: chassis.lag,
            settles: 0.0,
            settled: from,
        };
        motion.settles = motion.within(SETTLED);
        motion.settled = motion.transit(from, 0.0, motion.settles, 1.0);
        motion
    }

    /// When both wheels are within so many mm/s of what they are set to.
    pub(super) fn within(&self, difference: f64) -> f64 {
        let (ahead, turn) = (
            self.speeds.ahead - self.targets.ahead,
            self.speeds.turn - self.targets.turn,
        );
        let most = ahead.abs() + turn.abs() * self.wheel_base / 2.0;
        if most <= difference {
            0.0
        } else {
            self.lag * (most / difference).ln()
        }
    }

    pub(super) fn settles(&self) -> f64 {
        self.settles
    }

    pub(super) fn targets(&self) -> Speeds {
        self.targets
    }

    /// mm/s that it never exceeds.
    pub(super) fn fastest(&self) -> f64 {
        self.speeds.ahead.abs().max(self.targets.ahead.abs())
    }

    pub(super) fn place(&self, seconds: f64) -> Spot {
        if seconds < self.settles {
            self.transit(self.from, 0.0, seconds, 1.0)
        } else {
            steady(self.settled, self.targets, seconds - self.settles)
        }
    }

    pub(super) fn speeds(&self, seconds: f64) -> Speeds {
        if seconds >= self.settles {
            return self.targets;
        }
        let rest = (-seconds / self.lag).exp();
        let mix = |from: f64, to: f64| to + (from - to) * rest;
        Speeds {
            ahead: mix(self.speeds.ahead, self.targets.ahead),
            turn: mix(self.speeds.turn, self.targets.turn),
        }
    }

    /// The place at `until`, from the one at `since`, while the wheels' speeds change. The usual step is multiplied by `part`.
    pub(super) fn transit(&self, place: Spot, since: f64, until: f64, part: f64) -> Spot {
        let span = until - since;
        if span <= 0.0 {
            return place;
        }
        let turn = self.speeds.turn.abs().max(self.targets.turn.abs());
        let step = (self.lag * STEP_OF_LAG).min(STEP_OF_TURN / turn) * part;
        let steps = (span / step).ceil().max(1.0);
        let step = span / steps;
        let (ahead, turn) = (
            self.speeds.ahead - self.targets.ahead,
            self.speeds.turn - self.targets.turn,
        );
        let fade = (-step / self.lag).exp();
        let fades = POINTS.map(|(point, weight)| (point, weight, (-point * step / self.lag).exp()));
        let mut rest = (-since / self.lag).exp();
        let Spot { mut x, mut y, .. } = place;
        for index in 0..steps as u32 {
            let begin = since + f64::from(index) * step;
            for (point, weight, fade) in fades {
                let rest = rest * fade;
                let passed = begin + point * step;
                let heading = self.from.heading + self.targets.turn * passed + turn * self.lag * (1.0 - rest);
                let way = (self.targets.ahead + ahead * rest) * weight * step;
                let (sin, cos) = heading.sin_cos();
                x += way * cos;
                y += way * sin;
            }
            rest *= fade;
        }
        let rest = (-until / self.lag).exp();
        let heading = self.from.heading + self.targets.turn * until + turn * self.lag * (1.0 - rest);
        Spot { x, y, heading }
    }

    /// mm that the rims of both wheels have travelled, forward or back, together.
    pub(super) fn travel(&self, seconds: f64) -> f64 {
        let (from, to) = (
            self.speeds.wheels(self.wheel_base),
            self.targets.wheels(self.wheel_base),
        );
        let [left, right] = [0, 1].map(|side| (from[side], to[side]));
        self.rim(left, seconds) + self.rim(right, seconds)
    }

    /// mm that one rim has travelled.
    fn rim(&self, (from, to): (f64, f64), seconds: f64) -> f64 {
        let way = |seconds: f64| to * seconds + (from - to) * self.lag * (1.0 - (-seconds / self.lag).exp());
        if from * to >= 0.0 {
            return way(seconds).abs();
        }
        // It turns round once.
        let turns = self.lag * ((to - from) / to).ln();
        let first = way(seconds.min(turns));
        first.abs() + (way(seconds.max(turns)) - way(turns)).abs()
    }

    /// Where it is when the wheels have the speeds that they are set to.
    pub(super) fn settled(&self) -> Spot {
        self.settled
    }
}

/// A line or an arc at constant speeds.
fn steady(from: Spot, speeds: Speeds, seconds: f64) -> Spot {
    let half = speeds.turn * seconds / 2.0;
    // The chord of the arc, which has the direction of its middle.
    let chord = if half == 0.0 {
        speeds.ahead * seconds
    } else {
        speeds.ahead * seconds * (half.sin() / half)
    };
    let (sin, cos) = (from.heading + half).sin_cos();
    Spot {
        x: from.x + chord * cos,
        y: from.y + chord * sin,
        heading: from.heading + 2.0 * half,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const START: Spot = Spot {
        x: 100.0,
        y: -50.0,
        heading: 0.7,
    };

    fn motion(before: (i16, i16), after: (i16, i16)) -> Motion {
        let chassis = Chassis::LINUXBOT;
        let speeds = |(left, right)| Speeds::of(Motors::new(left, right), &chassis);
        Motion::new(START, speeds(before), speeds(after), &chassis)
    }

    fn value() -> impl Strategy<Value = (i16, i16)> {
        (-1000..=1000_i16, -1000..=1000_i16)
    }

    fn apart(a: Spot, b: Spot) -> f64 {
        (a.x - b.x).hypot(a.y - b.y)
    }

    #[test]
    fn from_rest_it_comes_one_lag_short_of_what_speed_and_time_make() {
        let motion = motion((0, 0), (500, 500));
        let end = motion.place(10.0);
        assert!((apart(START, end) - 500.0 * (10.0 - 0.1)).abs() < 1e-3);
        assert_eq!(end.heading, START.heading);
        let one_lag = motion.speeds(0.1).ahead;
        assert!((one_lag - 500.0 * (1.0 - (-1.0_f64).exp())).abs() < 1e-9);
    }

    #[test]
    fn wheels_against_each_other_turn_it_on_the_spot() {
        let motion = motion((0, 0), (-100, 100));
        let end = motion.place(2.1);
        assert_eq!((end.x, end.y), (START.x, START.y));
        // 200 mm/s over a base of 150 mm, for 2.1 s less the lag.
        assert!((end.heading - START.heading - 200.0 / 150.0 * 2.0).abs() < 2e-6);
    }

    #[test]
    fn an_arc_closes_to_a_circle() {
        let motion = motion((200, 400), (200, 400));
        let round = std::f64::consts::TAU / (200.0 / 150.0);
        assert!(apart(motion.place(0.0), motion.place(round)) < 1e-9);
        // Half way round it is a diameter away: 300 mm/s at 4/3 rad/s.
        assert!((apart(START, motion.place(round / 2.0)) - 450.0).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn halving_the_step_moves_the_end_by_less_than_a_micrometre(
            before in value(), after in value(), seconds in 0.0..1.5,
        ) {
            let motion = motion(before, after);
            let (whole, half) = (motion.transit(START, 0.0, seconds, 1.0), motion.transit(START, 0.0, seconds, 0.5));
            prop_assert!(apart(whole, half) < 1e-3, "{}", apart(whole, half));
            prop_assert_eq!(whole.heading, half.heading);
        }

        #[test]
        fn it_moves_as_small_steps_of_its_speeds_do(before in value(), after in value(), seconds in 0.1..4.0_f64) {
            let motion = motion(before, after);
            let (mut slow, steps) = (START, 20_000_u32);
            let step = seconds / f64::from(steps);
            for index in 0..steps {
                let Speeds { ahead, turn } = motion.speeds((f64::from(index) + 0.5) * step);
                let heading = slow.heading + turn * step / 2.0;
                slow.x += ahead * step * heading.cos();
                slow.y += ahead * step * heading.sin();
                slow.heading += turn * step;
            }
            let fast = motion.place(seconds);
            prop_assert!(apart(slow, fast) < 0.01, "{slow:?} {fast:?}");
            prop_assert!((slow.heading - fast.heading).abs() < 1e-5, "{slow:?} {fast:?}");
        }

        #[test]
        fn nothing_jumps_when_the_wheels_have_settled(before in value(), after in value()) {
            let motion = motion(before, after);
            let (early, late) = (motion.settles - 1e-9, motion.settles + 1e-9);
            prop_assume!(early > 0.0);
            prop_assert!(apart(motion.place(early), motion.place(late)) < 1e-4);
            prop_assert!((motion.place(early).heading - motion.place(late).heading).abs() < 1e-6);
            prop_assert!(motion.settles < 14.6 * motion.lag, "{}", motion.settles);
        }

        #[test]
        fn wheels_travel_what_their_speeds_make(before in value(), after in value(), seconds in 0.01..2.0_f64) {
            let motion = motion(before, after);
            let steps = 4000_u32;
            let step = seconds / f64::from(steps);
            let slow: f64 = (0..steps)
                .flat_map(|index| motion.speeds((f64::from(index) + 0.5) * step).wheels(motion.wheel_base))
                .map(|speed| speed.abs() * step)
                .sum();
            prop_assert!((slow - motion.travel(seconds)).abs() < 0.01, "{slow} {}", motion.travel(seconds));
        }
    }
}
