//! What the hand does by what it has been told: the model of the arm's `jog`, which predicts and never looks.
//!
//! Times are those at which commands are sent. The hand does the same later, by the delay of the commands.

use std::collections::VecDeque;

use crate::Micros;

/// x, y and z in mm, spin and tilt in degrees: a way, or with "per second" a velocity.
pub type Travel = [f64; 5];

/// µs between two changes of speed.
const TICK: Micros = 10_000;
/// mm/s² of the hand.
const ACCELERATION: f64 = 600.0;
/// Degrees/s² of spin and tilt.
const TURN_ACCELERATION: f64 = 360.0;
/// Degrees/s of spin and tilt, at most.
const TURN_SPEED: f64 = 60.0;
/// ms that one command lasts at most: who is gone must not drive on.
pub const MOST_MS: i64 = 1000;
/// The shortest command, ms.
const LEAST_MS: f64 = 100.0;
/// What is remembered: three minutes of motion.
const MOST_SAMPLES: usize = 20_000;

/// Where the hand is at a time, counted from the beginning, and how fast.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Sample {
    at: Micros,
    travel: Travel,
    speed: Travel,
}

/// Commands whose begin may still be told.
const MOST_COMMANDS: usize = 16;

/// The hand's way by the commands that were sent.
#[derive(Debug, Clone)]
pub struct Motion {
    samples: VecDeque<Sample>,
    /// The newest commands, with their numbers and the times at which they count as sent.
    commands: VecDeque<(u32, Micros, Jog)>,
}

/// A command to the arm: a velocity, and for how long.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jog {
    /// Per second.
    pub velocity: Travel,
    /// ms.
    pub ms: i64,
}

impl Jog {
    /// The command in the arm's words.
    #[must_use]
    pub fn command(&self) -> String {
        let [x, y, z, spin, tilt] = self.velocity;
        format!("jog {x:.3} {y:.3} {z:.3} {spin:.3} {tilt:.3} {}", self.ms)
    }
}

impl Motion {
    /// A hand that rests.
    #[must_use]
    pub fn new(now: Micros) -> Motion {
        let rest = Sample {
            at: now,
            travel: [0.0; 5],
            speed: [0.0; 5],
        };
        Motion {
            samples: VecDeque::from([rest]),
            commands: VecDeque::new(),
        }
    }

    /// How far it is at a time.
    #[must_use]
    pub fn at(&self, at: Micros) -> Travel {
        self.sample(at).travel
    }

    /// When it comes to rest, and where.
    #[must_use]
    pub fn end(&self) -> (Micros, Travel) {
        self.samples
            .back()
            .map_or((0, [0.0; 5]), |last| (last.at, last.travel))
    }

    /// How fast it is, mm/s.
    #[must_use]
    pub fn speed(&self, at: Micros) -> f64 {
        linear(&self.sample(at).speed)
    }

    fn sample(&self, at: Micros) -> Sample {
        let after = self.samples.partition_point(|sample| sample.at <= at);
        let rest = |sample: &Sample| Sample {
            at,
            speed: [0.0; 5],
            ..*sample
        };
        match (
            after.checked_sub(1).map(|i| self.samples[i]),
            self.samples.get(after),
        ) {
            (Some(a), Some(b)) => {
                let part = (at - a.at) as f64 / (b.at - a.at).max(1) as f64;
                let mix = |x: &Travel, y: &Travel| std::array::from_fn(|i| x[i] + (y[i] - x[i]) * part);
                Sample {
                    at,
                    travel: mix(&a.travel, &b.travel),
                    speed: mix(&a.speed, &b.speed),
                }
            }
            (Some(last), None) if last.at == at => last,
            (Some(only), None) | (None, Some(&only)) => rest(&only),
            (None, None) => Sample {
                at,
                travel: [0.0; 5],
                speed: [0.0; 5],
            },
        }
    }

    /// A command with this number is sent, in the place of the one before it.
    pub fn command(&mut self, number: u32, jog: &Jog, at: Micros) {
        self.commands.push_back((number, at, *jog));
        self.simulate(self.commands.len() - 1);
        while self.commands.len() > MOST_COMMANDS {
            self.commands.pop_front();
        }
    }

