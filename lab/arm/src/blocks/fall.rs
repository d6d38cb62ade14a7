//! Blocks under gravity: falling, toppling over an edge, and coming to lie flat.

use crate::pose::Xyz;
use crate::upright_box::Xy;

use super::support::Stand;
use super::{Block, Blocks};

/// mm/s².
const GRAVITY: f64 = 9810.0;
/// Degrees/s² with which a block that landed on an edge comes to lie flat.
const SETTLING: f64 = 2000.0;
/// Radians/s with which one begins to topple: at the very edge its weight has no lever yet.
const NUDGE: f64 = 0.5;

/// How a block moves by itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Motion {
    Rests,
    /// mm/s downward.
    Falls(f64),
    Topples(Topple),
    /// Degrees/s, on an edge.
    Settles(f64),
}

/// Over an edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Topple {
    /// The point of the edge below the block's middle, as that goes over it.
    pivot: Xyz,
    direction: Xy,
    /// mm by which the middle was beyond the edge at the beginning.
    lever: f64,
    /// Radians.
    angle: f64,
    /// Radians/s.
    speed: f64,
}

impl Blocks {
    /// Whether all blocks that nothing carries lie where they are and will stay there.
    #[must_use]
    pub fn at_rest(&self) -> bool {
        let rests = |index: usize| {
            self.motions[index] == Motion::Rests
                && self.all[index].tilt == 0.0
                && self.stand(index) == Stand::Firm
        };
        (0..self.all.len()).all(|index| self.is_carried(index) || rests(index))
    }

    /// Lets so many seconds pass for the blocks that nothing carries, the lowest first.
    pub(crate) fn fall(&mut self, seconds: f64) {
        let mut order: Vec<usize> = (0..self.all.len())
            .filter(|index| !self.is_carried(*index))
            .collect();
        order.sort_by(|a, b| self.all[*a].z.total_cmp(&self.all[*b].z));
        for index in order {
            self.motions[index] = match self.motions[index] {
                Motion::Rests => self.begin_motion(index),
                Motion::Falls(speed) => self.fall_on(index, speed + GRAVITY * seconds, seconds),
                Motion::Topples(topple) => self.topple(index, topple, seconds),
                Motion::Settles(speed) => self.settle(index, speed + SETTLING * seconds, seconds),
            };
        }
    }

    fn begin_motion(&mut self, index: usize) -> Motion {
        match self.stand(index) {
            Stand::Floats => Motion::Falls(0.0),
            _ if self.all[index].tilt != 0.0 => Motion::Settles(0.0),
            Stand::Firm => {
                // The hand may have left it a little above or in what it lies on.
                let below = self.surface_below(index);
                let block = &mut self.all[index];
                block.z = below + block.size / 2.0;
                Motion::Rests
            }
            Stand::Tips { direction, edge } => {
                // Where it is what lies on it that goes over, that goes first.
                let load = self.load_on(index);
                let outermost = load.into_iter().max_by(|a, b| {
                    let out =
                        |index: &usize| self.all[*index].x * direction[0] + self.all[*index].y * direction[1];
                    out(a).total_cmp(&out(b))
                });
                match outermost.filter(|_| edge > 0.0) {
                    Some(rider) => {
                        let motion = self.begin_topple(rider, direction, 0.0);
                        self.motions[rider] = motion;
                        Motion::Rests
                    }
                    None => self.begin_topple(index, direction, edge),
                }
            }
        }
    }

    /// The block turns so that its second level axis is the way it goes; as a cube it looks the same.
    fn begin_topple(&mut self, index: usize, direction: Xy, edge: f64) -> Motion {
        let block = &mut self.all[index];
        let way = direction[1].atan2(direction[0]).to_degrees() - 90.0;
        block.yaw = way + (block.yaw - way) - ((block.yaw - way) / 90.0).round() * 90.0;
        let half = block.size / 2.0;
        Motion::Topples(Topple {
            pivot: [
                block.x + edge * direction[0],
                block.y + edge * direction[1],
                block.z - half,
            ],
            direction,
            lever: -edge,
            angle: 0.0,
            speed: NUDGE,
        })
    }

    fn topple(&mut self, index: usize, mut topple: Topple, seconds: f64) -> Motion {
        let half = self.all[index].size / 2.0;
        topple.speed += topple.acceleration(half) * seconds;
        topple.angle = (topple.angle + topple.speed * seconds).min(std::f64::consts::FRAC_PI_2);
        topple.put(&mut self.all[index], half);
        if topple.angle < std::f64::consts::FRAC_PI_2 {
            return Motion::Topples(topple);
        }
        self.all[index].tilt = 0.0;
        self.make_room(index);
        Motion::Falls(topple.speed * half)
    }

    fn fall_on(&mut self, index: usize, speed: f64, seconds: f64) -> Motion {
        let below = self.surface_below(index);
        let block = &mut self.all[index];
        let room = block.solid().bottom() - below;
        if speed * seconds < room {
            block.z -= speed * seconds;
            return Motion::Falls(speed);
        }
        block.z -= room;
        match block.tilt == 0.0 {
            true => Motion::Rests,
            false => Motion::Settles(0.0),
        }
    }

    fn settle(&mut self, index: usize, speed: f64, seconds: f64) -> Motion {
        let block = &mut self.all[index];
        let below = block.solid().bottom();
        let flat = (block.tilt / 90.0).round() * 90.0;
        let rest = block.tilt - flat;
        let step = (speed * seconds).min(rest.abs());
        block.tilt -= step.copysign(rest);
        let done = step >= rest.abs();
        if done {
            block.tilt = 0.0;
        }
        block.z = below + block.solid().half[2];
        match done {
            true => {
                self.make_room(index);
                // The jaws may have left an edge of it a little in what it lies on.
                let below = self.surface_below(index);
                let block = &mut self.all[index];
                block.z = block.z.max(below + block.size / 2.0);
                Motion::Rests
            }
            false => Motion::Settles(speed),
        }
    }
}

impl Topple {
    /// Radians/s² of a cube of this half an edge about the edge under it; never back.
    fn acceleration(&self, half: f64) -> f64 {
        let (sin, cos) = self.angle.sin_cos();
        let lever = (self.lever * cos + half * sin).max(0.0);
        let inertia = 2.0 / 3.0 * half * half + self.lever * self.lever + half * half;
        GRAVITY * lever / inertia
    }

    fn put(&self, block: &mut Block, half: f64) {
        let (sin, cos) = self.angle.sin_cos();
        let out = self.lever * cos + half * sin;
        block.x = self.pivot[0] + out * self.direction[0];
        block.y = self.pivot[1] + out * self.direction[1];
        block.z = self.pivot[2] + half * cos - self.lever * sin;
        block.tilt = -self.angle.to_degrees();
    }
}
