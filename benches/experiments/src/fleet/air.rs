//! A base station and its robots over the radio model, in virtual time: who has its command confirmed when.

use std::collections::{BTreeMap, BTreeSet};

use fastrand::Rng;
use mom_radio::{Loss, MessageId, Micros, Position, Radio, Settings, Station, Transport};

use super::Times;

pub(super) const MS: Micros = 1000;
pub(super) const SECOND: Micros = 1000 * MS;
/// W18: 10 commands/s.
pub(super) const PERIOD: Micros = 100 * MS;
/// W8.
const NULL_PERIOD: Micros = 10 * SECOND;
/// m from the base station to each robot.
const AWAY: f64 = 10.0;
/// Octets of the file that are given to TCP at once.
const BLOCK: u32 = 64 << 10;

/// How the base station goes round.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Style {
    /// It waits for each reply before it commands the next robot.
    Serial,
    /// A connection for each robot, and none waits for another.
    Concurrent,
}

/// What the computers take for a message, µs.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Hosts {
    /// The robot, from a command to its reply.
    pub(super) robot: Micros,
    /// The base station, half for a command and half for its reply; one after the other.
    pub(super) base: Micros,
}

#[derive(Clone, Debug)]
pub(super) struct Run {
    pub(super) robots: usize,
    /// bit/s.
    pub(super) rate: u32,
    pub(super) style: Style,
    /// Whether robots are commanded, 10 times a second.
    pub(super) commands: bool,
    /// Whether NULLs are sent, every 10 s.
    pub(super) nulls: bool,
    pub(super) hosts: Hosts,
    /// Whether the first robot sends a file to a station beside the base station, all the time.
    pub(super) file: bool,
    pub(super) loss: Loss,
    pub(super) time: Micros,
    pub(super) seed: u64,
}

/// What came of it.
#[derive(Clone, Debug, Default)]
pub(super) struct Came {
    /// ms of the round trips of NULL.
    pub(super) nulls: Times,
    /// ms from when a command was due until its reply.
    pub(super) commands: Times,
    /// Commands that were due.
    pub(super) due: u64,
    /// Those without a reply before the next one was due.
    pub(super) missed: u64,
    /// The share of the time in which something was on the air.
    pub(super) busy: f64,
    /// Commands/s for each robot that had a reply.
    pub(super) rate: f64,
    /// Mbit/s of the file.
    pub(super) file: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    Null,
    /// MOTOR, and a NULL behind it that tells that it was carried out.
    Command,
}

impl Kind {
    /// Octets to the robot; 2 come back.
    const fn octets(self) -> u32 {
        match self {
            Kind::Null => 2,
            Kind::Command => 16,
        }
    }
}

/// A command on its way, and since when it was due.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Trip {
    robot: usize,
    kind: Kind,
    due: Micros,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Step {
    /// It is time for one.
    Due(usize, Kind),
    /// The base station has it ready.
    Command(Trip),
    /// The robot has carried it out.
    Reply(Trip),
    /// The base station has read the reply.
    Read(Trip),
}

struct World<'r> {
    run: &'r Run,
    radio: Radio,
    base: Station,
    robots: Vec<Station>,
    /// Where the file goes, and how many blocks have come.
    beside: Station,
    blocks: u64,
    agenda: BTreeSet<(Micros, u64, Step)>,
    number: u64,
    base_free: Micros,
    robot_free: Vec<Micros>,
    on_air: BTreeMap<MessageId, (Trip, bool)>,
    /// Robots with a command that has no reply.
    open: Vec<bool>,
    round: Micros,
    nulls: Vec<f64>,
    commands: Vec<f64>,
    replied: u64,
    in_time: u64,
}

impl Run {
    /// Lets it run.
    pub(super) fn simulate(&self) -> Came {
        let mut radio = Radio::new(Settings {
            rate: self.rate,
            seed: self.seed,
            loss: self.loss,
            ..Settings::default()
        });
        let base = radio.add(Position::default());
        let robots = (0..self.robots).map(|i| {
            let angle = std::f64::consts::TAU * i as f64 / self.robots as f64;
            radio.add(Position::new(AWAY * angle.cos(), AWAY * angle.sin()))
        });
        let robots: Vec<Station> = robots.collect();
        let beside = radio.add(Position::new(0.0, 1.0));
        let mut world = World {
            robots,
            beside,
            blocks: 0,
            run: self,
            radio,
            base,
            agenda: BTreeSet::new(),
            number: 0,
            base_free: 0,
            robot_free: vec![0; self.robots],
            on_air: BTreeMap::new(),
            open: vec![false; self.robots],
            round: 0,
            nulls: Vec::new(),
            commands: Vec::new(),
            replied: 0,
            in_time: 0,
        };
        world.begin();
        world.go();
        world.end()
    }
}

