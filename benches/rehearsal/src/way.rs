//! The straight way of each phase, and how far the tip was off it.

use mom_arm::{ArmState, Pose};
use mom_servo::control::{Phase, Progress};

use crate::{Start, goal};

/// mm of the tip above the table where it is above a block, and at it, as the controller has them.
const HEIGHTS: [f64; 2] = [110.0, 20.0];
/// mm that it goes straight up or down, at most.
const VERTICAL: f64 = 120.0;
/// mm that it goes aside, at most.
const ASIDE: f64 = 210.0;

/// The way of the tip in truth.
#[derive(Debug, Default)]
pub(crate) struct Way {
    /// The phase, and where it begins and ends.
    now: Option<(Phase, [f64; 3], [f64; 3])>,
    /// mm off it, at most.
    pub(crate) stray: f64,
}

impl Way {
    /// Takes where the tip is by now.
    pub(crate) fn go(&mut self, progress: &Progress, state: &ArmState, start: &Start) {
        let Pose { x, y, z, .. } = state.pose;
        let tip = [x, y, z];
        let phase = progress.phase;
        let (_, from, to) = match self.now {
            Some(now) if now.0 == phase => now,
            _ => *self.now.insert((phase, tip, end(phase, tip, state, start))),
        };
        let free = if phase == Phase::Aside { ASIDE } else { 0.0 };
        self.stray = self.stray.max(from_way(tip, from, to) - free);
    }
}

/// Where a phase is to end that begins here.
fn end(phase: Phase, [x, y, z]: [f64; 3], state: &ArmState, start: &Start) -> [f64; 3] {
    let first = &state.blocks[start.task.first];
    match phase {
        Phase::Approach => [first.x, first.y, HEIGHTS[0]],
        Phase::Descend => [first.x, first.y, HEIGHTS[1]],
        Phase::Carry => {
            let [x, y] = goal(&start.task, &state.blocks[start.task.second]);
            [x, y, z]
        }
        Phase::Rise | Phase::Lift | Phase::Withdraw => [x, y, z + VERTICAL],
        Phase::Lower => [x, y, z - VERTICAL],
        _ => [x, y, z],
    }
}

/// mm from a point to the line between two others.
fn from_way(point: [f64; 3], from: [f64; 3], to: [f64; 3]) -> f64 {
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let minus = |a: [f64; 3], b: [f64; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let (way, off) = (minus(to, from), minus(point, from));
    let part = (dot(off, way) / dot(way, way).max(1e-9)).clamp(0.0, 1.0);
    let left = minus(off, way.map(|length| length * part));
    dot(left, left).sqrt()
}
