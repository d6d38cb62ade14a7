//! The controller: images in, commands out, time an argument.
//!
//! Phases follow one another; in each the hand goes to where the images say, and no phase that cannot be undone begins before
//! images of the resting hand have confirmed it. Motions need no such wait: what has been commanded and is not yet seen is
//! predicted, and a command corrects the one before it.

mod moving;
mod phases;
mod sight;

use std::collections::VecDeque;
use std::fmt;

use mom_vision::pose::{View, locate};

use crate::Micros;
use crate::aim::Miss;
use crate::eyes::Seen;
use crate::memory::Memory;
use crate::motion::Motion;
use crate::plan::Plan;
use crate::task::{NAMES, SIZE, Task};
use crate::track::{Noise, Track};

use sight::Sight;

pub use phases::Phase;
pub use sight::{BLIND, LATE, OLD, OLDEST, UNHEARD};

/// Nearer than this the blocks are aligned, mm.
pub const ALIGNED: f64 = 3.0;
/// Turned less than this their faces are parallel, degrees.
pub const PARALLEL: f64 = 4.0;
/// How often the block is put down at most.
const ATTEMPTS: u32 = 4;
/// The name for [`Servo::refused`] of a velocity that ended because the arm's program stood still, and nobody halted the arm.
pub const STOOD_STILL: &str = "stood-still";
/// How many may end so in one phase: more, and the machine of the arm is too slow to drive it.
const STOOD_STILL_AT_MOST: u32 = 8;
/// The longest time from a command to its begin that counts as usual, µs.
const MOST_USUAL: Micros = 1_200_000;

/// What the controller knows of the hand that no image shows, from the arm's state at the beginning.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hand {
    /// Spin and tilt, degrees: the marker is a ball and shows no turn.
    pub turned: [f64; 2],
    /// How far it may go from where it is, mm: the least and the greatest of x, y and z.
    pub room: [[f64; 2]; 3],
}

/// What to do next.
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// Send this command to the arm.
    Command(String),
    /// Nothing before the next image, or for some milliseconds.
    Wait,
    /// The blocks are aligned.
    Aligned,
    /// It cannot be done; why.
    Failed(String),
}

/// How far the work is.
#[derive(Debug, Clone, PartialEq)]
pub struct Progress {
    /// What is being done.
    pub phase: Phase,
    /// How far the hand or the block is from where it is to be.
    pub miss: Option<Miss>,
    /// How often the block was put down.
    pub attempts: u32,
    /// Commands sent.
    pub commands: u32,
    /// Age of the newest image, µs.
    pub image_age: Option<Micros>,
    /// From a command to its effect in the images, µs, and the deviation of that.
    pub command_delay: [Micros; 2],
    /// How far each camera's matrix is corrected, degrees.
    pub corrections: Vec<f64>,
    /// Where the first block is.
    pub first: Whereabouts,
    /// Why it goes carefully, if it does.
    pub careful: Option<String>,
}

/// Where a block is, as far as is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Whereabouts {
    /// Between the jaws.
    InJaws,
    /// On the table, mm, as seen so many µs ago.
    OnTable {
        /// x and y, mm, by the cameras.
        place: [f64; 2],
        /// µs since it was seen.
        age: Micros,
    },
    /// Put down there, mm, so many µs ago, and not seen since.
    PutDown {
        /// x and y, mm, by the cameras.
        place: [f64; 2],
        /// µs since it was let go.
        age: Micros,
    },
    /// It was not seen.
    Unknown,
}

/// The controller of one task.
#[derive(Debug, Clone)]
pub struct Servo {
    task: Task,
    hand: Hand,
    memory: Memory,
    track: Track,
    motion: Motion,
    sight: Sight,
    plan: Option<Plan>,
    phase: Phase,
    /// When the phase began.
    since: Micros,
    /// Whether it has gone carefully since then.
    slowed: bool,
    /// When the last command was sent, and whether that goes as far as one can.
    sent: Option<(Micros, bool)>,
    /// When the hand was told to move last.
    last_jog: Option<Micros>,
    /// When the newest commands were sent, by their numbers.
    sent_at: VecDeque<(u32, Micros)>,
    /// From the sending of the first command that the arm told the begin of to that.
    usual: Option<Micros>,
    /// Whether the jaws were told to move, and when.
    jaws: Option<Micros>,
    /// Whether the jaws hold the first block.
    held: bool,
    /// Whether the hand met something, so that it goes up first.
    met: bool,
    /// Where the block was let go, and when.
    put: Option<([f64; 2], Micros)>,
    /// Where the block lies in the hand, mm across the jaw line.
    across: f64,
    /// How far the hand is from where its marker says, mm on the table, and by how many degrees; learned from what was put down.
    bias: [f64; 3],
    /// z of the way at which the block was taken.
    taken_at: f64,
    /// Whether the block met the table after the jaws were told to open.
    touched: bool,
    /// Where a way that no image leads ends.
    blind: Option<[f64; 5]>,
    miss: Option<Miss>,
    attempts: u32,
    /// Velocities of this phase that ended because the arm's program stood still.
    late: u32,
    commands: u32,
    newest: Option<Micros>,
    now: Micros,
    end: Option<Action>,
}