    /// The arm has begun a command later or sooner than others, and so it counts as sent at another time.
    pub fn begun(&mut self, number: u32, at: Micros) {
        let Some(index) = self.commands.iter().position(|(known, ..)| *known == number) else {
            return;
        };
        self.commands[index].1 = at;
        self.simulate(index.saturating_sub(1));
    }

    /// Goes through the commands again, from this one on.
    fn simulate(&mut self, from: usize) {
        let commands: Vec<(Micros, Jog)> = self
            .commands
            .iter()
            .skip(from)
            .map(|(_, at, jog)| (*at, *jog))
            .collect();
        for (index, (at, jog)) in commands.iter().enumerate() {
            let next = commands.get(index + 1).map_or(Micros::MAX, |(next, _)| *next);
            self.carry_out(jog, *at, next);
        }
        while self.samples.len() > MOST_SAMPLES {
            self.samples.pop_front();
        }
    }

    /// From where the hand is then until the next command, or until it rests.
    fn carry_out(&mut self, jog: &Jog, at: Micros, next: Micros) {
        let mut now = self.sample(at);
        while self.samples.back().is_some_and(|last| last.at >= at) {
            self.samples.pop_back();
        }
        self.samples.push_back(now);
        let until = at + jog.ms * 1000;
        let seconds = TICK as f64 / 1e6;
        while now.at < next {
            let wanted = if now.at < until { jog.velocity } else { [0.0; 5] };
            if now.at >= until && now.speed == [0.0; 5] {
                break;
            }
            now.speed = toward(&now.speed, &wanted, seconds);
            now.at += TICK;
            for (way, speed) in now.travel.iter_mut().zip(now.speed) {
                *way += speed * seconds;
            }
            self.samples.push_back(now);
        }
    }

    /// The hand has stopped without a word: what is left of the way is not gone.
    pub fn halt(&mut self, at: Micros) {
        let now = self.sample(at);
        self.samples.retain(|sample| sample.at < at);
        self.commands.clear();
        self.samples.push_back(Sample {
            speed: [0.0; 5],
            ..now
        });
    }

    /// The hand had come to rest by then, without a word; commands that were sent later are carried out.
    pub fn stood(&mut self, at: Micros) {
        let now = self.sample(at);
        self.samples.retain(|sample| sample.at < at);
        self.samples.push_back(Sample {
            speed: [0.0; 5],
            ..now
        });
        self.commands.retain(|(_, sent, _)| *sent > at);
        self.simulate(0);
    }

    /// The command after which the hand rests this far from where it is at that time, or is on the way there: no
    /// command lasts longer than a second.
    #[must_use]
    pub fn toward(&self, way: &Travel, fastest: f64, at: Micros) -> Jog {
        let now = self.sample(at);
        let seconds = MOST_MS as f64 / 1000.0;
        let turn = way[3].abs().max(way[4].abs());
        let time = (linear(way) / fastest)
            .max(turn / TURN_SPEED)
            .max(LEAST_MS / 1000.0);
        // What the change from the present speed adds to the way is taken off; a few rounds, as it depends on the speed.
        let mut velocity = way.map(|part| part / time);
        let held = time.min(seconds);
        for _ in 0..6 {
            let change: Travel = std::array::from_fn(|i| now.speed[i] - velocity[i]);
            let (up, down) = (linear(&change) / ACCELERATION, linear(&velocity) / ACCELERATION);
            for i in 0..5 {
                let (up, down) = match i {
                    0..3 => (up, down),
                    _ => (
                        change[i].abs() / TURN_ACCELERATION,
                        velocity[i].abs() / TURN_ACCELERATION,
                    ),
                };
                let goes = way[i] * (held / time);
                let held = (held + (down - up) / 2.0).max(LEAST_MS / 2000.0);
                velocity[i] = (goes - now.speed[i] * up / 2.0) / held;
            }
        }
        let over = linear(&velocity) / fastest;
        let turns = velocity[3].abs().max(velocity[4].abs()) / TURN_SPEED;
        let slower = over.max(turns).max(1.0);
        Jog {
            velocity: velocity.map(|part| part / slower),
            ms: (held * 1000.0).round() as i64,
        }
    }
}