impl World<'_> {
    fn begin(&mut self) {
        let mut random = Rng::with_seed(self.run.seed);
        for robot in 0..self.run.robots {
            let (null, command) = (random.i64(0..NULL_PERIOD), random.i64(0..PERIOD));
            if self.run.nulls {
                self.at(null, Step::Due(robot, Kind::Null));
            }
            if self.run.commands && self.run.style == Style::Concurrent {
                self.at(command, Step::Due(robot, Kind::Command));
            }
        }
        if self.run.commands && self.run.style == Style::Serial {
            self.at(0, Step::Due(0, Kind::Command));
        }
        if self.run.file {
            // One block is given while the other one goes.
            self.send_block(0);
            self.send_block(0);
        }
    }

    fn send_block(&mut self, now: Micros) {
        if let Some(robot) = self.robots.first() {
            // A station of this network, and a time that has not passed: it is taken.
            let _ = self.radio.send(now, *robot, self.beside, BLOCK, Transport::Tcp);
        }
    }

    fn at(&mut self, time: Micros, step: Step) {
        self.number += 1;
        self.agenda.insert((time, self.number, step));
    }

    fn go(&mut self) {
        loop {
            let next = self.agenda.first().map_or(Micros::MAX, |(time, ..)| *time);
            let until = next.min(self.run.time);
            if let Some(outcome) = self.radio.poll(until) {
                // Nothing is lost but with its connection, which is never closed here.
                if let Some((trip, is_reply)) = self.on_air.remove(&outcome.message) {
                    self.arrived(outcome.at, trip, is_reply);
                } else if outcome.to == self.beside {
                    self.blocks += 1;
                    self.send_block(outcome.at);
                }
                continue;
            }
            if next > self.run.time {
                return;
            }
            if let Some((now, _, step)) = self.agenda.pop_first() {
                self.step(now, step);
            }
        }
    }

    fn arrived(&mut self, now: Micros, trip: Trip, is_reply: bool) {
        if is_reply {
            let done = self.base_works(now);
            self.at(done, Step::Read(trip));
        } else if let Some(free) = self.robot_free.get_mut(trip.robot) {
            *free = now.max(*free) + self.run.hosts.robot;
            let done = *free;
            self.at(done, Step::Reply(trip));
        }
    }

    /// When the base station is done with a command or a reply.
    fn base_works(&mut self, now: Micros) -> Micros {
        self.base_free = now.max(self.base_free) + self.run.hosts.base / 2;
        self.base_free
    }

    fn step(&mut self, now: Micros, step: Step) {
        match step {
            Step::Due(robot, kind) => self.due(now, robot, kind),
            Step::Command(trip) => self.send(now, trip, false),
            Step::Reply(trip) => self.send(now, trip, true),
            Step::Read(trip) => self.read(now, trip),
        }
    }

    fn due(&mut self, now: Micros, robot: usize, kind: Kind) {
        let again = match kind {
            Kind::Null => Some(NULL_PERIOD),
            Kind::Command => (self.run.style == Style::Concurrent).then_some(PERIOD),
        };
        if let Some(period) = again {
            self.at(now + period, Step::Due(robot, kind));
        }
        let mut due = now;
        if kind == Kind::Command {
            // A robot that has not answered the last one gets none, and this one is missed.
            if self.open.get(robot).copied().unwrap_or(true) {
                return;
            }
            self.open[robot] = true;
            if self.run.style == Style::Serial {
                due = self.round;
            }
        }
        let ready = self.base_works(now);
        self.at(ready, Step::Command(Trip { robot, kind, due }));
    }

    fn send(&mut self, now: Micros, trip: Trip, is_reply: bool) {
        let Some(robot) = self.robots.get(trip.robot).copied() else {
            return;
        };
        let (from, to, octets) = match is_reply {
            true => (robot, self.base, 2),
            false => (self.base, robot, trip.kind.octets()),
        };
        if let Ok(message) = self.radio.send(now, from, to, octets, Transport::Tcp) {
            self.on_air.insert(message, (trip, is_reply));
        }
    }

    fn read(&mut self, now: Micros, trip: Trip) {
        let took = (now - trip.due) as f64 / MS as f64;
        if trip.kind == Kind::Null {
            self.nulls.push(took);
            return;
        }
        self.commands.push(took);
        self.replied += 1;
        self.in_time += u64::from(now - trip.due <= PERIOD);
        if let Some(open) = self.open.get_mut(trip.robot) {
            *open = false;
        }
        if self.run.style == Style::Serial {
            let next = (trip.robot + 1) % self.run.robots;
            let mut start = now;
            if next == 0 {
                self.round = now.max(self.round + PERIOD);
                start = self.round;
            }
            self.at(start, Step::Due(next, Kind::Command));
        }
    }

    fn end(self) -> Came {
        let seconds = self.run.time as f64 / SECOND as f64;
        let robots = self.run.robots as u64;
        let due = if self.run.commands {
            robots * (self.run.time / PERIOD) as u64
        } else {
            0
        };
        // What was due last has no reply yet.
        let unfinished = self.open.iter().filter(|open| **open).count() as u64;
        Came {
            nulls: Times::new(self.nulls),
            commands: Times::new(self.commands),
            due,
            missed: due.saturating_sub(self.in_time + unfinished),
            busy: self.radio.counts().busy as f64 / self.run.time as f64,
            rate: self.replied as f64 / seconds / robots as f64,
            file: self.blocks as f64 * f64::from(BLOCK) * 8.0 / 1e6 / seconds,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(crate) fn run(robots: usize, style: Style, hosts: Hosts) -> Run {
        Run {
            robots,
            rate: 2_000_000,
            style,
            commands: true,
            nulls: false,
            hosts,
            file: false,
            loss: Loss::None,
            time: 20 * SECOND,
            seed: 1,
        }
    }

    #[test]
    fn a_robot_alone_misses_nothing() {
        for style in [Style::Serial, Style::Concurrent] {
            let came = run(1, style, Hosts::default()).simulate();
            assert_eq!((came.missed, came.due), (0, 200), "{style:?}");
            assert!((came.rate - 10.0).abs() < 0.1, "{}", came.rate);
            // Two frames of 560 and 504 µs, SIFS, acknowledgement, DIFS, and 0 to 31 slots.
            let (least, most) = (0.56 + 0.314 + 0.05 + 0.504, 0.02 + 0.62);
            assert!(
                came.commands.at(0.0) >= least && came.commands.at(1.0) <= least + most,
                "{:?}",
                came.commands
            );
        }
    }

    #[test]
    fn a_base_station_that_waits_reaches_one_round_trip_after_the_other() {
        let hosts = Hosts {
            robot: 2000,
            base: 2000,
        };
        let came = run(40, Style::Serial, hosts).simulate();
        // While computers compute, acknowledgement and backoff pass.
        let trip = 4.0 + 0.56 + 0.504;
        let expected = 1000.0 / trip / 40.0;
        assert!(
            (came.rate / expected - 1.0).abs() < 0.1,
            "{} {expected}",
            came.rate
        );
        assert!(came.missed > 0);
        let together = run(40, Style::Concurrent, hosts).simulate();
        assert!(together.rate > 2.0 * came.rate, "{}", together.rate);
    }

    #[test]
    fn a_file_takes_most_of_the_air_and_delays_commands() {
        let alone = run(5, Style::Concurrent, Hosts::default());
        let beside = Run {
            file: true,
            ..alone.clone()
        };
        let (alone, beside) = (alone.simulate(), beside.simulate());
        assert!(
            beside.file > 0.5 && beside.busy > 2.0 * alone.busy,
            "{}",
            beside.file
        );
        assert!(beside.commands.at(0.5) > alone.commands.at(0.5));
        assert_eq!(alone.file, 0.0);
    }

    #[test]
    fn the_same_seed_gives_the_same_times() {
        let twice = [(); 2].map(|()| run(7, Style::Concurrent, Hosts::default()).simulate().commands.0);
        assert_eq!(twice[0], twice[1]);
    }
}
