//! Which parts a simulated robot has, and when it stands at its charger.

use super::{Course, DOCKED, STANDING, Simulated};
use crate::{DriverError, Fault, Floor, Motors, Point, Pose, WheelTime, eye, switch};

/// The sensors and LEDs that a simulated robot has.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fittings {
    /// The switches, by the bits of [`switch`]; others are never pressed.
    pub switches: u8,
    /// The LEDs, a bit each; to light another one is a [`Fault::Leds`].
    pub leds: u8,
    /// mm from the middle of the axle to its light sensor, which looks at the floor ahead of it; `None` if it has none.
    pub light: Option<f64>,
    /// Whether it counts the turns of its wheels, and so knows its pose.
    pub odometry: bool,
}

impl Fittings {
    /// Those of the second paper's robot, with odometry, which the paper's has not.
    pub const LINUXBOT: Self = Self {
        switches: switch::FRONT | switch::REAR,
        leds: 0xff,
        light: None,
        odometry: true,
    };

    pub(super) fn check_leds(&self, leds: u8) -> Result<(), DriverError> {
        if leds & !self.leds == 0 {
            return Ok(());
        }
        let text = match self.leds {
            0 => "the robot has no LEDs".to_owned(),
            own => format!("the robot has the LEDs {own:#010b} alone, and not {leds:#010b}"),
        };
        Err(DriverError::new(Fault::Leds, text))
    }

    /// Percent, of the floor under the light sensor of a robot at this pose.
    pub(super) fn light_at(&self, floor: Floor, pose: Pose) -> Option<u8> {
        let ahead = self.light?;
        let (sin, cos) = pose.heading.to_radians().sin_cos();
        Some(eye::brightness(floor, pose.x + ahead * cos, pose.y + ahead * sin))
    }
}

impl Simulated {
    /// The same with these parts alone.
    #[must_use]
    pub fn with_fittings(mut self, fittings: Fittings) -> Self {
        self.fittings = fittings;
        self
    }

    /// The same with a charger at this place: it is charged while it stands within [`DOCKED`] of it.
    #[must_use]
    pub fn with_charger(mut self, at: Point) -> Self {
        self.charger = Some(at);
        self.ahead = None;
        self
    }

    /// When it begins to be charged: it stands at its charger, and its motors leave it there.
    pub(super) fn docks(&self) -> Option<WheelTime> {
        let charger = self
            .charger
            .filter(|_| !self.charging && self.motors == Motors::STOP)?;
        let (place, stands) = match &self.course {
            Course::Held { place, since, .. } => (*place, *since),
            Course::Free { motion, began } => {
                let seconds = motion.within(STANDING);
                let stands = began.saturating_add((seconds * 1e6).ceil() as WheelTime);
                (motion.place(seconds), stands)
            }
        };
        let away = (place.x - charger.x).hypot(place.y - charger.y);
        (away <= DOCKED).then(|| stands.max(self.now()))
    }
}
