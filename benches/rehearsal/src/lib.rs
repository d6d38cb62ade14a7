//! A rehearsal of the servo agent: its controller, the simulated arm, and the pictures that the lab's cameras draw, in virtual time.
//!
//! Commands reach the arm late, and images the controller; the cameras say matrices that are wrong by a rotation; and more goes wrong
//! where [`Trouble`] says so. The same seed gives the same rehearsal.

mod way;

use std::collections::VecDeque;

use fastrand::Rng;
use mom_arm::blocks::Blocks;
use mom_arm::workspace::WORKSPACE;
use mom_arm::{Arm, ArmEvent, ArmState, Block, CommandState, Pose};
use mom_camera::{CameraSettings, Renderer, Scene, View};
use mom_device::{DeviceError, ErrorName};
use mom_servo::Micros;
use mom_servo::control::{Action, Hand, Progress, STOOD_STILL, Servo};
use mom_servo::eyes::Seen;
use mom_servo::task::{NAMES, SIZE, Side, Task};
use mom_servo::track::turned;
use mom_vision::{Picture, Projection};
use nalgebra::Vector3;

use way::Way;

/// µs between two looks of the controller.
const LOOK: Micros = 50_000;
/// States that an image may show: three seconds of them.
const MOST_STATES: usize = 60;
/// The cameras in their order.
const VIEWS: [View; 3] = [View::X, View::Y, View::Top];

/// One start.
#[derive(Debug, Clone)]
pub struct Start {
    /// What is to be done.
    pub task: Task,
    /// Where the blocks lie.
    pub blocks: Vec<Block>,
    /// Where the hand is.
    pub hand: Pose,
    /// How far off each camera's matrix is, a rotation vector in radians.
    pub wrong: [[f64; 3]; 3],
    /// µs on the way of commands and of their ends, and on that of images.
    pub delay: Micros,
    /// µs by which each command may be later than that; none overtakes another.
    pub jitter: Micros,
    /// µs between two images of a camera.
    pub period: Micros,
    /// What else goes wrong.
    pub trouble: Trouble,
}

/// What goes wrong on the way, as on a machine that has too much to do.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Trouble {
    /// The share of images that are lost.
    pub dropped: f64,
    /// µs between two times in which nothing arrives, neither images nor commands, and how long these are at most. What was on its way
    /// arrives at once after it.
    pub frozen: [Micros; 2],
    /// µs between two times in which the arm's program stands still, and how long it does.
    pub stands: [Micros; 2],
    /// µs by which the state that an image shows is older than the image, at most.
    pub stale: Micros,
    /// µs by which the times of images are wrong, at most.
    pub wrong: Micros,
    /// s after which the images of all cameras but one end.
    pub blind: Option<f64>,
    /// Other ones of the same kind.
    pub seed: u64,
}

/// How it ended.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// Why it failed, if it did.
    pub failure: Option<String>,
    /// mm of the first block's middle from its place, in truth.
    pub error: f64,
    /// Degrees between the faces, in truth.
    pub turned: f64,
    /// s.
    pub seconds: f64,
    /// What the controller said last.
    pub progress: Progress,
    /// Whether the hand was always inside the workspace.
    pub inside: bool,
    /// Images that were looked at.
    pub images: usize,
    /// mm by which the tip was off the straight way of its phase, at most, in truth.
    pub stray: f64,
    /// s from the last image by which two cameras had brought one, until it ended.
    pub unseen: f64,
}

