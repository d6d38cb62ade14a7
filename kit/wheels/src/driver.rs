//! The seam between a robot's program and its hardware.

use std::fmt;

use crate::WheelTime;

/// The largest value of a motor, in per mille of full speed (W5).
pub const MOTOR_LIMIT: i16 = 1000;

/// The bits of [`Sensors::switches`]; one that is set is a switch that is pressed.
pub mod switch {
    /// The bumper at the front, left half.
    pub const FRONT_LEFT: u8 = 1;
    /// The bumper at the front, right half.
    pub const FRONT_RIGHT: u8 = 1 << 1;
    /// The bumper at the rear, left half.
    pub const REAR_LEFT: u8 = 1 << 2;
    /// The bumper at the rear, right half.
    pub const REAR_RIGHT: u8 = 1 << 3;
    /// Both halves at the front.
    pub const FRONT: u8 = FRONT_LEFT | FRONT_RIGHT;
    /// Both halves at the rear.
    pub const REAR: u8 = REAR_LEFT | REAR_RIGHT;
}

/// The motors, LEDs and sensors of one robot: real, or [`Simulated`](crate::Simulated).
///
/// Each method takes the present time, in µs since any beginning, which never runs backwards: an earlier time than
/// the latest one counts as the latest.
///
/// ```
/// use mom_wheels::{Driver, DriverError, Motors, Simulated};
///
/// fn ahead(driver: &mut dyn Driver) -> Result<f64, DriverError> {
///     driver.set_motors(Motors::new(200, 200), 0)?;
///     let begin = driver.sensors(0)?.pose.map_or(0.0, |pose| pose.x);
///     let end = driver.sensors(1_000_000)?.pose.map_or(0.0, |pose| pose.x);
///     Ok(end - begin)
/// }
///
/// // 200 mm/s for 1 s, less what the wheels' lag of 0.1 s takes.
/// assert!((ahead(&mut Simulated::linuxbot())? - 180.0).abs() < 0.01);
/// # Ok::<(), DriverError>(())
/// ```
pub trait Driver: Send {
    /// Sets both motors; they keep this until they are set again.
    ///
    /// # Errors
    ///
    /// Why the motors may not have taken it. To stop is never refused by a driver that can reach its motors.
    fn set_motors(&mut self, motors: Motors, at: WheelTime) -> Result<(), DriverError>;

    /// Has the motors stop by themselves at `until`, whatever they are set to by then, unless a later `until` is given before.
    /// [`WheelTime::MAX`] is never.
    ///
    /// It is the watchdog of the hardware, for when the program that drives it stands still: stopped, swapped out, dead. So it is
    /// given before motors are set, and again and again while they run. A driver whose hardware has none leaves it as it is:
    /// then nothing but the program stops the motors.
    ///
    /// # Errors
    ///
    /// Why the hardware may not have taken it.
    fn hold(&mut self, _until: WheelTime, _at: WheelTime) -> Result<(), DriverError> {
        Ok(())
    }

    /// Sets all LEDs, a bit each; 1 is lit.
    ///
    /// # Errors
    ///
    /// Why the LEDs may not have taken it.
    fn set_leds(&mut self, leds: u8, at: WheelTime) -> Result<(), DriverError>;

    /// Reads what the robot senses at this time.
    ///
    /// # Errors
    ///
    /// Why it cannot be read.
    fn sensors(&mut self, at: WheelTime) -> Result<Sensors, DriverError>;

    /// Reads what only some robots have. A driver that knows of none leaves it as it is.
    ///
    /// # Errors
    ///
    /// Why it cannot be read.
    fn parts(&mut self, _at: WheelTime) -> Result<Parts, DriverError> {
        Ok(Parts::default())
    }

    /// When something will change without a command, so that reading the sensors again is worth it: later than the
    /// latest time that was given. `None`: not before the next command.
    fn next_wake(&mut self) -> Option<WheelTime>;
}

/// What both motors are set to, each within ±[`MOTOR_LIMIT`] per mille of full speed; positive drives forward.
///
/// ```
/// use mom_wheels::Motors;
///
/// let motors = Motors::new(50, -4000);
/// assert_eq!((motors.left(), motors.right()), (50, -1000));
/// assert_eq!(motors.to_string(), "50 -1000");
/// ```
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct Motors {
    left: i16,
    right: i16,
}

impl Motors {
    /// Both stand.
    pub const STOP: Self = Self { left: 0, right: 0 };

