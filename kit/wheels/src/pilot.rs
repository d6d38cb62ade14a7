//! Trajectories: to C by A and B (W17), on any driver that knows its pose.
//!
//! A pilot turns on the spot until the robot looks at the next point, and goes there straight, slower the nearer it is. It is a
//! pure function of what the robot senses, the points that are left, and the time.
//!
//! A LinuxBot on an empty floor needs no more than 5 s for each point beside its way at 600 mm/s: for half a turn, for
//! gathering speed, and for slowing down.

use crate::driver::half_turn;
use crate::{Chassis, Driver, DriverError, Motors, Pose, Sensors, Watchdog, WheelTime};

/// µs between two settings of the motors: 20 Hz.
pub const PERIOD: WheelTime = 50_000;
/// µs after which motors that it has set stop by themselves, unless it sets them again: its program stands still.
pub const HOLD: WheelTime = Watchdog::LIMIT;
/// mm: a point is reached when the axle's middle is as near as this.
pub const TOLERANCE: f64 = 10.0;
/// Degrees: it goes when its heading is not further off than this.
pub const AIMED: f64 = 1.0;
/// Degrees: it turns on the spot again when its heading is further off than this.
pub const ASTRAY: f64 = 20.0;
/// The part of full speed at which it goes, at most.
pub const SPEED: f64 = 0.6;
/// The part of full speed at which each wheel turns it, at most.
pub const TURN_SPEED: f64 = 0.25;

/// A point on the floor, in mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// mm.
    pub x: f64,
    /// mm.
    pub y: f64,
}

impl Point {
    /// A point.
    #[must_use]
    pub const fn new(x: f64, y: f64) -> Self {
        Self { x, y }
    }
}

/// Drives along points. It needs about 30 mm between a robot's body and walls: beside one, it may brush it and give up.
///
/// ```
/// use mom_wheels::{Driver, Pilot, PilotEnd, Point, Simulated};
///
/// let mut robot = Simulated::linuxbot();
/// let by = [Point::new(3000.0, 2500.0), Point::new(3000.0, 3000.0), Point::new(2500.0, 3000.0)];
/// let mut pilot = Pilot::new(robot.chassis(), by, 0);
/// while let Some(due) = pilot.next_wake() {
///     pilot.drive(&mut robot, due)?;
/// }
/// assert_eq!(pilot.end(), Some(PilotEnd::Arrived));
/// # Ok::<(), mom_wheels::DriverError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Pilot {
    chassis: Chassis,
    points: Vec<Point>,
    /// How many of them are reached.
    reached: usize,
    /// Whether it goes, rather than turns.
    going: bool,
    due: WheelTime,
    end: Option<PilotEnd>,
}

/// How a trajectory ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PilotEnd {
    /// It reached all points, the last one within [`TOLERANCE`]; the robot stops there.
    Arrived,
    /// It did not, and will not; the robot stops where it is.
    GaveUp(GiveUp),
}

/// Why a trajectory was given up. `point` is the one that it was on the way to, 1 for the first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum GiveUp {
    /// A switch was pressed.
    #[error("on the way to point {point} switches {switches:#06b} were pressed")]
    Pressed {
        /// The point.
        point: usize,
        /// The switches, by the bits of [`switch`](crate::switch).
        switches: u8,
    },
    /// The robot does not know where it is.
    #[error("on the way to point {point} the robot does not know its pose")]
    NoPose {
        /// The point.
        point: usize,
    },
    /// The battery is empty.
    #[error("on the way to point {point} the battery became empty")]
    Battery {
        /// The point.
        point: usize,
    },
    /// A coordinate of the point is not a number.
    #[error("point {point} is nowhere: its coordinates are not finite")]
    Nowhere {
        /// The point.
        point: usize,
    },
}

impl GiveUp {
    /// Its number.
    #[must_use]
    pub const fn code(&self) -> u16 {
        match self {
            Self::Pressed { .. } => 5221,
            Self::NoPose { .. } => 5222,
            Self::Battery { .. } => 5223,
            Self::Nowhere { .. } => 5224,
        }
    }
}

