//! What a robot and its floor are like.

/// A differential drive: two wheels on one axle, and a round body about its middle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Chassis {
    /// mm between the wheels.
    pub wheel_base: f64,
    /// mm from the middle of the axle to the rim of the body.
    pub radius: f64,
    /// mm/s of a wheel whose motor is set to 1000 per mille.
    pub full_speed: f64,
    /// Seconds, the time constant of a wheel: so long after a step of its motor it has made 63 % of the change.
    pub lag: f64,
}

/// The battery, what draws from it and what fills it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Power {
    /// J in a full battery.
    pub capacity: f64,
    /// W that the robot draws at rest.
    pub idle: f64,
    /// W of one wheel at full speed; at less in proportion. One that is stalled by a wall draws what it would draw if it turned.
    pub wheel: f64,
    /// W of one LED that is lit.
    pub led: f64,
    /// W that a charger gives, of which the robot draws its own.
    pub charger: f64,
}

impl Chassis {
    /// The robot of the second paper.
    pub const LINUXBOT: Self = Self {
        wheel_base: 150.0,
        radius: 100.0,
        full_speed: 1000.0,
        lag: 0.1,
    };

    /// CUBO, the robot of the third paper (S25): a body of 20 cm × 21.8 cm, wheels of 80 ms (S28); the rest is assumed.
    pub const CUBO: Self = Self {
        wheel_base: 170.0,
        radius: 110.0,
        full_speed: 500.0,
        lag: 0.08,
    };

    /// Degrees/s at which it spins when both motors are set to full speed against each other.
    #[must_use]
    pub fn full_turn(&self) -> f64 {
        (2.0 * self.full_speed / self.wheel_base).to_degrees()
    }

    /// Whether numbers are within what can be computed.
    ///
    /// # Errors
    ///
    /// [`SetupError::Parameter`] for the first that is not.
    pub fn check(&self) -> Result<(), SetupError> {
        within("wheel_base", self.wheel_base, 10.0, 10_000.0)?;
        within("radius", self.radius, 1.0, 10_000.0)?;
        within("full_speed", self.full_speed, 1.0, 50_000.0)?;
        within("lag", self.lag, 0.001, 2.0)?;
        // So that the steps of one transient stay within some thousands.
        within("full_turn", self.full_turn(), 0.0, 6000.0)
    }
}

impl Power {
    /// The robot of the second paper: 9 hours at rest, and 1 hour and a quarter at full speed.
    pub const LINUXBOT: Self = Self {
        capacity: 72_000.0,
        idle: 8.0,
        wheel: 4.0,
        led: 0.1,
        charger: 40.0,
    };

    /// Whether numbers are within what can be computed.
    ///
    /// # Errors
    ///
    /// [`SetupError::Parameter`] for the first that is not.
    pub fn check(&self) -> Result<(), SetupError> {
        within("capacity", self.capacity, 1.0, 1e9)?;
        within("idle", self.idle, 0.0, 1e6)?;
        within("wheel", self.wheel, 0.0, 1e6)?;
        within("led", self.led, 0.0, 1e6)?;
        within("charger", self.charger, 0.0, 1e6)
    }
}

fn within(name: &'static str, value: f64, least: f64, most: f64) -> Result<(), SetupError> {
    // Not a number is neither.
    if (least..=most).contains(&value) {
        Ok(())
    } else {
        Err(SetupError::Parameter {
            name,
            value,
            least,
            most,
        })
    }
}

/// A rectangular floor from x = 0, y = 0, with a wall along each side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Floor {
    /// mm along x.
    pub width: f64,
    /// mm along y.
    pub depth: f64,
}

impl Floor {
    /// 5 m × 5 m, an arena in a laboratory.
    pub const ARENA: Self = Self {
        width: 5000.0,
        depth: 5000.0,
    };

    /// Whether numbers are within what can be computed.
    ///
    /// # Errors
    ///
    /// [`SetupError::Parameter`] for the first that is not.
    pub fn check(&self) -> Result<(), SetupError> {
        within("width", self.width, 1.0, 1e8)?;
        within("depth", self.depth, 1.0, 1e8)
    }
}

/// Why there cannot be such a robot.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SetupError {
    /// A number of the chassis, of the power or of the floor is out of range.
    #[error("{name} is {value}, but may be only from {least} to {most}")]
    Parameter {
        /// The field of [`Chassis`], [`Power`] or [`Floor`], or a method that gives what follows from them.
        name: &'static str,
        /// What was given.
        value: f64,
        /// The least that may be.
        least: f64,
        /// The most that may be.
        most: f64,
    },
    /// The body would not be wholly on the floor.
    #[error("at {x} mm, {y} mm a robot of radius {radius} mm is not wholly on the floor of {width} mm × {depth} mm", width = .floor.width, depth = .floor.depth)]
    OffFloor {
        /// mm, where it was to be.
        x: f64,
        /// mm, where it was to be.
        y: f64,
        /// mm, of its body.
        radius: f64,
        /// The floor that it was to be on.
        floor: Floor,
    },
}

impl SetupError {
    /// Its number.
    #[must_use]
    pub const fn code(&self) -> u16 {
        match self {
            Self::Parameter { .. } => 5211,
            Self::OffFloor { .. } => 5212,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_linuxbot_can_be_computed_and_nonsense_is_named() {
        assert_eq!(Chassis::LINUXBOT.check(), Ok(()));
        assert_eq!(Power::LINUXBOT.check(), Ok(()));
        let chassis = Chassis::LINUXBOT;
        for (chassis, name) in [
            (Chassis { lag: 0.0, ..chassis }, "lag"),
            (
                Chassis {
                    wheel_base: f64::NAN,
                    ..chassis
                },
                "wheel_base",
            ),
            (
                Chassis {
                    full_speed: f64::INFINITY,
                    ..chassis
                },
                "full_speed",
            ),
            (
                Chassis {
                    wheel_base: 10.0,
                    ..chassis
                },
                "full_turn",
            ),
        ] {
            let error = chassis.check().expect_err(name);
            assert!(error.to_string().starts_with(&format!("{name} is ")), "{error}");
            assert_eq!(error.code(), 5211);
        }
    }
}
