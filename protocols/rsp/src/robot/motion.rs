//! The motion filter (S12): one output each period, whatever arrived meanwhile.
//!
//! An output follows the packet that brought its value: a clock of the filter's own would let each value wait for its turn, up to a
//! whole period. Two outputs are 7/8 of a period apart at least, so that packets may come a little early; what needs more outputs to
//! get there has them 9/8 of a period apart, so that the next packet comes before them and its value need not wait.

use super::cell::{self, Cell, NEW};
use super::{Body, NEVER, Robot};
use crate::{Element, Kind, Motion, Number, Payload, number};

/// The parts of an effector's bytes, as [`cell::bytes`] says: of one number the newest value (or the total that was heard), the last
/// output (or the total that was put out), and where it came from (or the step).
type Parts = [i64; 3];

impl<const E: usize, const V: usize, const B: usize, const S: usize> Robot<'_, E, V, B, S> {
    /// An effector's value is here: a total of an incremental one, or its steps in paper mode.
    pub(super) fn hear_value(&mut self, now: u64, place: u8, value: &[u8]) {
        let (paper, period) = (self.paper, self.period_us());
        let Some((element, cell, bytes)) = self.parts(place) else {
            return;
        };
        let Payload::Numbers(number, _) = element.payload else {
            cell::store(element.payload, bytes, value);
            cell.set(NEW);
            self.plan(now, period);
            return;
        };
        let is_same = bytes.get(..value.len()) == Some(value);
        let (is_sum, passed) = match element.motion {
            Motion::Absolute { .. } if is_same => return,
            Motion::Absolute {
                interpolate: true, ..
            } => (false, share(now, cell.at, period)),
            Motion::Absolute { .. } => (false, 1.0),
            Motion::Incremental { .. } => (true, 1.0),
        };
        let mut new = value.chunks(number.size()).map(|new| number::load(number, new));
        each(number, bytes, &mut |[newest, output, from]: &mut Parts| {
            let mut new = new.next().unwrap_or_default();
            if is_sum {
                if paper {
                    // All that arrives between two outputs adds up.
                    new = number::add(number, *newest, new);
                }
                *output = number::hear(number, *newest, *output, new);
            } else {
                // Where the way had got to is where the next one begins.
                *from = number::between(number, *from, *newest, passed);
            }
            *newest = new;
        });
        cell.at = now as u32;
        cell.set(NEW);
        self.plan(now, period);
    }

    /// A value is here that was not put out yet.
    fn plan(&mut self, now: u64, period: u64) {
        if self.due == NEVER {
            // All has rested. A limit of change allows what it does in one period: a rest is not made up for in one step.
            self.moved = self.moved.max(now.saturating_sub(period));
        }
        self.due = self.due.min(self.moved + period - period / 8);
    }

    /// Puts out what is new, of all effectors.
    pub(super) fn move_all(&mut self, now: u64, body: &mut impl Body) {
        let elapsed = now.saturating_sub(self.moved);
        (self.moved, self.due) = (now, NEVER);
        for place in 0..E {
            if self.move_one(now, elapsed, place as u8, body) {
                self.due = now + self.period_us() + self.period_us() / 8;
            }
        }
    }

    /// Puts out what is new of one effector, and says whether it has still some way to go.
    fn move_one(&mut self, now: u64, elapsed: u64, place: u8, body: &mut impl Body) -> bool {
        let period = self.period_us();
        let Some((element, cell, bytes)) = self.parts(place) else {
            return false;
        };
        if element.kind != Kind::Effector || !cell.is(NEW) {
            return false;
        }
        let Payload::Numbers(number, _) = element.payload else {
            cell.clear(NEW);
            body.effector(place, cell::stored(element.payload, bytes));
            return false;
        };
        let limit = cell::rate(element.motion).map(|rate| allowance(cell, rate, number, elapsed));
        let (is_sum, part) = match element.motion {
            Motion::Absolute {
                interpolate: true, ..
            } => (false, share(now, cell.at, period)),
            Motion::Absolute { .. } => (false, 1.0),
            Motion::Incremental { .. } => (true, 1.0),
        };
        let (mut moved, mut arrived) = (false, part >= 1.0);
        each(number, bytes, &mut |[newest, output, from]: &mut Parts| {
            let before = *output;
            if is_sum {
                (*from, *output) = number::give(number, *newest, before, limit);
            } else {
                let point = number::between(number, *from, *newest, part);
                *output = number::approach(number, before, point, limit);
                if part >= 1.0 {
                    *from = *newest;
                }
            }
            moved |= *output != before;
            arrived &= *output == *newest;
        });
        if arrived {
            cell.clear(NEW);
            cell.credit = 0.0;
        }
        let size = element.payload.size();
        let from = if is_sum { 2 * size } else { size };
        if let Some(output) = bytes.get(from..from + size).filter(|_| moved) {
            body.effector(place, output);
        }
        !arrived
    }

    /// An effector has nobody to command it: its safe value, at once.
    pub(super) fn make_safe(&mut self, place: u8, body: &mut impl Body) {
        let Some((element, cell, bytes)) = self.parts(place) else {
            return;
        };
        cell.clear(NEW);
        cell.credit = 0.0;
        rest(element, bytes);
        body.effector(place, cell::stored(element.payload, element.safe));
    }
}

/// The bytes of an effector that has its safe value, and has been told nothing.
pub(super) fn rest(element: &Element<'_>, bytes: &mut [u8]) {
    if matches!(element.motion, Motion::Incremental { .. }) {
        bytes.fill(0);
        return;
    }
    // As often as there are parts; of type bytes once, and not in full.
    let mut safe = element.safe.iter().cycle();
    let is_number = matches!(element.payload, Payload::Numbers(..));
    let len = if is_number {
        bytes.len()
    } else {
        element.safe.len()
    };
    for byte in bytes.iter_mut().take(len) {
        *byte = safe.next().copied().unwrap_or(0);
    }
}

/// Changes the three parts of each number.
fn each(number: Number, bytes: &mut [u8], change: &mut dyn FnMut(&mut Parts)) {
    let size = number.size();
    let third = bytes.len() / 3;
    for start in (0..third).step_by(size) {
        let mut parts = [0; 3];
        for (at, part) in (start..).step_by(third).zip(&mut parts) {
            *part = number::load(number, bytes.get(at..at + size).unwrap_or_default());
        }
        change(&mut parts);
        for (at, part) in (start..).step_by(third).zip(parts) {
            number::store(part, bytes.get_mut(at..at + size).unwrap_or_default());
        }
    }
}

/// How much of the way of one period has passed, 0 to 1.
fn share(now: u64, at: u32, period: u64) -> f32 {
    let passed = (now as u32).wrapping_sub(at);
    (passed as f32 / period as f32).min(1.0)
}

/// The change that the rate allows now; of whole numbers what is less than one unit is kept for the next time.
fn allowance(cell: &mut Cell, rate: f32, number: Number, elapsed: u64) -> f32 {
    let all = cell.credit + rate * (elapsed as f32 / 1e6);
    if number == Number::F32 {
        return all;
    }
    let whole = all as i64 as f32;
    cell.credit = all - whole;
    whole
}
