//! The four walls of a floor, and which switches of a robot they press.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use crate::switch;

/// A direction whose share into a wall is less than this goes along it.
pub(crate) const ALONG: f64 = 1e-9;
/// Radians: a wall within this of straight ahead, or of straight behind, presses both halves of a bumper.
const MIDDLE: f64 = 15.0 / 180.0 * PI;

/// A wall, by the side of the floor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Wall {
    East,
    North,
    West,
    South,
}

impl Wall {
    pub(crate) const ALL: [Self; 4] = [Self::East, Self::North, Self::West, Self::South];

    /// The direction to it, in radians.
    pub(crate) fn bearing(self) -> f64 {
        match self {
            Self::East => 0.0,
            Self::North => FRAC_PI_2,
            Self::West => PI,
            Self::South => -FRAC_PI_2,
        }
    }

    /// The part of a speed ahead that goes into it.
    pub(crate) fn share(self, heading: f64) -> f64 {
        match self {
            Self::East => heading.cos(),
            Self::North => heading.sin(),
            Self::West => -heading.cos(),
            Self::South => -heading.sin(),
        }
    }

    /// Whether a robot that looks there would push it, driving ahead at this speed.
    pub(crate) fn is_pushed(self, heading: f64, ahead: f64) -> bool {
        ahead.signum() * self.share(heading) > ALONG && ahead != 0.0
    }

    /// The switches that it presses on a robot that looks there.
    pub(crate) fn presses(self, heading: f64) -> u8 {
        let side = (self.bearing() - heading).rem_euclid(TAU);
        let front = !(FRAC_PI_2..3.0 * FRAC_PI_2).contains(&side);
        let off = if front {
            (side + PI).rem_euclid(TAU) - PI
        } else {
            PI - side
        };
        match (front, off) {
            (true, off) if off.abs() <= MIDDLE => switch::FRONT,
            (true, off) if off > 0.0 => switch::FRONT_LEFT,
            (true, _) => switch::FRONT_RIGHT,
            (false, off) if off.abs() <= MIDDLE => switch::REAR,
            (false, off) if off > 0.0 => switch::REAR_LEFT,
            (false, _) => switch::REAR_RIGHT,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_presses_the_switches_on_its_side() {
        for (heading, want) in [
            (0.0_f64, switch::FRONT),
            (14.0, switch::FRONT),
            (-14.0, switch::FRONT),
            (40.0, switch::FRONT_RIGHT),
            (-40.0, switch::FRONT_LEFT),
            (180.0, switch::REAR),
            (166.0, switch::REAR),
            (-166.0, switch::REAR),
            (120.0, switch::REAR_RIGHT),
            (-120.0, switch::REAR_LEFT),
        ] {
            assert_eq!(Wall::East.presses(heading.to_radians()), want, "{heading}");
            let turned = (heading + 90.0).to_radians();
            assert_eq!(Wall::North.presses(turned), want, "{heading}");
        }
    }
}