/// Of the first three.
pub(crate) fn linear(travel: &Travel) -> f64 {
    travel[0].hypot(travel[1]).hypot(travel[2])
}

/// The speed after this time, as the arm changes it.
fn toward(speed: &Travel, wanted: &Travel, seconds: f64) -> Travel {
    let change: Travel = std::array::from_fn(|i| wanted[i] - speed[i]);
    let part = ACCELERATION * seconds / linear(&change).max(1e-12);
    let turn = TURN_ACCELERATION * seconds;
    std::array::from_fn(|i| match i {
        0..3 => speed[i] + change[i] * part.min(1.0),
        _ => speed[i] + change[i].clamp(-turn, turn),
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_jog_from_rest_goes_its_velocity_times_its_time() {
        let mut motion = Motion::new(0);
        let jog = motion.toward(&[60.0, -30.0, 20.0, 10.0, 0.0], 150.0, 0);
        motion.command(1, &jog, 0);
        let (end, travel) = motion.end();
        for (gone, wanted) in travel.iter().zip([60.0, -30.0, 20.0, 10.0, 0.0]) {
            assert!((gone - wanted).abs() < 2.0, "{travel:?}");
        }
        assert!(end < 1_000_000 && motion.at(end + 1) == travel);
        assert_eq!(motion.speed(end + 1), 0.0);
    }

    #[test]
    fn a_command_that_began_late_lets_the_one_before_go_on() {
        let mut motion = Motion::new(0);
        let jog = |x: f64| Jog {
            velocity: [x, 0.0, 0.0, 0.0, 0.0],
            ms: 1000,
        };
        motion.command(1, &jog(100.0), 0);
        motion.command(2, &jog(-100.0), 500_000);
        let before = motion.end().1[0];
        motion.begun(2, 600_000);
        assert!(
            (motion.end().1[0] - before - 10.0).abs() < 1.0,
            "{before} {:?}",
            motion.end()
        );
        motion.begun(2, 500_000);
        assert!((motion.end().1[0] - before).abs() < 1e-9);
        motion.begun(7, 0);
    }

    #[test]
    fn who_stood_still_goes_on_from_there_by_what_was_sent_later() {
        let mut motion = Motion::new(0);
        let jog = |x: f64| Jog {
            velocity: [x, 0.0, 0.0, 0.0, 0.0],
            ms: 1000,
        };
        motion.command(1, &jog(100.0), 0);
        let there = motion.at(400_000)[0];
        motion.command(2, &jog(-50.0), 700_000);
        motion.stood(400_000);
        assert_eq!(motion.at(600_000)[0], there);
        let alone = {
            let mut alone = Motion::new(0);
            alone.command(2, &jog(-50.0), 700_000);
            alone.end().1[0]
        };
        assert!(
            (motion.end().1[0] - there - alone).abs() < 1e-9,
            "{:?}",
            motion.end()
        );
    }

    proptest! {
        /// From whatever speed, and after some commands more, it ends where it is to end.
        #[test]
        fn commands_in_flight_are_taken_into_account(
            first in proptest::array::uniform5(-80.0..80.0_f64),
            way in proptest::array::uniform5(-150.0..150.0_f64),
            later in 0_i64..900_000,
        ) {
            let mut motion = Motion::new(0);
            let jog = motion.toward(&first, 150.0, 0);
            motion.command(1, &jog, 0);
            let goal: Travel = std::array::from_fn(|i| motion.at(later)[i] + way[i]);
            let mut now = later;
            for _ in 0..12 {
                let left: Travel = std::array::from_fn(|i| goal[i] - motion.at(now)[i]);
                let jog = motion.toward(&left, 150.0, now);
                prop_assert!(linear(&jog.velocity) <= 150.0 + 1e-6 && (1..=MOST_MS).contains(&jog.ms));
                motion.command(2, &jog, now);
                now += 700_000;
            }
            let (_, end) = motion.end();
            for (gone, wanted) in end.iter().zip(goal) {
                prop_assert!((gone - wanted).abs() < 0.5, "{end:?} {goal:?}");
            }
        }
    }
}