impl Start {
    /// Three blocks, apart from each other, the first and the second of them to be aligned at a random side; a random pose of the
    /// hand above them; matrices off by up to so many degrees.
    #[must_use]
    pub fn random(random: &mut Rng, degrees: f64, delay: Micros) -> Start {
        let between = |random: &mut Rng, low: f64, high: f64| low + random.f64() * (high - low);
        loop {
            let mut places: Vec<[f64; 2]> = Vec::new();
            while places.len() < 3 {
                let place = [between(random, -170.0, 170.0), between(random, -170.0, 170.0)];
                let free = |other: &[f64; 2]| (place[0] - other[0]).hypot(place[1] - other[1]) > 120.0;
                if places.iter().all(free) {
                    places.push(place);
                }
            }
            let blocks = places.iter().enumerate().map(|(i, place)| {
                let (name, colour) = NAMES[i];
                Block::new(name, colour, place[0], place[1], random.f64() * 90.0)
            });
            let blocks: Vec<Block> = blocks.collect();
            let task = Task {
                first: 0,
                second: 1,
                side: Side::ALL[random.usize(0..4)],
                gap: between(random, 10.0, 40.0),
            };
            let goal = goal(&task, &blocks[1]);
            let far = (goal[0] - places[2][0]).hypot(goal[1] - places[2][1]);
            if far < 110.0 || goal.iter().any(|part| part.abs() > 250.0) {
                continue;
            }
            let hand = Pose::new(
                between(random, -200.0, 200.0),
                between(random, -200.0, 200.0),
                between(random, 120.0, 300.0),
                between(random, -40.0, 130.0),
                between(random, -10.0, 10.0),
            );
            let wrong = [(); 3].map(|()| {
                let way = Vector3::new(random.f64() - 0.5, random.f64() - 0.5, random.f64() - 0.5);
                let way = way.try_normalize(1e-6).unwrap_or(Vector3::x());
                (way * (random.f64() * degrees).to_radians()).into()
            });
            return Start {
                task,
                blocks,
                hand,
                wrong,
                delay,
                jitter: 0,
                period: 500_000,
                trouble: Trouble::default(),
            };
        }
    }

    /// Rehearses it, for at most so many seconds of its own time.
    #[must_use]
    pub fn rehearse(&self, seconds: i64) -> Outcome {
        Rehearsal::new(self).run(seconds * 1_000_000)
    }
}

/// Where the first block is to be, in truth.
fn goal(task: &Task, second: &Block) -> [f64; 2] {
    let axis = second.yaw + 90.0 * ((task.side.degrees() - second.yaw) / 90.0).round();
    let (sin, cos) = axis.to_radians().sin_cos();
    let far = SIZE + task.gap;
    [second.x + far * cos, second.y + far * sin]
}

/// Sent by the controller, or told by the arm, and not yet there.
struct Rehearsal<'a> {
    start: &'a Start,
    arm: Arm,
    servo: Servo,
    eyes: Vec<Renderer>,
    commands: VecDeque<(Micros, u64, String)>,
    /// By how much each is later than the delay.
    lateness: Rng,
    /// The commands to the jaws.
    grips: Vec<u64>,
    ends: VecDeque<(Micros, End)>,
    images: VecDeque<(Micros, Seen)>,
    looked: usize,
    inside: bool,
    trouble: Rng,
    /// When nothing arrives next, and until when nothing does.
    freezes: Micros,
    thaws: Micros,
    /// When the arm's program stands still next, or since when it does.
    stands: Micros,
    /// The arm's newest states.
    states: VecDeque<(Micros, ArmState)>,
    way: Way,
    /// When the newest image of each camera came.
    brought: [Micros; 3],
}

/// What the arm tells of a command.
enum End {
    Begun(u32, Micros),
    Jaws(bool),
    Error(String, String, Micros),
}