impl Servo {
    /// A controller that has seen nothing.
    #[must_use]
    pub fn new(task: Task, hand: Hand, now: Micros) -> Servo {
        Servo {
            task,
            hand,
            memory: Memory::default(),
            track: Track::new(hand.turned),
            motion: Motion::new(now),
            sight: Sight::default(),
            plan: None,
            phase: Phase::Look,
            since: now,
            slowed: false,
            sent: None,
            last_jog: None,
            sent_at: VecDeque::new(),
            usual: None,
            jaws: None,
            held: false,
            met: false,
            put: None,
            across: 0.0,
            bias: [0.0; 3],
            taken_at: 0.0,
            touched: false,
            blind: None,
            miss: None,
            attempts: 0,
            late: 0,
            commands: 0,
            newest: None,
            now,
            end: None,
        }
    }

    /// The same for links and machines that are not regular.
    #[must_use]
    pub fn expecting(mut self, noise: Noise) -> Servo {
        self.track.expect(noise);
        self
    }

    /// The round trip to the hub, µs: nothing is known sooner.
    pub fn round_trip(&mut self, round_trip: Micros) {
        self.sight.round_trip(round_trip);
        self.track
            .no_sooner_than(self.usual.unwrap_or(0).max(round_trip / 2));
    }

    /// Takes what an image shows.
    pub fn see(&mut self, seen: &Seen) {
        self.newest = self.newest.max(Some(seen.taken));
        self.sight
            .picture(seen.camera, seen.shows, seen.error, seen.marker.is_some());
        self.track.meet(seen.camera, &seen.projection);
        // Where times are not what they are said to be, only a hand that rests is where it is said to be.
        let rests = self.rests() && !self.sight.is_unheard() && seen.shows >= self.settled();
        if let Some(pixel) = seen.marker.filter(|_| rests || self.sight.careful().is_none()) {
            self.track
                .see(seen.camera, [seen.taken, seen.shows], pixel, &self.motion);
            self.track.fit(&self.motion);
            match self.track.absurd() {
                Some(why) => {
                    self.sight.doubt(why, self.now);
                    self.track.forget_times();
                }
                None if rests && self.track.fits() => self.sight.trust(self.commands),
                None => {}
            }
        }
        // What was taken before the hand stood away may show it in front of the blocks.
        if self.phase == Phase::Check && seen.taken < self.settled() {
            return;
        }
        let carried = (self.held || self.phase.hides_first()).then_some(self.task.first);
        let among = !matches!(self.phase, Phase::Look | Phase::Check);
        if let Some(projection) = self.track.projection(seen.camera) {
            self.memory.see(seen, projection, carried, among);
        }
        self.memory.correct(&self.track);
    }

    /// The arm has begun the command with this number (counted from 1) at this time. What begins later or sooner than the first one did
    /// counts as sent later or sooner, so that the delay is one and the same.
    pub fn begun(&mut self, number: u32, at: Micros) {
        let Some(sent) = self
            .sent_at
            .iter()
            .find(|(known, _)| *known == number)
            .map(|(_, at)| *at)
        else {
            return;
        };
        self.sight.heard(number, self.now);
        // Nothing begins before it is sent, whatever two clocks say.
        let at = at.max(sent);
        let usual = *self.usual.get_or_insert((at - sent).min(MOST_USUAL));
        self.track.no_sooner_than(usual);
        self.motion.begun(number, at - usual);
    }

    /// The jaws have come to the end of what they were told; whether they hold anything.
    pub fn jaws_ended(&mut self, holding: bool, now: Micros) {
        self.now = self.now.max(now);
        self.sight.forget_commands();
        if self.jaws.take().is_some() {
            self.after_jaws(holding);
        }
    }

    /// The arm refused a command, or ended it with this error, at this time; at which it came to rest, where that is known.
    pub fn refused(&mut self, name: &str, text: &str, at: Micros, now: Micros) {
        self.now = self.now.max(now);
        self.sight.forget_commands();
        if name == "busy" && self.jaws.is_some() {
            // The jog before it has not ended; it is sent again.
            self.jaws = None;
            self.sent = Some((now, false));
            return;
        }
        if name == STOOD_STILL && self.late < STOOD_STILL_AT_MOST {
            // It stands, and nobody has halted it: the next command goes on from there.
            self.late += 1;
            self.motion.stood(at - self.usual.unwrap_or(0));
            self.sent = None;
            return;
        }
        let touches_down = self.touches_down(at);
        self.motion.halt(now);
        if name == "torque-overload" && touches_down {
            // If the jaws were told already, that may end with it.
            self.touched = self.phase == Phase::Release;
            if self.phase == Phase::Lower {
                self.enter(Phase::Release);
            }
            return;
        }
        if name == "halted" && std::mem::take(&mut self.touched) {
            self.jaws = None;
            return;
        }
        let taking = matches!(self.phase, Phase::Approach | Phase::Descend);
        if name == "torque-overload" && taking && self.attempts + 1 < ATTEMPTS {
            // It met something, which may lie elsewhere now: up, and all is looked at anew.
            self.attempts += 1;
            self.track.forget();
            self.memory = Memory::default();
            self.met = true;
            self.enter(Phase::Rise);
            return;
        }
        self.end = Some(Action::Failed(text.to_owned()));
    }

