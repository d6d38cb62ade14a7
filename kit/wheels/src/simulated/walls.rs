//! When a motion meets a wall, and which walls a robot pushes.
//!
//! The body is a circle about the axle's middle, so the walls keep that middle within a smaller rectangle. While the wheels'
//! speeds change, the way is followed in steps that cannot reach a wall or take 5 ms: a wall that is met and left again within such a
//! step is not noticed if the body goes less than 0.05 mm into it. Afterwards the meeting is known in closed form.

use std::f64::consts::{PI, TAU};

use super::motion::{Motion, Speeds, Spot};
use crate::Floor;
use crate::wall::{ALONG, Wall};

/// mm, what counts as no distance, and as no way into a wall.
const SLACK: f64 = 1e-6;
/// Seconds, the shortest step while the wheels' speeds change.
const FINE: f64 = 0.005;

/// Where the axle's middle may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Limits {
    least: f64,
    most_x: f64,
    most_y: f64,
}

/// A motion meets a wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Contact {
    /// Seconds after the motion's beginning.
    pub(super) after: f64,
    pub(super) wall: Wall,
}

impl Limits {
    pub(super) fn new(floor: Floor, radius: f64) -> Self {
        Self {
            least: radius,
            most_x: floor.width - radius,
            most_y: floor.depth - radius,
        }
    }

    /// The floor that was given.
    pub(super) fn floor(&self) -> Floor {
        Floor {
            width: self.most_x + self.least,
            depth: self.most_y + self.least,
        }
    }

    /// Whether the body is wholly on the floor. Not a number is not.
    pub(super) fn holds(&self, x: f64, y: f64) -> bool {
        (self.least..=self.most_x).contains(&x) && (self.least..=self.most_y).contains(&y)
    }

    /// The same place, not in a wall.
    pub(super) fn keep(&self, place: Spot) -> Spot {
        Spot {
            x: place.x.min(self.most_x).max(self.least),
            y: place.y.min(self.most_y).max(self.least),
            ..place
        }
    }

    /// The same place, at this wall.
    pub(super) fn touch(&self, place: Spot, wall: Wall) -> Spot {
        let place = self.keep(place);
        match wall {
            Wall::East => Spot {
                x: self.most_x,
                ..place
            },
            Wall::North => Spot {
                y: self.most_y,
                ..place
            },
            Wall::West => Spot {
                x: self.least,
                ..place
            },
            Wall::South => Spot {
                y: self.least,
                ..place
            },
        }
    }

    /// mm to this wall.
    fn gap(&self, place: Spot, wall: Wall) -> f64 {
        match wall {
            Wall::East => self.most_x - place.x,
            Wall::North => self.most_y - place.y,
            Wall::West => place.x - self.least,
            Wall::South => place.y - self.least,
        }
    }

    /// Whether it stands at this wall.
    pub(super) fn is_at(&self, place: Spot, wall: Wall) -> bool {
        self.gap(place, wall) <= SLACK
    }

    /// mm to the nearest wall, and which that is.
    pub(super) fn nearest(&self, place: Spot) -> (f64, Wall) {
        let mut nearest = (self.gap(place, Wall::East), Wall::East);
        for wall in Wall::ALL {
            let gap = self.gap(place, wall);
            if gap < nearest.0 {
                nearest = (gap, wall);
            }
        }
        nearest
    }

    /// When the motion first meets a wall, if it ever does.
    pub(super) fn contact(&self, motion: &Motion) -> Option<Contact> {
        if motion.fastest() == 0.0 {
            return None;
        }
        self.early(motion).or_else(|| self.late(motion))
    }

    /// While the wheels' speeds change.
    fn early(&self, motion: &Motion) -> Option<Contact> {
        let (mut place, mut since) = (motion.place(0.0), 0.0);
        while since < motion.settles() {
            let free = self.nearest(place).0 / motion.fastest();
            let until = (since + free.max(FINE)).min(motion.settles());
            let next = motion.transit(place, since, until, 1.0);
            if self.nearest(next).0 < -SLACK {
                return Some(self.narrow(motion, place, since, until));
            }
            (place, since) = (next, until);
        }
        None
    }