impl<'a> Rehearsal<'a> {
    fn new(start: &'a Start) -> Rehearsal<'a> {
        let lying = Blocks::new(start.blocks.clone());
        let mut arm = Arm::with_blocks(0, lying.all().to_vec());
        let mut events = Vec::new();
        let Pose { x, y, z, spin, tilt } = start.hand;
        // It is there before the time begins.
        let submitted = arm.submit(
            u64::MAX,
            &format!("move {x} {y} {z} {spin} {tilt}"),
            -20_000_000,
            &mut events,
        );
        debug_assert!(submitted.is_ok(), "{submitted:?}");
        while let Some(due) = arm.next_wake() {
            arm.advance(due, &mut events);
        }
        let pose = arm.state().pose;
        let room = [
            (pose.x, &WORKSPACE.x),
            (pose.y, &WORKSPACE.y),
            (pose.z, &WORKSPACE.z),
        ];
        let hand = Hand {
            turned: [pose.spin, pose.tilt],
            room: room.map(|(at, range)| [range.start() - at, range.end() - at]),
        };
        let settings = CameraSettings::default();
        let eyes = VIEWS
            .into_iter()
            .filter_map(|view| Renderer::new(view, settings).ok());
        Rehearsal {
            start,
            arm,
            servo: Servo::new(start.task.clone(), hand, 60_000_000),
            eyes: eyes.collect(),
            commands: VecDeque::new(),
            lateness: Rng::with_seed(1),
            grips: Vec::new(),
            ends: VecDeque::new(),
            images: VecDeque::new(),
            looked: 0,
            inside: true,
            trouble: Rng::with_seed(start.trouble.seed),
            freezes: 62_000_000,
            thaws: 0,
            stands: 62_000_000,
            states: VecDeque::new(),
            way: Way::default(),
            brought: [60_000_000; 3],
        }
    }

    fn run(mut self, limit: Micros) -> Outcome {
        // The arm has come to rest long before.
        let begin: Micros = 60_000_000;
        let mut now = begin;
        let mut count = 0;
        let failure = loop {
            if self.freeze(now) {
                self.advance(now);
            } else {
                self.arrive(now);
            }
            let state = self.arm.state();
            self.way.go(&self.servo.progress(), &state, self.start);
            if self.start.trouble.stale > 0 {
                self.states.push_back((now, state));
                if self.states.len() > MOST_STATES {
                    self.states.pop_front();
                }
            }
            if (now - begin) % self.start.period < LOOK {
                self.photograph(now);
            }
            match self.servo.next(now) {
                Action::Command(command) => {
                    count += 1;
                    if command.starts_with("grip") {
                        self.grips.push(count);
                    }
                    let late = self.lateness.i64(0..=self.start.jitter);
                    let last = self.commands.back().map_or(Micros::MIN, |(at, ..)| *at);
                    let at = (now + self.start.delay + late).max(last);
                    self.commands.push_back((at, count, command));
                    continue;
                }
                Action::Wait => {}
                Action::Aligned => break None,
                Action::Failed(why) => break Some(why),
            }
            if now - begin > limit {
                break Some("it takes too long".to_owned());
            }
            now += LOOK;
        };
        self.outcome(failure, now - begin)
    }

    /// Whether nothing arrives now.
    fn freeze(&mut self, now: Micros) -> bool {
        let [between, longest] = self.start.trouble.frozen;
        if longest > 0 && now >= self.freezes.max(self.thaws) {
            self.thaws = now + self.trouble.i64(0..=longest);
            self.freezes = self.thaws + self.trouble.i64(0..=2 * between);
        }
        now < self.thaws
    }

    /// Whether the arm's program stands still.
    fn stands_still(&mut self, now: Micros) -> bool {
        let [between, time] = self.start.trouble.stands;
        if time == 0 || now < self.stands {
            return false;
        }
        if now < self.stands + time {
            return true;
        }
        self.stands += time + between;
        false
    }

    fn advance(&mut self, now: Micros) {
        let mut events = Vec::new();
        self.arm.advance(now, &mut events);
        self.note(&events, now);
    }

    /// What was on its way until now.
    fn arrive(&mut self, now: Micros) {
        let stands_still = self.stands_still(now);
        while !stands_still && self.commands.front().is_some_and(|(at, ..)| *at <= now) {
            let Some((at, id, command)) = self.commands.pop_front() else {
                break;
            };
            let still = self.stands - self.start.trouble.stands[0];
            let at = at.max(self.thaws).max(still.min(now));
            let mut events = Vec::new();
            self.arm.advance(at, &mut events);
            if let Err(error) = self.arm.submit(id, &command, at, &mut events) {
                let end = told(&error, at);
                self.ends.push_back((at + self.start.delay, end));
            }
            self.note(&events, at);
        }
        if !stands_still {
            self.advance(now);
        }
        while self.ends.front().is_some_and(|(at, _)| *at <= now) {
            match self.ends.pop_front() {
                Some((_, End::Begun(number, at))) => self.servo.begun(number, at),
                Some((_, End::Jaws(holding))) => self.servo.jaws_ended(holding, now),
                Some((_, End::Error(name, text, at))) => self.servo.refused(&name, &text, at, now),
                None => {}
            }
        }
        while self.images.front().is_some_and(|(at, _)| *at <= now) {
            if let Some((_, seen)) = self.images.pop_front() {
                self.brought[seen.camera] = now;
                self.servo.see(&seen);
            }
        }
    }

    fn note(&mut self, events: &[ArmEvent], now: Micros) {
        for event in events {
            match event {
                ArmEvent::State(state) => self.inside &= WORKSPACE.check(&state.pose).is_ok(),
                ArmEvent::Command {
                    state: CommandState::Error,
                    error: Some(error),
                    ..
                } => {
                    let end = told(error, now);
                    self.ends.push_back((now + self.start.delay, end));
                }
                ArmEvent::Command {
                    id,
                    state: CommandState::Finished,
                    ..
                } if self.grips.contains(id) => {
                    let holding = self.arm.state().holding.is_some();
                    self.ends.push_back((now + self.start.delay, End::Jaws(holding)));
                }
                ArmEvent::Command {
                    id,
                    state: CommandState::Executing,
                    ..
                } => {
                    let begun = End::Begun(u32::try_from(*id).unwrap_or(u32::MAX), now);
                    self.ends.push_back((now + self.start.delay, begun));
                }
                ArmEvent::Command { .. } => {}
            }
        }
    }

    fn photograph(&mut self, now: Micros) {
        let now_shown = self.arm.state();
        let lag = self.trouble.i64(0..=self.start.trouble.stale);
        let older = self.states.iter().rev().find(|(at, _)| *at <= now - lag);
        // A robot that rests tells nothing new.
        let (shows, state) = match older {
            Some((at, state)) if lag > 0 && state.pose != now_shown.pose => (*at, state.clone()),
            _ => (now, now_shown),
        };
        let scene = scene(&state);
        for (camera, eye) in self.eyes.iter().enumerate() {
            let image = eye.render(&scene);
            let wrong = Vector3::from(self.start.wrong[camera]);
            let projection = Projection::new(image.matrix).and_then(|right| turned(&right, &wrong));
            let (Some(projection), Ok(picture)) = (projection, Picture::decode(&image.bytes)) else {
                continue;
            };
            self.looked += 1;
            let trouble = self.start.trouble;
            let ended = trouble.blind.is_some_and(|after| now as f64 / 1e6 - 60.0 > after);
            if (ended && camera > 0) || self.trouble.f64() < trouble.dropped {
                continue;
            }
            let wrong = self.trouble.i64(-trouble.wrong..=trouble.wrong);
            let seen = Seen {
                shows: shows + wrong,
                error: trouble.wrong,
                ..Seen::look(camera, now + wrong, projection, &picture)
            };
            self.images.push_back((now + self.start.delay, seen));
        }
    }

    /// When the second newest image of all cameras came.
    fn second_newest(&self) -> Micros {
        let mut brought = self.brought;
        brought.sort_unstable();
        brought[1]
    }

    fn outcome(self, failure: Option<String>, took: Micros) -> Outcome {
        let state = self.arm.state();
        let task = &self.start.task;
        let (first, second) = (&state.blocks[task.first], &state.blocks[task.second]);
        let goal = goal(task, second);
        let turned = first.yaw - second.yaw;
        Outcome {
            failure,
            error: (first.x - goal[0]).hypot(first.y - goal[1]),
            turned: (turned - 90.0 * (turned / 90.0).round()).abs(),
            seconds: took as f64 / 1e6,
            progress: self.servo.progress(),
            inside: self.inside,
            images: self.looked,
            stray: self.way.stray,
            unseen: (60_000_000 + took - self.second_newest()) as f64 / 1e6,
        }
    }
}

/// What the agent makes of an error of the arm.
fn told(error: &DeviceError, at: Micros) -> End {
    let name = match error.name() {
        ErrorName::Halted if error.may_be_retried() => STOOD_STILL.to_owned(),
        name => name.to_string(),
    };
    let late = Micros::from(error.late().unwrap_or(0)) * 1000;
    End::Error(name, error.text().to_owned(), at - late)
}

/// What the cameras draw.
fn scene(state: &ArmState) -> Scene {
    // The same words as on the wire.
    let text = serde_json::to_string(state).unwrap_or_default();
    serde_json::from_str(&text).unwrap_or_default()
}
