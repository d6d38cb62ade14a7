//! The program at the middle that follows a path by the poses that come back, the robot's body, and who measures how far off it is.

use fastrand::Rng;
use mom_cubo::model::LAYOUT;
use mom_cubo::model::elements::{
    Joints, LeftWheel, Lips, Microphone, Pose as PoseSensor, Posture, RightWheel, Speaker, Surroundings,
};
use mom_rsp::middle::{Middle, Notice};
use mom_rsp::robot::Body;
use mom_rsp::typed::Named as _;
use mom_rsp::{Direction, Header, Item, Items, Type};
use mom_wheels::{Chassis, Driver as _, Floor, Motors, Pose, Power, SetupError, Simulated};

use super::super::world::{End, Scene};
use super::super::{MS, SECOND};
use super::track::{Progress, SPEED, Track};

/// µs between two measurements.
const TICK: u64 = 10 * MS;
/// mm off the path from which on a robot is lost.
const ASTRAY: f64 = 1000.0;
/// At the beginning a robot is off by up to so much: mm to either side, degrees.
const OFFSET: [f64; 2] = [20.0, 5.0];
const FLOOR: Floor = Floor {
    width: 6000.0,
    depth: 6000.0,
};

/// How a drive ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    Done,
    /// More than 1 m off the path.
    Astray,
    /// In twice the time that it should take.
    Late,
}

/// What was measured on a drive.
#[derive(Clone, Debug)]
pub(super) struct Drove {
    pub(super) outcome: Outcome,
    /// mm off the path: root of the mean square, and the most.
    pub(super) rms: f64,
    pub(super) worst: f64,
    /// ms, the mean age of the pose by which the middle steers.
    pub(super) age: f64,
    /// Where it went, m.
    pub(super) trace: Vec<(f64, f64)>,
}

pub(super) struct Follower {
    random: Rng,
    track: Track,
    /// Values reach the wheels through the motion filter, or as they arrive.
    filter: bool,
    /// All packets have all elements.
    fixed: bool,
    wheels: Simulated,
    speeds: [i16; 2],
    now: u64,
    tick: u64,
    /// Since when it is steered.
    began: Option<u64>,
    /// The stamp of the newest pose, ms.
    stamp: u32,
    believed: Progress,
    truth: Progress,
    samples: f64,
    squares: f64,
    worst: f64,
    ages: f64,
    trace: Vec<(f64, f64)>,
    outcome: Option<Outcome>,
}

impl Follower {
    pub(super) fn new(track: &Track, filter: bool, fixed: bool, seed: u64) -> Result<Follower, SetupError> {
        let mut random = Rng::with_seed(seed);
        let [x, y] = track.start();
        let [side, turn] = OFFSET.map(|most| most * (2.0 * random.f64() - 1.0));
        let pose = Pose::new(x, y + side, turn);
        Ok(Follower {
            random,
            track: track.clone(),
            filter,
            fixed,
            wheels: Simulated::new(Chassis::CUBO, Power::LINUXBOT, FLOOR, pose)?,
            speeds: [0; 2],
            now: 0,
            tick: 0,
            began: None,
            stamp: 0,
            believed: Progress::default(),
            truth: Progress::default(),
            samples: 0.0,
            squares: 0.0,
            worst: 0.0,
            ages: 0.0,
            trace: Vec::new(),
            outcome: None,
        })
    }

    pub(super) fn is_over(&self) -> bool {
        self.outcome.is_some()
    }

    /// What came of it; one that is not over is late, and of one that never began no figure is a number.
    pub(super) fn drove(self) -> Drove {
        let samples = self.samples;
        Drove {
            outcome: self.outcome.unwrap_or(Outcome::Late),
            rms: (self.squares / samples).sqrt(),
            worst: if samples > 0.0 { self.worst } else { f64::NAN },
            age: self.ages / samples,
            trace: self.trace,
        }
    }

    /// The middle has a new pose.
    fn steer(&mut self, now: u64, middle: &mut Middle<'_>) {
        let Some(reading) = middle.read(PoseSensor::PLACE) else {
            return;
        };
        let &[x0, x1, y0, y1, h0, h1] = reading.value else {
            return;
        };
        self.stamp = reading.stamp;
        let [x, y, heading] =
            [[x0, x1], [y0, y1], [h0, h1]].map(|bytes| f64::from(i16::from_be_bytes(bytes)));
        self.began = self.began.or(Some(now));
        self.believed.update(&self.track, x, y);
        let pose = Pose::new(x, y, heading / 10.0);
        let [left, right] = match self.believed.is_done(&self.track) {
            true => [0, 0],
            false => self.believed.steer(&self.track, pose),
        };
        // Without a session nothing can be said, and the robot rests.
        let _ = middle.write(LeftWheel::PLACE, &left.to_be_bytes());
        let _ = middle.write(RightWheel::PLACE, &right.to_be_bytes());
    }

