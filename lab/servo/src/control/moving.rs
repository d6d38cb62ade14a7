//! Motions: towards what the images show, or so far and no further.

use nalgebra::Vector3;

use super::Servo;
use super::phases::{Phase, Step};
use crate::Micros;
use crate::aim::{Miss, Sightline, miss};
use crate::motion::{MOST_MS, Travel, linear};
use crate::plan::Plan;

/// mm/s while little is known, and at most.
const SPEEDS: [f64; 2] = [40.0, 140.0];
/// mm/s down to the table, which stops the block if nothing else does.
const GENTLE: f64 = 60.0;
/// mm by which the hand may be elsewhere because the delay is not known.
const UNSURE: f64 = 12.0;
/// mm that the hand goes while no newer picture comes.
const UNSEEN: f64 = 100.0;
/// Beyond this, pixels, what is seen is not what is expected.
const STRANGE: f64 = 3.0;
/// Beyond this, pixels, nothing is as it is expected.
const LOST: f64 = 8.0;
/// A command is corrected by another one from here on, mm, and no sooner after it than this, µs.
const CORRECTED: f64 = 5.0;
const AGAIN: Micros = 400_000;
/// No two commands are nearer than this, µs.
const SPACING: Micros = 150_000;
/// The next command comes so long before the hand rests, µs.
const AHEAD: Micros = 300_000;
/// Expected of the hand before it was seen near, mm.
const EXPECTED: f64 = 30.0;
/// The hand keeps so far from where it may not go, mm.
const MARGIN: f64 = 2.0;
/// Degrees by which a spin may be wrong.
const SPIN: f64 = 0.3;

/// What the tip is to be above.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Above {
    /// The first block.
    First,
    /// The place beside the second.
    Goal,
}

/// Where the hand is to be.
#[derive(Debug, Clone, Copy)]
pub(super) struct Aim {
    pub(super) above: Above,
    /// Of the tip above the table, mm; none: as it is.
    pub(super) height: Option<f64>,
    pub(super) spin: f64,
    /// mm on the level, and in height.
    pub(super) near: [f64; 2],
}

/// Whether the hand is there.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Reach {
    Going(Step),
    /// And images of the resting hand have shown it.
    There(Miss),
}

impl Servo {
    /// When the last motion was over by the images' clock, with what is not known of the delay.
    pub(super) fn settled(&self) -> Micros {
        let (end, _) = self.motion.end();
        end + self.track.delay_micros() + 2 * self.track.delay_error_micros() + 60_000
    }

    pub(super) fn rests(&self) -> bool {
        self.now >= self.motion.end().0
    }

    /// How fast the hand may go by what is known, and no further than [`UNSEEN`] while pictures are as old as they are.
    fn fastest(&self) -> f64 {
        if self.sight.careful().is_some() {
            return SPEEDS[0];
        }
        let age = self.sight.pictures_age(self.now).unwrap_or(0) as f64 / 1e6;
        let unknown = self.track.delay_error_micros() as f64 / 1e6;
        let fastest = (UNSURE / unknown.max(1e-3)).min(UNSEEN / age.max(1e-3));
        let fastest = fastest.clamp(SPEEDS[0], SPEEDS[1]);
        if self.phase == Phase::Lower {
            return fastest.min(GENTLE);
        }
        match self.track.rms() > STRANGE {
            true => SPEEDS[0],
            false => fastest,
        }
    }

    /// How far the tip is from its aim when the hand has travelled so far, by the cameras that have seen both, since then.
    pub(super) fn miss_at(
        &self,
        aim: &Aim,
        plan: &Plan,
        travel: &Travel,
        since: Option<Micros>,
    ) -> Option<(Miss, usize)> {
        let reach = self.track.reach(travel);
        let mut lines = Vec::new();
        let mut mean = Vector3::zeros();
        for camera in 0..self.track.cameras() {
            if !self.track.has_seen(camera, since, &self.motion) {
                continue;
            }
            let (Some(tip), Some(pixel), Some(projection)) = (
                self.tip_goal(aim, plan, camera, travel),
                self.track.predict(camera, travel, &self.motion),
                self.track.projection(camera),
            ) else {
                continue;
            };
            mean += tip;
            lines.push(Sightline {
                projection: *projection,
                pixel,
                target: (tip + reach).into(),
            });
        }
        let expected = Vector3::from(self.track.tip(travel)) - mean / lines.len().max(1) as f64;
        let mut found = miss(&lines, expected.into(), [EXPECTED; 3])?;
        if aim.height.is_none() {
            found.off[2] = 0.0;
        }
        Some((found, lines.len()))
    }

