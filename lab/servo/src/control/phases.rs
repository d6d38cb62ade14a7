//! The phases of the work, one after the other.

use std::fmt;

use super::moving::{Above, Aim, Reach};
use super::sight::Judgement;
use super::{ALIGNED, ATTEMPTS, Action, PARALLEL, Servo};
use crate::Micros;
use crate::aim::{Miss, Sightline, miss};
use crate::motion::Travel;
use crate::plan::Plan;
use crate::task::{NAMES, SIZE};
use crate::track::marker;

/// Of the tip above the table when it goes across, mm: above two blocks.
const HOVER: f64 = 110.0;
/// Lower than this it rises first, mm.
const LOW: f64 = 100.0;
/// Of the tip when it takes a block: its middle, mm.
const GRASP: f64 = SIZE / 2.0;
/// How far it lifts, mm.
const LIFT: f64 = 95.0;
/// How far above the table the block is let go, mm: commands that come late take the hand some tenths of a millimetre elsewhere.
const DROP: f64 = 1.5;
/// An overload nearer than this to the end of its way down, mm, is the table's, and no other block's.
const TOUCH: f64 = SIZE / 2.0;
/// How far the hand withdraws upward, mm.
const UP: f64 = 115.0;
/// How far aside, mm, at most, so that the camera above sees the blocks.
const ASIDE: [f64; 3] = [110.0, 160.0, 210.0];
/// The arm's base, mm: from there it reaches over the table.
const BASE: [f64; 2] = [-960.0, 0.0];
/// What is nearer to the arm than this is hidden, mm.
const HIDDEN: f64 = 85.0;
/// µs for which is looked at most.
const LOOK: Micros = 6_000_000;
/// µs after which one camera is enough.
const ALONE: Micros = 2_500_000;
/// µs of a phase in which the hand comes nowhere.
const STUCK: Micros = 25_000_000;
/// A phase in which it goes carefully may take so many times as long.
const CAREFULLY: Micros = 3;
/// µs in which the jaws move.
const JAWS: Micros = 8_000_000;
/// Measured nearer than this it is surely aligned, mm.
const SURELY: f64 = 2.0;

/// What is being done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Looks for the blocks and the hand.
    Look,
    /// Opens the jaws.
    Open,
    /// Goes up.
    Rise,
    /// Goes above the first block.
    Approach,
    /// Goes down to it.
    Descend,
    /// Closes the jaws.
    Close,
    /// Lifts it.
    Lift,
    /// Carries it above its place.
    Carry,
    /// Puts it down.
    Lower,
    /// Opens the jaws.
    Release,
    /// Goes up again.
    Withdraw,
    /// Goes out of sight.
    Aside,
    /// Looks whether they are aligned.
    Check,
}

/// What a phase comes to now.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Step {
    Wait,
    Send(String),
    Enter(Phase),
    End(Action),
}