    /// A wheel has a new speed, mm/s.
    fn turn(&mut self, element: u8, value: &[u8]) {
        let &[high, low] = value else { return };
        let speed = i16::from_be_bytes([high, low]);
        let [left, right] = &mut self.speeds;
        match element {
            LeftWheel::PLACE => *left = speed,
            RightWheel::PLACE => *right = speed,
            _ => return,
        }
        let per_mille = |speed: i16| (f64::from(speed) / Chassis::CUBO.full_speed * 1000.0).round() as i16;
        let motors = Motors::new(per_mille(self.speeds[0]), per_mille(self.speeds[1]));
        // Its battery lasts longer than any drive.
        let _ = self.wheels.set_motors(motors, self.now.cast_signed());
    }

    fn measure(&mut self, now: u64) {
        let pose = self.wheels.pose(now.cast_signed());
        let error = self.truth.update(&self.track, pose.x, pose.y);
        let Some(began) = self.began.filter(|_| self.outcome.is_none()) else {
            return;
        };
        if (self.samples as u64).is_multiple_of(10) {
            self.trace.push((pose.x / 1000.0, pose.y / 1000.0));
        }
        self.samples += 1.0;
        self.squares += error * error;
        self.worst = self.worst.max(error);
        self.ages += f64::from(((now / MS) as u32).wrapping_sub(self.stamp));
        let longest = 2.0 * self.track.length() / SPEED * SECOND as f64 + 5e6;
        self.outcome = if self.truth.is_done(&self.track) {
            Some(Outcome::Done)
        } else if error > ASTRAY {
            Some(Outcome::Astray)
        } else if (now - began) as f64 > longest {
            Some(Outcome::Late)
        } else {
            None
        };
    }
}

impl Body for Follower {
    fn random(&mut self, bytes: &mut [u8]) {
        self.random.fill(bytes);
    }

    fn effector(&mut self, element: u8, value: &[u8]) {
        if self.filter {
            self.turn(element, value);
        }
    }

    fn command(&mut self, _: u8, _: &[u8]) {}
}

impl Scene for Follower {
    fn at_middle(&mut self, now: u64, middle: &mut Middle<'_>) {
        while let Some(notice) = middle.next_notice() {
            match notice {
                Notice::Up if self.fixed => {
                    let all: [(u8, &[u8]); 5] = [
                        (LeftWheel::PLACE, &[0; 2]),
                        (RightWheel::PLACE, &[0; 2]),
                        (Joints::PLACE, &[0; 6]),
                        (Lips::PLACE, &[0; 2]),
                        (Speaker::PLACE, &[0; 1956]),
                    ];
                    for (element, value) in all {
                        // There is a session: this was just said.
                        let _ = middle.write(element, value);
                    }
                }
                Notice::Changed {
                    element: PoseSensor::PLACE,
                } => self.steer(now, middle),
                _ => {}
            }
        }
    }

    fn at_robot(&mut self, now: u64, end: &mut impl End) {
        self.now = now;
        if now >= self.tick {
            self.tick = now + TICK;
            self.measure(now);
        }
        if end.wake().is_none_or(|wake| wake > now) {
            return;
        }
        let pose = self.wheels.pose(now.cast_signed());
        let pose = [pose.x, pose.y, pose.heading * 10.0].map(|part| (part.round() as i16).to_be_bytes());
        let mut told = end.set(PoseSensor::PLACE, &pose.concat());
        if self.fixed {
            let all: [(u8, &[u8]); 3] = [
                (Surroundings::PLACE, &[0; 12]),
                (Microphone::PLACE, &[0; 640]),
                (Posture::PLACE, &[0; 6]),
            ];
            for (element, value) in all {
                told = told.and(end.set(element, value));
            }
        }
        debug_assert!(told.is_ok(), "{told:?}");
    }

    fn reaches_robot(&mut self, now: u64, datagram: &[u8]) {
        self.now = now;
        let is_data = Header::decode(datagram).is_ok_and(|header| header.kind == Type::Data);
        if self.filter || !is_data {
            return;
        }
        let items = Items::parse(
            &LAYOUT,
            Direction::Down,
            datagram.get(Header::LEN..).unwrap_or_default(),
        );
        for (element, item) in items.into_iter().flatten() {
            if let Item::Value(value) = item {
                self.turn(element, value);
            }
        }
    }

    fn wake(&self) -> Option<u64> {
        Some(self.tick)
    }
}