    /// Where the tip is to be, as a camera has it.
    fn tip_goal(&self, aim: &Aim, plan: &Plan, camera: usize, travel: &Travel) -> Option<Vector3<f64>> {
        let height = aim.height.unwrap_or_else(|| self.track.tip(travel)[2]);
        let [x, y] = match aim.above {
            Above::First => self.memory.local(self.task.first, camera)?.place,
            Above::Goal => {
                let [x, y] = plan.goal(self.memory.local(self.task.second, camera)?.place, self.task.gap);
                let (sin, cos) = aim.spin.to_radians().sin_cos();
                // The block lies beside the fingertips, across the jaw line.
                [
                    x + sin * self.across - self.bias[0],
                    y - cos * self.across - self.bias[1],
                ]
            }
        };
        Some(Vector3::new(x, y, height))
    }

    /// Goes there, as the images lead.
    pub(super) fn reach(&mut self, aim: &Aim, plan: &Plan) -> Reach {
        let (end, travel) = self.motion.end();
        let turn = [aim.spin - self.track.spin(&travel), -self.track.tilt(&travel)];
        let turned = turn.iter().all(|part| part.abs() < SPIN);
        if self.rests() && turned {
            let since = self.settled();
            if let Some((seen, images)) = self.miss_at(aim, plan, &travel, Some(since)) {
                // One camera alone is believed if the others stay silent.
                let alone = self.now - since > 2_000_000 + (self.now - self.newest.unwrap_or(self.now));
                if images >= 2 || alone {
                    self.miss = Some(seen);
                    if self.track.rms() > LOST {
                        // The hand is not where the commands led: it is found anew.
                        self.track.forget();
                        return Reach::Going(Step::Wait);
                    }
                    if seen.level() < aim.near[0] && seen.off[2].abs() < aim.near[1] {
                        return Reach::There(seen);
                    }
                    return Reach::Going(self.correct(seen, turn));
                }
            }
        }
        if self.sight.careful().is_some() {
            // Nothing is predicted: pictures of the resting hand lead.
            return Reach::Going(Step::Wait);
        }
        let Some((seen, _)) = self.miss_at(aim, plan, &travel, None) else {
            return Reach::Going(Step::Wait);
        };
        self.miss = Some(seen);
        let far = seen.level() > aim.near[0] || seen.off[2].abs() > aim.near[1] || !turned;
        let (sent, capped) = self.sent.unwrap_or((Micros::MIN / 2, false));
        let left = end - self.now;
        let wanted = match left > AHEAD {
            // As long as it is on its way, only what is clearly wrong is corrected.
            true => !capped && self.now - sent > AGAIN && seen.distance() > CORRECTED,
            false => left <= 0 || (self.now - sent > AGAIN && (capped || seen.distance() > CORRECTED)),
        };
        match far && wanted {
            true => Reach::Going(self.correct(seen, turn)),
            false => Reach::Going(Step::Wait),
        }
    }

    /// The command that takes the hand from where it is by now to where the miss is none.
    fn correct(&mut self, seen: Miss, turn: [f64; 2]) -> Step {
        let (_, end) = self.motion.end();
        let here = self.motion.at(self.now);
        let mut goal: Travel = end;
        for (i, off) in seen.off.into_iter().enumerate() {
            goal[i] -= off;
        }
        goal[3] += turn[0];
        goal[4] += turn[1];
        self.go(&goal, &here)
    }

    /// The command towards a place of the way; what is outside the hand's room is left out.
    fn go(&mut self, goal: &Travel, here: &Travel) -> Step {
        if self.last_jog.is_some_and(|last| self.now - last < SPACING) {
            return Step::Wait;
        }
        let mut way: Travel = std::array::from_fn(|i| goal[i] - here[i]);
        for (i, [low, high]) in self.hand.room.into_iter().enumerate() {
            let goal = (here[i] + way[i]).min(high - MARGIN).max(low + MARGIN);
            way[i] = goal - here[i];
        }
        if linear(&way) < 0.05 && way[3].abs() < 0.05 && way[4].abs() < 0.05 {
            return Step::Wait;
        }
        let jog = self.motion.toward(&way, self.fastest(), self.now);
        self.motion.command(self.commands + 1, &jog, self.now);
        self.sent = Some((self.now, jog.ms >= MOST_MS));
        self.last_jog = Some(self.now);
        Step::Send(jog.command())
    }

    /// Goes so far and no further, without images; whether it has.
    pub(super) fn go_blind(&mut self, goal: Travel) -> Option<Step> {
        let (end, travel) = self.motion.end();
        let left: Travel = std::array::from_fn(|i| goal[i] - travel[i]);
        let there = linear(&left) < 0.5 && left[3].abs() < SPIN;
        let soon = self.sent.is_some_and(|(sent, _)| self.now - sent < AGAIN) && !self.rests();
        if end - self.now > AHEAD || soon || (there && !self.rests()) {
            return Some(Step::Wait);
        }
        if there {
            return None;
        }
        let here = self.motion.at(self.now);
        let spaced = self.last_jog.is_none_or(|last| self.now - last >= SPACING);
        match self.go(&goal, &here) {
            // There is no more room.
            Step::Wait if self.rests() && spaced => None,
            step => Some(step),
        }
    }
}