impl Phase {
    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Phase::Look => "looking",
            Phase::Open => "opening",
            Phase::Rise => "rising",
            Phase::Approach => "approaching",
            Phase::Descend => "descending",
            Phase::Close => "closing",
            Phase::Lift => "lifting",
            Phase::Carry => "carrying",
            Phase::Lower => "lowering",
            Phase::Release => "releasing",
            Phase::Withdraw => "withdrawing",
            Phase::Aside => "standing aside",
            Phase::Check => "checking",
        }
    }

    /// Whether pictures lead the hand.
    const fn is_led(self) -> bool {
        matches!(self, Phase::Approach | Phase::Descend | Phase::Carry)
    }

    /// Whether the hand hides the first block, or holds it.
    pub(super) const fn hides_first(self) -> bool {
        !matches!(
            self,
            Phase::Look | Phase::Open | Phase::Rise | Phase::Approach | Phase::Check
        )
    }
}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl Servo {
    pub(super) fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.since = self.now;
        self.slowed = false;
        self.late = 0;
        self.sent = None;
        self.blind = None;
        self.touched = false;
        if phase == Phase::Check {
            self.memory.forget(self.task.first);
        }
    }

    pub(super) fn step(&mut self) -> Step {
        self.slowed |= self.sight.careful().is_some();
        let usual = if self.slowed { CAREFULLY * STUCK } else { STUCK };
        let limit = usual + 8 * (self.track.delay_micros() + self.now - self.newest.unwrap_or(self.now));
        if self.now - self.since > limit {
            return self.stuck();
        }
        match self.sight.judge(self.phase.is_led(), self.now) {
            Judgement::End(why) => return Servo::fail(why),
            Judgement::Wait => return Step::Wait,
            Judgement::Move => {}
        }
        // One command at a time, to its end.
        if self.sight.careful().is_some() && (self.sight.is_unheard() || !self.rests()) && self.jaws.is_none()
        {
            return Step::Wait;
        }
        match self.phase {
            Phase::Look => self.look(),
            Phase::Open | Phase::Release => self.jaws("grip open"),
            Phase::Close => self.jaws("grip close"),
            Phase::Rise => self.rise(),
            Phase::Approach => self.approach(),
            Phase::Descend => self.descend(),
            Phase::Lift => self.straight(LIFT, Phase::Carry),
            Phase::Carry => self.carry(),
            Phase::Lower => self.lower(),
            Phase::Withdraw => self.straight(UP, Phase::Aside),
            Phase::Aside => self.stand_aside(),
            Phase::Check => self.check(),
        }
    }

    fn fail(text: impl Into<String>) -> Step {
        Step::End(Action::Failed(text.into()))
    }

    fn stuck(&self) -> Step {
        let seconds = (self.now - self.since) / 1_000_000;
        let miss = match self.miss {
            Some(miss) => format!(
                "; the images say {:.1} mm, {:.1} pixels",
                miss.distance(),
                miss.pixels
            ),
            None => "; the marker on the hand is not seen".to_owned(),
        };
        Servo::fail(format!("{} came to no end within {seconds} s{miss}", self.phase))
    }

    /// Blocks and hand, in two images at least.
    fn look(&mut self) -> Step {
        let waited = self.now - self.since;
        let enough = if waited > ALONE { 1 } else { 2 };
        let unseen = [self.task.first, self.task.second]
            .into_iter()
            .find(|block| self.memory.views(*block) < enough);
        let hands = (0..self.track.cameras()).filter(|camera| self.track.seen(*camera).is_some());
        let hand = hands.count() >= enough;
        match (unseen, hand) {
            (None, true) => {}
            _ if waited < LOOK => return Step::Wait,
            (Some(block), _) => {
                return Servo::fail(format!("{} is not seen whole by any camera", NAMES[block].0));
            }
            (None, false) => return Servo::fail("the marker on the hand is not seen by any camera"),
        }
        match self.make_plan() {
            Ok(()) => Step::Enter(if self.attempts == 0 {
                Phase::Open
            } else {
                Phase::Rise
            }),
            Err(why) => Servo::fail(why),
        }
    }

    pub(super) fn make_plan(&mut self) -> Result<(), String> {
        let mut plan = Plan::new(&self.task, &self.memory)?;
        plan.place -= self.bias[2];
        let (_, travel) = self.motion.end();
        for (above, what) in [
            (Above::First, self.name().to_owned()),
            (
                Above::Goal,
                format!(
                    "the place at the {} of {}",
                    self.task.side, NAMES[self.task.second].0
                ),
            ),
        ] {
            let aim = Aim {
                above,
                height: Some(HOVER),
                spin: plan.place,
                near: [0.0; 2],
            };
            let (seen, _) = self
                .miss_at(&aim, &plan, &travel, None)
                .ok_or("no camera sees hand and blocks")?;
            for (axis, name) in ["x", "y"].into_iter().enumerate() {
                let [low, high] = self.hand.room[axis];
                let goal = travel[axis] - seen.off[axis];
                if goal < low || goal > high {
                    let beyond = (low - goal).max(goal - high);
                    return Err(format!(
                        "{what} is outside the workspace, by {beyond:.0} mm along {name}"
                    ));
                }
            }
        }
        self.plan = Some(plan);
        Ok(())
    }

    /// Tells the jaws, once the hand rests.
    fn jaws(&mut self, command: &str) -> Step {
        if let Some(told) = self.jaws {
            let slow = JAWS + 4 * self.track.delay_micros();
            return match self.now - told > slow {
                true => Servo::fail("the arm does not say that its jaws have moved"),
                false => Step::Wait,
            };
        }
        let (sent, _) = self.sent.unwrap_or((Micros::MIN / 2, false));
        if self.now < self.motion.end().0 + 150_000 || self.now - sent < 250_000 {
            return Step::Wait;
        }
        self.jaws = Some(self.now);
        Step::Send(command.to_owned())
    }

    pub(super) fn after_jaws(&mut self, holding: bool) {
        let next = match self.phase {
            Phase::Open => Phase::Rise,
            Phase::Release => {
                self.held = false;
                let tip = self.track.tip(&self.motion.end().1);
                self.put = Some(([tip[0], tip[1]], self.now));
                Phase::Withdraw
            }
            Phase::Close if holding => {
                self.held = true;
                self.memory.forget(self.task.first);
                Phase::Lift
            }
            Phase::Close => {
                let text = format!("the jaws closed beside {}", self.name());
                self.end = Some(Action::Failed(text));
                return;
            }
            _ => return,
        };
        self.enter(next);
    }

    fn rise(&mut self) -> Step {
        let (_, travel) = self.motion.end();
        let goal = *self.blind.get_or_insert_with(|| {
            let mut goal = travel;
            if self.met {
                goal[2] += LIFT;
            } else if self.track.tip(&travel)[2] < LOW {
                goal[2] += HOVER - self.track.tip(&travel)[2];
            }
            goal
        });
        match self.go_blind(goal) {
            Some(step) => step,
            None if std::mem::take(&mut self.met) => Step::Enter(Phase::Look),
            None => Step::Enter(Phase::Approach),
        }
    }

    fn approach(&mut self) -> Step {
        let Some(plan) = self.plan else {
            return Step::Enter(Phase::Look);
        };
        let aim = Aim {
            above: Above::First,
            height: Some(HOVER),
            spin: plan.pick,
            near: [6.0, 15.0],
        };
        match self.reach(&aim, &plan) {
            Reach::Going(step) => step,
            Reach::There(_) => Step::Enter(Phase::Descend),
        }
    }

    fn descend(&mut self) -> Step {
        let Some(plan) = self.plan else {
            return Step::Enter(Phase::Look);
        };
        let aim = Aim {
            above: Above::First,
            height: Some(GRASP),
            spin: plan.pick,
            near: [3.0, 5.0],
        };
        match self.reach(&aim, &plan) {
            Reach::Going(step) => step,
            Reach::There(seen) => {
                // Along the jaw line the jaws shift the block between them; across it stays where it is.
                let (sin, cos) = plan.pick.to_radians().sin_cos();
                self.across = seen.off[0] * sin - seen.off[1] * cos;
                self.taken_at = self.motion.end().1[2];
                Step::Enter(Phase::Close)
            }
        }
    }

    /// Straight up.
    fn straight(&mut self, by: f64, then: Phase) -> Step {
        let (_, travel) = self.motion.end();
        let goal = *self.blind.get_or_insert_with(|| {
            let mut goal = travel;
            goal[2] += by;
            goal
        });
        self.go_blind(goal).unwrap_or(Step::Enter(then))
    }

    fn carry(&mut self) -> Step {
        let Some(plan) = self.plan else {
            return Step::Enter(Phase::Look);
        };
        let aim = Aim {
            above: Above::Goal,
            height: None,
            spin: plan.place,
            near: [0.8, 50.0],
        };
        match self.reach(&aim, &plan) {
            Reach::Going(step) => step,
            Reach::There(_) => Step::Enter(Phase::Lower),
        }
    }

    fn lower(&mut self) -> Step {
        let (_, travel) = self.motion.end();
        let taken = self.taken_at;
        let goal = *self.blind.get_or_insert_with(|| {
            let mut goal = travel;
            goal[2] = taken + DROP;
            goal
        });
        self.go_blind(goal).unwrap_or(Step::Enter(Phase::Release))
    }

    /// Whether what the block met at this time is the table.
    pub(super) fn touches_down(&self, at: Micros) -> bool {
        let then = at - self.usual.unwrap_or(self.track.delay_micros());
        let left = self.motion.at(then)[2] - self.taken_at;
        matches!(self.phase, Phase::Lower | Phase::Release) && left < TOUCH
    }

    /// To where neither hand nor arm hides the blocks from above.
    fn stand_aside(&mut self) -> Step {
        let (_, travel) = self.motion.end();
        let Some(plan) = self.plan else {
            return Step::Enter(Phase::Check);
        };
        let second = self.memory.place(self.task.second);
        let goal = match (self.blind, second) {
            (Some(goal), _) => goal,
            (None, None) => travel,
            (None, Some(second)) => {
                let blocks = [second.place, plan.goal(second.place, self.task.gap)];
                self.clear_of(&blocks, travel)
            }
        };
        self.blind = Some(goal);
        self.go_blind(goal).unwrap_or(Step::Enter(Phase::Check))
    }

    /// The nearest place from which these places are free, or the freest.
    fn clear_of(&self, blocks: &[[f64; 2]], travel: Travel) -> Travel {
        let tip = self.track.tip(&travel);
        let reach = marker(self.track.spin(&travel), 0.0);
        let mut best = (f64::NEG_INFINITY, travel);
        for far in ASIDE {
            for way in 0..12 {
                let (sin, cos) = (f64::from(way) * 30.0).to_radians().sin_cos();
                let (dx, dy) = (far * cos, far * sin);
                let moved = [travel[0] + dx, travel[1] + dy];
                if (0..2)
                    .any(|i| moved[i] < self.hand.room[i][0] + 5.0 || moved[i] > self.hand.room[i][1] - 5.0)
                {
                    continue;
                }
                let hand = [tip[0] + dx, tip[1] + dy];
                let marked = [hand[0] + reach.x, hand[1] + reach.y];
                let clear = |block: &[f64; 2]| {
                    from_line(*block, BASE, hand).min(from_line(*block, hand, marked) + 40.0)
                };
                let clear = blocks.iter().map(clear).fold(f64::INFINITY, f64::min);
                if clear > best.0 && best.0 < HIDDEN {
                    let mut goal = travel;
                    (goal[0], goal[1]) = (moved[0], moved[1]);
                    best = (clear, goal);
                }
            }
        }
        best.1
    }

    /// Whether the blocks are aligned, by images in which the hand is out of the way.
    fn check(&mut self) -> Step {
        let waited = self.now - self.settled();
        let enough = if waited > ALONE { 1 } else { 2 };
        let Some(plan) = self.plan else {
            return Step::Enter(Phase::Look);
        };
        if self.memory.views(self.task.first) < enough {
            return match waited > LOOK + (self.now - self.newest.unwrap_or(self.now)) {
                true => Servo::fail(format!("{} is not seen after it was put down", self.name())),
                false => Step::Wait,
            };
        }
        // All cameras get some time to show it.
        let all = self.memory.views(self.task.first) >= self.track.cameras();
        if !all && waited < ALONE / 2 {
            return Step::Wait;
        }
        let Some((seen, turned)) = self.alignment(&plan) else {
            return Step::Wait;
        };
        self.miss = Some(seen);
        self.attempts += 1;
        let last = self.attempts >= ATTEMPTS;
        let near = if last { ALIGNED } else { SURELY };
        if seen.level() <= near && turned.abs() <= PARALLEL {
            return Step::End(Action::Aligned);
        }
        if last {
            let text = format!(
                "after {} tries {} is {:.1} mm and {:.1} degrees from where it is to be",
                self.attempts,
                self.name(),
                seen.level(),
                turned.abs()
            );
            return Servo::fail(text);
        }
        self.learn(&plan, &seen, turned);
        Step::Enter(Phase::Look)
    }

    /// How far the first block is from its place, and by how many degrees it is turned from the second.
    fn alignment(&self, plan: &Plan) -> Option<(Miss, f64)> {
        let (first, second) = (self.task.first, self.task.second);
        let mut lines = Vec::new();
        for camera in 0..self.track.cameras() {
            let (Some(one), Some(other), Some(projection)) = (
                self.memory.local(first, camera),
                self.memory.local(second, camera),
                self.track.projection(camera),
            ) else {
                continue;
            };
            let [x, y] = plan.goal(other.place, self.task.gap);
            lines.push(Sightline {
                projection: *projection,
                pixel: projection.project([one.place[0], one.place[1], SIZE / 2.0])?,
                target: [x, y, SIZE / 2.0],
            });
        }
        let seen = miss(&lines, [0.0; 3], [1000.0, 1000.0, 1e-3])?;
        let turned = self.memory.place(first)?.yaw - self.memory.place(second)?.yaw;
        Some((seen, turned - 90.0 * (turned / 90.0).round()))
    }

    /// What the block put down tells of the hand: along the jaw line it was in the middle of the jaws; across it lay as it was taken.
    fn learn(&mut self, plan: &Plan, seen: &Miss, turned: f64) {
        let (sin, cos) = plan.place.to_radians().sin_cos();
        let along = seen.off[0] * cos + seen.off[1] * sin;
        let across = -seen.off[0] * sin + seen.off[1] * cos;
        // A hand that was turned in between had another error when it took the block.
        let across = match (plan.pick - plan.place).abs() < 15.0 {
            true => across,
            false => 0.0,
        };
        self.bias[0] += along * cos - across * sin;
        self.bias[1] += along * sin + across * cos;
        if turned.abs() > PARALLEL / 2.0 {
            self.bias[2] += turned * 0.7;
        }
    }
}

/// From a point to a line between two others, mm.
fn from_line(point: [f64; 2], from: [f64; 2], to: [f64; 2]) -> f64 {
    let way = [to[0] - from[0], to[1] - from[1]];
    let length = (way[0] * way[0] + way[1] * way[1]).max(1e-9);
    let part = ((point[0] - from[0]) * way[0] + (point[1] - from[1]) * way[1]) / length;
    let part = part.clamp(0.0, 1.0);
    (point[0] - from[0] - part * way[0]).hypot(point[1] - from[1] - part * way[1])
}