    /// Left and right, in per mille; what is beyond the limit is clamped to it (W5).
    #[must_use]
    pub fn new(left: i16, right: i16) -> Self {
        let clamp = |value: i16| value.clamp(-MOTOR_LIMIT, MOTOR_LIMIT);
        Self {
            left: clamp(left),
            right: clamp(right),
        }
    }

    /// The left one, in per mille.
    #[must_use]
    pub const fn left(self) -> i16 {
        self.left
    }

    /// The right one, in per mille.
    #[must_use]
    pub const fn right(self) -> i16 {
        self.right
    }
}

impl fmt::Display for Motors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.left, self.right)
    }
}

/// Where the middle of the axle is, and where the robot looks.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Pose {
    /// mm.
    pub x: f64,
    /// mm.
    pub y: f64,
    /// Degrees counterclockwise from the x axis, within (−180, 180].
    pub heading: f64,
}

impl Pose {
    /// A pose; the heading is brought into (−180, 180].
    #[must_use]
    pub fn new(x: f64, y: f64, heading: f64) -> Self {
        Self {
            x,
            y,
            heading: half_turn(heading),
        }
    }
}

impl fmt::Display for Pose {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { x, y, heading } = self;
        write!(f, "{x:.0} mm, {y:.0} mm, {heading:.0}°")
    }
}

/// The same angle within (−180, 180].
pub(crate) fn half_turn(degrees: f64) -> f64 {
    let rest = degrees.rem_euclid(360.0);
    if rest > 180.0 { rest - 360.0 } else { rest }
}

/// What a robot senses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensors {
    /// The switches that are pressed, by the bits of [`switch`].
    pub switches: u8,
    /// What is left in the battery, in percent, 0 to 100; 0 only when it is empty.
    pub battery: u8,
    /// What the motors are set to: the latest command, or 0 0 after the battery became empty.
    pub motors: Motors,
    /// Where the robot is by its odometry; `None` if it has none.
    pub pose: Option<Pose>,
}

/// What only some robots sense; `None` where a robot has no such part.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Parts {
    /// Whether its battery is being charged.
    pub charging: Option<bool>,
    /// The brightness that its light sensor sees, in percent.
    pub light: Option<u8>,
}

/// What failed at a driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Fault {
    /// The hardware cannot be reached.
    Link,
    /// A motor or its amplifier does not obey.
    Motors,
    /// The LEDs do not obey.
    Leds,
    /// The sensors cannot be read, or say what cannot be.
    Sensors,
    /// The battery is empty.
    Battery,
}

impl Fault {
    /// Its number. [`Link`](Self::Link) has that of robots in general (M53).
    #[must_use]
    pub const fn code(self) -> u16 {
        match self {
            Self::Link => 5003,
            Self::Motors => 5201,
            Self::Leds => 5202,
            Self::Sensors => 5203,
            Self::Battery => 5204,
        }
    }

    /// Its code word.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Link => "link",
            Self::Motors => "motors",
            Self::Leds => "leds",
            Self::Sensors => "sensors",
            Self::Battery => "battery",
        }
    }
}

/// An error of a driver: plain words, with what failed beside them.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text}")]
pub struct DriverError {
    fault: Fault,
    text: String,
}

impl DriverError {
    /// An error with its plain words, which say what was wrong and where.
    #[must_use]
    pub fn new(fault: Fault, text: impl Into<String>) -> Self {
        Self {
            fault,
            text: text.into(),
        }
    }

    /// What failed.
    #[must_use]
    pub const fn fault(&self) -> Fault {
        self.fault
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_come_into_half_a_turn() {
        for (given, want) in [
            (0.0, 0.0),
            (180.0, 180.0),
            (-180.0, 180.0),
            (190.0, -170.0),
            (-190.0, 170.0),
            (720.0, 0.0),
        ] {
            assert_eq!(Pose::new(0.0, 0.0, given).heading, want, "{given}");
        }
    }

    #[test]
    fn each_fault_has_a_number_and_a_word_of_its_own() {
        let all = [
            Fault::Link,
            Fault::Motors,
            Fault::Leds,
            Fault::Sensors,
            Fault::Battery,
        ];
        for (place, fault) in all.iter().enumerate() {
            for other in all.iter().skip(place + 1) {
                assert_ne!(fault.code(), other.code());
                assert_ne!(fault.word(), other.word());
            }
        }
    }
}