impl Pilot {
    /// One that begins at a time, to drive a robot of such a chassis by points. Without points it arrives where it is.
    #[must_use]
    pub fn new(chassis: Chassis, points: impl Into<Vec<Point>>, begins: WheelTime) -> Self {
        Self {
            chassis,
            points: points.into(),
            reached: 0,
            going: false,
            due: begins,
            end: None,
        }
    }

    /// How it ended; `None` while it is on its way.
    #[must_use]
    pub const fn end(&self) -> Option<PilotEnd> {
        self.end
    }

    /// How many points it has reached.
    #[must_use]
    pub const fn reached(&self) -> usize {
        self.reached
    }

    /// When it is to be asked next; `None` after its end.
    #[must_use]
    pub fn next_wake(&self) -> Option<WheelTime> {
        self.end.is_none().then_some(self.due)
    }

    /// What the motors are to be set to now; `None` if they are to be left as they are: before it is due, and after its end. The
    /// end comes with a stop, also before it is due when a switch is pressed or the battery is empty.
    pub fn steer(&mut self, sensors: &Sensors, at: WheelTime) -> Option<Motors> {
        if self.end.is_some() {
            return None;
        }
        let point = self.reached.saturating_add(1);
        if sensors.switches != 0 {
            let switches = sensors.switches;
            return Some(self.give_up(GiveUp::Pressed { point, switches }));
        }
        if sensors.battery == 0 {
            return Some(self.give_up(GiveUp::Battery { point }));
        }
        if at < self.due {
            return None;
        }
        // Asked late, it keeps its distance from now on.
        self.due = at.saturating_add(PERIOD);
        let Some(pose) = sensors.pose.filter(is_known) else {
            return Some(self.give_up(GiveUp::NoPose { point }));
        };
        while let Some(target) = self.points.get(self.reached).copied() {
            let point = self.reached.saturating_add(1);
            if !(target.x.is_finite() && target.y.is_finite()) {
                return Some(self.give_up(GiveUp::Nowhere { point }));
            }
            let away = (target.x - pose.x).hypot(target.y - pose.y);
            if away > TOLERANCE {
                return Some(self.towards(pose, target, away));
            }
            self.reached = point;
            self.going = false;
        }
        self.end = Some(PilotEnd::Arrived);
        Some(Motors::STOP)
    }

    /// Reads a driver's sensors and sets its motors, if that is due, so that they stop by themselves [`HOLD`] later. When the sensors
    /// cannot be read, it tries to stop the motors.
    ///
    /// # Errors
    ///
    /// What the driver says. The pilot has not ended then, and may be asked again.
    pub fn drive(&mut self, driver: &mut dyn Driver, at: WheelTime) -> Result<(), DriverError> {
        if self.end.is_some() {
            return Ok(());
        }
        let sensors = match driver.sensors(at) {
            Ok(sensors) => sensors,
            Err(error) => {
                // Whether this can be done or not, the first error is the one to tell.
                let _stopped = driver.set_motors(Motors::STOP, at);
                // Who looks again at once would do nothing else.
                self.due = at.saturating_add(PERIOD);
                return Err(error);
            }
        };
        match self.steer(&sensors, at) {
            Some(motors) => {
                let held = driver.hold(at.saturating_add(HOLD), at);
                driver.set_motors(motors, at).and(held)
            }
            None => Ok(()),
        }
    }

    fn give_up(&mut self, why: GiveUp) -> Motors {
        self.end = Some(PilotEnd::GaveUp(why));
        Motors::STOP
    }

    fn towards(&mut self, pose: Pose, target: Point, away: f64) -> Motors {
        let bearing = (target.y - pose.y).atan2(target.x - pose.x).to_degrees();
        let off = half_turn(bearing - pose.heading);
        self.going = off.abs() <= if self.going { ASTRAY } else { AIMED };
        // 1/s. So a wheel that lags, set at each period, comes as near as it can without going too far.
        let gain = 0.25 / (self.chassis.lag + PERIOD as f64 / 2e6);
        let turn = (gain * off / self.chassis.full_turn()).clamp(-TURN_SPEED, TURN_SPEED);
        if !self.going {
            return motors(0.0, at_least_one(turn));
        }
        let ahead = (gain * away / self.chassis.full_speed).min(SPEED) * off.to_radians().cos();
        motors(at_least_one(ahead), turn)
    }
}

