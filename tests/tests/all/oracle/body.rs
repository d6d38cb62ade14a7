//! What a body did, by where it was.

use super::log::{Micros, Sample};

/// How many samples apart two places are whose distance says how fast the body is: 30 ms.
const WINDOW: usize = 3;

/// So much less than before is slower, and so much more than the slowest since is a new push.
const SLOWER: f64 = 0.6;
const FASTER: f64 = 1.5;

/// A motion of one body: it begins at rest, at a turn of its way, or where it becomes faster again after it was about to stop.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Motion {
    /// When it did not move this way yet.
    pub(super) since: Micros,
    /// When it was first seen to.
    pub(super) seen: Micros,
    /// When it was last seen to move this way.
    pub(super) until: Micros,
    /// How far along the first number of its place, with the sign of its way.
    pub(super) way: f64,
    /// Whether it begins from rest.
    pub(super) from_rest: bool,
}

/// One look at how fast a body is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Look {
    /// The end of its 30 ms.
    pub(super) at: Micros,
    /// Their begin.
    pub(super) from: Micros,
    /// How far it went, in multiples of what counts as none: it moves above 1.
    pub(super) speed: f64,
    /// The same of the first number alone, with its sign.
    pub(super) along: f64,
}

/// How fast a body was at all times. `least`: how far each number may change in 30 ms at rest.
pub(super) fn looks(samples: &[Sample], least: &[f64], turns: Option<usize>) -> Vec<Look> {
    let pairs = samples.iter().zip(samples.iter().skip(WINDOW));
    let look = |(from, to): (&Sample, &Sample)| {
        let far = |index: usize| {
            let change = to.place[index] - from.place[index];
            let change = match turns == Some(index) {
                true => (change + 540.0).rem_euclid(360.0) - 180.0,
                false => change,
            };
            change / least[index]
        };
        let speed = (0..least.len()).map(|index| far(index).abs()).fold(0.0, f64::max);
        Look {
            at: to.at,
            from: from.at,
            speed,
            along: far(0),
        }
    };
    pairs.map(look).collect()
}

/// The motions of a body, one after the other.
pub(super) fn motions(looks: &[Look], least: f64) -> Vec<Motion> {
    let mut motions: Vec<Motion> = Vec::new();
    let (mut moves, mut fastest, mut slowest) = (false, 0.0_f64, 0.0_f64);
    let mut sign = 0.0;
    for look in looks {
        if look.speed <= 1.0 {
            moves = false;
            continue;
        }
        let turned = look.along.abs() > 1.0 && sign != 0.0 && look.along.signum() != sign;
        let pushed = slowest < fastest * SLOWER && look.speed > slowest * FASTER + 4.0;
        if !moves || turned || pushed {
            let from_rest = !moves;
            motions.push(Motion {
                since: look.from,
                seen: look.at,
                until: look.at,
                way: 0.0,
                from_rest,
            });
            (fastest, slowest, sign) = (look.speed, look.speed, 0.0);
        }
        moves = true;
        if look.speed > fastest {
            (fastest, slowest) = (look.speed, look.speed);
        }
        slowest = slowest.min(look.speed);
        if sign == 0.0 && look.along.abs() > 1.0 {
            sign = look.along.signum();
        }
        if let Some(motion) = motions.last_mut() {
            motion.until = look.at;
            // Each look shares its way with those beside it.
            motion.way += look.along * least / WINDOW as f64;
        }
    }
    motions
}