    /// What to do now.
    pub fn next(&mut self, now: Micros) -> Action {
        self.now = self.now.max(now);
        // A phase that is over may be followed by another at once.
        for _ in 0..8 {
            if let Some(end) = &self.end {
                return end.clone();
            }
            match self.step() {
                phases::Step::Wait => return Action::Wait,
                phases::Step::Send(command) => {
                    self.commands += 1;
                    self.track.count(self.commands);
                    self.sight.sent(self.commands, self.now);
                    self.sent_at.push_back((self.commands, self.now));
                    if self.sent_at.len() > 16 {
                        self.sent_at.pop_front();
                    }
                    return Action::Command(command);
                }
                phases::Step::Enter(phase) => self.enter(phase),
                phases::Step::End(action) => self.end = Some(action),
            }
        }
        Action::Wait
    }

    /// Lets time pass in which nothing is decided.
    pub fn pass(&mut self, now: Micros) {
        self.now = self.now.max(now);
    }

    /// Whether the task can be done, by what was seen until now.
    ///
    /// # Errors
    /// In words: what is not seen, and what is; what is in the way; what is outside the workspace.
    pub fn feasible(&mut self, now: Micros) -> Result<(), String> {
        self.pass(now);
        for block in [self.task.first, self.task.second] {
            if self.memory.noticed(block).is_none() {
                return Err(self.unseen(block));
            }
        }
        self.make_plan()
    }

    /// A block is not there; which are?
    fn unseen(&self, block: usize) -> String {
        let seen = NAMES.iter().enumerate().filter_map(|(index, (name, _))| {
            let age = (self.now - self.memory.noticed(index)?).max(0) as f64 / 1e6;
            Some(format!("{name}, {age:.1} s ago"))
        });
        let seen: Vec<String> = seen.collect();
        let name = NAMES[block].0;
        match seen.is_empty() {
            true => format!("{name} is not seen, nor any other block"),
            false => format!("{name} is not seen; there are {}", seen.join("; ")),
        }
    }

    /// How far the work is.
    #[must_use]
    pub fn progress(&self) -> Progress {
        Progress {
            phase: self.phase,
            miss: self.miss,
            attempts: self.attempts,
            commands: self.commands,
            image_age: self.sight.pictures_age(self.now),
            command_delay: [self.track.delay_micros(), self.track.delay_error_micros()],
            careful: self.sight.careful().map(str::to_owned),
            corrections: self.track.corrections(),
            first: self.whereabouts(),
        }
    }

    /// Where the first block is.
    #[must_use]
    pub fn whereabouts(&self) -> Whereabouts {
        if self.held {
            return Whereabouts::InJaws;
        }
        let known = self
            .memory
            .place(self.task.first)
            .zip(self.memory.noticed(self.task.first));
        match known {
            Some((local, noticed)) => Whereabouts::OnTable {
                place: local.place,
                age: (self.now - noticed).max(0),
            },
            None => match self.put {
                Some((place, at)) => Whereabouts::PutDown {
                    place,
                    age: (self.now - at).max(0),
                },
                None => Whereabouts::Unknown,
            },
        }
    }

    /// What is known of the blocks.
    #[must_use]
    pub fn memory(&self) -> &Memory {
        &self.memory
    }

    fn name(&self) -> &'static str {
        NAMES[self.task.first].0
    }
}

/// Why a block is not as it must be, from the images of all cameras: it stands on something.
#[must_use]
pub fn stands_high(seen: &[Seen], block: usize) -> Option<f64> {
    let views: Vec<View<'_>> = seen
        .iter()
        .filter_map(|seen| {
            let sighting = seen.blocks.get(block)?.as_ref()?;
            Some(View {
                projection: &seen.projection,
                sighting,
            })
        })
        .collect();
    // Where the cameras disagree, they do not tell.
    let pose = locate(SIZE, &views, None).ok().filter(|_| views.len() > 1)?;
    let height = pose.place[2] - SIZE / 2.0;
    (height > 15.0 && height > 4.0 * pose.error).then_some(height)
}

impl fmt::Display for Whereabouts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Whereabouts::InJaws => f.write_str("is in the jaws"),
            Whereabouts::OnTable { place: [x, y], age } => {
                let seconds = *age as f64 / 1e6;
                write!(
                    f,
                    "stands on the table near {x:.0} {y:.0}, seen {seconds:.1} s ago"
                )
            }
            Whereabouts::PutDown { place: [x, y], age } => {
                let seconds = *age as f64 / 1e6;
                write!(f, "was put down near {x:.0} {y:.0}, {seconds:.1} s ago")
            }
            Whereabouts::Unknown => f.write_str("was not seen"),
        }
    }
}