fn is_known(pose: &Pose) -> bool {
    pose.x.is_finite() && pose.y.is_finite() && pose.heading.is_finite()
}

/// Not so little that it would be rounded to nothing.
fn at_least_one(part: f64) -> f64 {
    part.abs().max(0.001).copysign(part)
}

/// Parts of full speed, for going ahead and for turning counterclockwise.
fn motors(ahead: f64, turn: f64) -> Motors {
    let per_mille = |part: f64| (part * 1000.0).round() as i16;
    Motors::new(per_mille(ahead - turn), per_mille(ahead + turn))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{Fault, Floor, Power, Simulated, switch};

    fn sensors(pose: Option<Pose>) -> Sensors {
        Sensors {
            switches: 0,
            battery: 50,
            motors: Motors::STOP,
            pose,
        }
    }

    fn pilot(points: &[Point]) -> Pilot {
        Pilot::new(Chassis::LINUXBOT, points, 0)
    }

    fn fly(pilot: &mut Pilot, robot: &mut Simulated) -> WheelTime {
        let mut last = 0;
        while let Some(due) = pilot.next_wake() {
            pilot.drive(robot, due).expect("a simulated driver");
            assert!(due < 600_000_000, "it arrives some time: {:?}", robot.pose(due));
            last = due;
        }
        last
    }

    const AHEAD: Point = Point::new(1000.0, 0.0);

    #[test]
    fn it_turns_on_the_spot_and_then_goes() {
        let mut pilot = pilot(&[AHEAD]);
        let looks = |heading| sensors(Some(Pose::new(0.0, 0.0, heading)));
        for (at, heading, going) in [(0, 90.0, false), (50_000, 1.5, false), (100_000, 0.5, true)] {
            let motors = pilot.steer(&looks(heading), at).expect("it is due");
            assert!(motors.left() > motors.right() || heading < 1.0, "{motors}");
            assert_eq!(motors.left() + motors.right() > 0, going, "{motors}");
        }
        // Going, it corrects what is little and turns for what is much.
        let little = pilot.steer(&looks(19.0), 150_000).expect("it is due");
        assert!(little.left() > little.right() && little.right() > 0, "{little}");
        let much = pilot.steer(&looks(21.0), 200_000).expect("it is due");
        assert_eq!(much.left(), -much.right());
    }

    #[test]
    fn it_is_asked_at_20_hz_and_says_nothing_before() {
        let mut pilot = pilot(&[AHEAD]);
        let here = sensors(Some(Pose::default()));
        assert_eq!(pilot.next_wake(), Some(0));
        assert!(pilot.steer(&here, 0).is_some());
        assert_eq!(pilot.next_wake(), Some(PERIOD));
        assert_eq!(pilot.steer(&here, PERIOD - 1), None);
        assert!(pilot.steer(&here, PERIOD).is_some());
    }

    #[test]
    fn it_gives_up_with_a_stop_and_the_reason() {
        let (here, point) = (sensors(Some(Pose::default())), 1);
        let switches = switch::FRONT;
        for (sensors, why) in [
            (sensors(None), GiveUp::NoPose { point }),
            (
                sensors(Some(Pose {
                    x: f64::NAN,
                    ..Pose::default()
                })),
                GiveUp::NoPose { point },
            ),
            (Sensors { switches, ..here }, GiveUp::Pressed { point, switches }),
            (Sensors { battery: 0, ..here }, GiveUp::Battery { point }),
        ] {
            let mut pilot = pilot(&[AHEAD]);
            assert_eq!(pilot.steer(&sensors, 0), Some(Motors::STOP));
            assert_eq!(pilot.end(), Some(PilotEnd::GaveUp(why)));
            assert_eq!((pilot.next_wake(), pilot.steer(&here, PERIOD)), (None, None));
        }
    }

    #[test]
    fn a_switch_ends_it_before_it_is_due() {
        let mut pilot = pilot(&[AHEAD]);
        let here = sensors(Some(Pose::default()));
        pilot.steer(&here, 0).expect("it is due");
        let pressed = Sensors {
            switches: switch::REAR_LEFT,
            ..here
        };
        assert_eq!(pilot.steer(&pressed, 1), Some(Motors::STOP));
    }

    #[test]
    fn points_where_it_is_and_none_at_all_are_reached_at_once() {
        let here = sensors(Some(Pose::default()));
        for points in [&[][..], &[Point::new(0.0, 10.0)], &[Point::new(3.0, 0.0); 5]] {
            let mut pilot = pilot(points);
            assert_eq!(pilot.steer(&here, 0), Some(Motors::STOP));
            assert_eq!(
                (pilot.end(), pilot.reached()),
                (Some(PilotEnd::Arrived), points.len())
            );
        }
    }

    #[test]
    fn a_point_that_is_nowhere_is_named() {
        let mut pilot = pilot(&[Point::new(0.0, 0.0), Point::new(f64::INFINITY, 0.0)]);
        pilot.steer(&sensors(Some(Pose::default())), 0);
        assert_eq!(pilot.end(), Some(PilotEnd::GaveUp(GiveUp::Nowhere { point: 2 })));
    }

    #[test]
    fn a_wall_on_the_way_ends_it() {
        let mut robot = Simulated::linuxbot();
        let mut pilot = Pilot::new(robot.chassis(), [Point::new(9000.0, 2500.0)], 0);
        let end = fly(&mut pilot, &mut robot);
        let want = GiveUp::Pressed {
            point: 1,
            switches: switch::FRONT,
        };
        assert_eq!(pilot.end(), Some(PilotEnd::GaveUp(want)));
        assert_eq!(robot.sensors(end).map(|sensors| sensors.motors), Ok(Motors::STOP));
    }

    /// One whose sensors are broken while its motors run.
    struct Blind {
        motors: Motors,
    }

    impl Driver for Blind {
        fn set_motors(&mut self, motors: Motors, _: WheelTime) -> Result<(), DriverError> {
            self.motors = motors;
            Ok(())
        }
        fn set_leds(&mut self, _: u8, _: WheelTime) -> Result<(), DriverError> {
            Ok(())
        }
        fn sensors(&mut self, _: WheelTime) -> Result<Sensors, DriverError> {
            Err(DriverError::new(Fault::Sensors, "the encoder is silent"))
        }
        fn next_wake(&mut self) -> Option<WheelTime> {
            None
        }
    }

    #[test]
    fn a_driver_that_cannot_sense_is_stopped() {
        let mut blind = Blind {
            motors: Motors::new(300, 300),
        };
        let mut pilot = pilot(&[AHEAD]);
        let error = pilot.drive(&mut blind, 7000).expect_err("it is blind");
        assert_eq!((error.fault(), blind.motors), (Fault::Sensors, Motors::STOP));
        assert_eq!(pilot.next_wake(), Some(7000 + PERIOD), "it is asked again later");
    }

    /// mm that a start or a point keeps from where a wall would be touched.
    const FREE: f64 = 30.0;

    fn place() -> impl Strategy<Value = (f64, f64)> {
        let side = 100.0 + FREE..=4900.0 - FREE;
        (side.clone(), side)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]

        /// From anywhere to anywhere in the arena: within the tolerance also when the robot has run out, and in the time for the
        /// way at its speed, half a turn, and slowing down.
        #[test]
        fn it_arrives_from_any_start_in_time(
            start in place(), heading in -180.0..180.0, points in proptest::collection::vec(place(), 1..4),
        ) {
            let pose = Pose::new(start.0, start.1, heading);
            let mut robot = Simulated::new(Chassis::LINUXBOT, Power::LINUXBOT, Floor::ARENA, pose).expect("a robot");
            let points: Vec<Point> = points.into_iter().map(|(x, y)| Point::new(x, y)).collect();
            let mut pilot = Pilot::new(robot.chassis(), points.clone(), 0);
            let took = fly(&mut pilot, &mut robot) as f64 / 1e6;
            prop_assert_eq!(pilot.end(), Some(PilotEnd::Arrived));
            let (mut bound, mut from) = (0.0, Point::new(pose.x, pose.y));
            for to in &points {
                bound += (to.x - from.x).hypot(to.y - from.y) / 600.0 + 5.0;
                from = *to;
            }
            prop_assert!(took < bound, "{took} s > {bound} s");
            let end = robot.pose((took * 1e6) as WheelTime + 2_000_000);
            prop_assert!((end.x - from.x).hypot(end.y - from.y) <= TOLERANCE, "{end}");
        }
    }
}