    /// It is free at `since`, and in a wall at `until`.
    fn narrow(&self, motion: &Motion, place: Spot, since: f64, until: f64) -> Contact {
        let (mut free, mut inside) = (since, until);
        while inside - free > 1e-8 {
            let middle = f64::midpoint(free, inside);
            let there = motion.transit(place, since, middle, 1.0);
            if self.nearest(there).0 < -SLACK {
                inside = middle;
            } else {
                free = middle;
            }
        }
        let (_, wall) = self.nearest(motion.transit(place, since, inside, 1.0));
        Contact { after: free, wall }
    }

    /// When the wheels have the speeds that they are set to.
    fn late(&self, motion: &Motion) -> Option<Contact> {
        let (from, speeds) = (motion.settled(), motion.targets());
        let contacts = Wall::ALL.into_iter().filter_map(|wall| {
            let gap = self.gap(from, wall).max(0.0);
            let seconds = meets(
                from.heading - wall.bearing(),
                wall.share(from.heading),
                gap,
                speeds,
            )?;
            let after = motion.settles() + seconds;
            Some(Contact { after, wall })
        });
        contacts.min_by(|a, b| a.after.total_cmp(&b.after))
    }
}

/// Seconds until a line or an arc meets a wall that is `gap` away, in a direction that the heading is off by `off`.
fn meets(off: f64, share: f64, gap: f64, Speeds { ahead, turn }: Speeds) -> Option<f64> {
    if ahead == 0.0 {
        return None;
    }
    if turn == 0.0 {
        return (share * ahead.signum() > ALONG).then(|| gap / (share * ahead));
    }
    // Towards the wall it is at `radius * sin(off)` from the circle's middle.
    let radius = ahead / turn;
    let sine = off.sin() + gap / radius;
    if sine.abs() >= 1.0 {
        return None;
    }
    // Of the two places on the circle, the one where it goes into the wall.
    let there = if ahead > 0.0 {
        sine.asin()
    } else {
        PI - sine.asin()
    };
    let way = ((there - off) * turn.signum()).rem_euclid(TAU);
    // What it meets in a whole round but a trifle, it touches already.
    let way = if way > TAU - 1e-6 { 0.0 } else { way };
    Some(way / turn.abs())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{Chassis, Motors};

    const FLOOR: Floor = Floor {
        width: 1200.0,
        depth: 900.0,
    };

    proptest! {
        /// Whatever it does in an arena that is small, it is never in a wall before it meets one, and is at it then.
        #[test]
        fn the_meeting_is_where_the_way_leaves_the_floor(
            x in 100.0..1100.0, y in 100.0..800.0, heading in -7.0..7.0,
            before in (-1000..=1000_i16, -1000..=1000_i16), after in (-1000..=1000_i16, -1000..=1000_i16),
        ) {
            let chassis = Chassis::LINUXBOT;
            let limits = Limits::new(FLOOR, chassis.radius);
            let speeds = |(left, right)| Speeds::of(Motors::new(left, right), &chassis);
            let motion = Motion::new(Spot { x, y, heading }, speeds(before), speeds(after), &chassis);
            let contact = limits.contact(&motion);
            let until = contact.map_or(20.0, |contact| contact.after.min(20.0));
            for step in 0..2000 {
                let place = motion.place(until * f64::from(step) / 2000.0);
                prop_assert!(limits.nearest(place).0 > -0.05, "{step}: {place:?}");
            }
            if let Some(Contact { after, wall }) = contact {
                let place = motion.place(after);
                prop_assert!(limits.gap(place, wall).abs() < 1e-3, "{place:?}");
                let ahead = motion.speeds(after + 1e-6).ahead;
                prop_assert!(wall.is_pushed(motion.place(after + 1e-6).heading, ahead));
            }
        }
    }
}
