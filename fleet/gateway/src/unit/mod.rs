//! One robot as its gateway knows it: what statements become on the wire, and what replies say of it.

use std::collections::VecDeque;

use mom_brs::{Code, Command, Frame, Table};
use mom_client::{Card, Map};
use mom_device::{DeviceError, DeviceTime, ErrorName, Machine, Sample, Script, Word, Words};
use mom_linuxbot::Status;
use mom_wheeled::Action;

mod orders;
#[cfg(test)]
mod tests;

use orders::frames;

/// µs between two questions for pose and status while the robot moves. They feed its watchdog too.
const LIVELY: DeviceTime = 100_000;
/// µs between them while it stands.
const CALM: DeviceTime = 1_000_000;
const ROUND_TRIP: &str = "round-trip";
/// µs that a robot may take to come to its rest.
const SETTLES: DeviceTime = 500_000;
/// The most questions that wait for their answers.
const MOST_ASKED: usize = 8;
/// One that moves and answers nothing for so long is given up, with what is under way to it: it would be carried out late.
const UNANSWERED: DeviceTime = 1_000_000;

/// A robot behind its gateway.
///
/// The gateway hands it the replies ([`Unit::heard`]) and whether the robot is connected ([`Unit::linked`],
/// [`Unit::lost`]), and sends what [`Unit::to_send`] gives. Its states are as old as its replies.
///
/// It stands when it has said so after it was told to. One that cannot be reached is not said to stand: another base station may
/// drive it, or its watchdog may not act.
#[derive(Debug, Clone)]
pub struct Unit {
    number: u32,
    table: &'static Table,
    /// µs since 1970 at time 0, if that is known.
    epoch: Option<i64>,
    now: DeviceTime,
    /// Whether the robot takes commands.
    linked: bool,
    /// Since when it does not, and why.
    unlinked: DeviceTime,
    why: Option<String>,
    /// Whether it has said on this connection where it is, as robots of ours do: the bits of its status are ours then.
    is_ours: bool,
    /// For how long the gateway was late altogether, so that nobody listened.
    late: DeviceTime,
    /// What is to be sent, in order.
    out: Vec<Frame>,
    /// What it did last say of itself, and when that was asked: what it says was so then or later.
    status: Option<Told>,
    pose: Option<(Pose, DeviceTime)>,
    /// When that came.
    posed: DeviceTime,
    /// Send times of outstanding requests, oldest first: replies come in the order of requests (W2).
    asked_status: VecDeque<Question>,
    asked_pose: VecDeque<DeviceTime>,
    /// The number of the next question for its status.
    question: u64,
    /// When it is asked next.
    ask: DeviceTime,
    /// The first question since it was told to stand: what it answers to that has to be that it does.
    stood: u64,
    /// Whether it is told to stand again with each question, as it has not answered yet that it does.
    insists: bool,
    /// Whether it has answered that it stands since it was reached, and since it was told to move.
    rests: bool,
    /// Until when it is asked as often as one that moves, because it may not have come to its rest yet.
    settles: DeviceTime,
    /// What it is doing.
    doing: Doing,
    /// Until when the motors are set; then they stop, unless the next statement sets them.
    motors: Option<Motors>,
    /// Whether it ever told of a charge: robots of others may have no such bits, and an empty battery is none of theirs.
    has_gauge: bool,
    leds: i32,
    /// The round trip, in µs, of the last question that was answered.
    round_trip: Option<DeviceTime>,
}

/// Where a robot says that it is: mm, mm, degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Pose {
    x: i32,
    y: i32,
    heading: i32,
}

/// What it said of itself.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Told {
    status: Status,
    /// Whether its bits are ours; else it says no more than that it answers.
    is_ours: bool,
    asked: DeviceTime,
}

/// A question for its status.
#[derive(Debug, Clone, Copy)]
struct Question {
    number: u64,
    at: DeviceTime,
    /// How late the gateway had been until then.
    late: DeviceTime,
}

/// Motors that were set.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Motors {
    until: DeviceTime,
    /// The status that was asked by this question, or a later one, tells of them.
    question: u64,
}

/// What the robot does of the statement that was begun last.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Doing {
    /// Nothing, or nothing is known of it.
    Nothing,
    /// It drives by itself. The status that was asked by this question, or a later one, tells of it.
    Drives { question: u64 },
    /// It is to show these LEDs, which is done when it is sent.
    Shows { leds: i32 },
    /// It is done then.
    Done { at: DeviceTime },
}

impl Unit {
    /// The robot of this number, of which nothing is known yet. It knows the commands of this table.
    #[must_use]
    pub fn new(number: u32, table: &'static Table) -> Self {
        Self {
            number,
            table,
            epoch: None,
            now: 0,
            linked: false,
            unlinked: 0,
            why: None,
            is_ours: false,
            late: 0,
            out: Vec::new(),
            status: None,
            pose: None,
            posed: 0,
            asked_status: VecDeque::new(),
            asked_pose: VecDeque::new(),
            question: 0,
            ask: 0,
            stood: 0,
            insists: false,
            rests: false,
            settles: 0,
            doing: Doing::Nothing,
            motors: None,
            has_gauge: false,
            leds: 0,
            round_trip: None,
        }
    }

    /// The same with the µs since 1970 at its time 0, so that it says since when a robot is not reached.
    #[must_use]
    pub fn with_epoch(mut self, epoch: i64) -> Self {
        self.epoch = Some(epoch);
        self
    }

    /// What is to be sent to the robot now, in order.
    pub fn to_send(&mut self) -> Vec<Frame> {
        std::mem::take(&mut self.out)
    }

    /// Whether something is to be sent.
    #[must_use]
    pub fn has_to_send(&self) -> bool {
        !self.out.is_empty()
    }

    /// Whether it may move and does not answer, so that its connection is to be given up.
    #[must_use]
    pub fn is_overdue(&self) -> bool {
        self.overdue_at().is_some_and(|due| self.now >= due)
    }

    fn overdue_at(&self) -> Option<DeviceTime> {
        let oldest = self.asked_status.front().filter(|_| self.drives())?;
        // A gateway that was stopped or had no processor did not hear its answers.
        let excused = self.late - oldest.late;
        Some(oldest.at.saturating_add(UNANSWERED).saturating_add(excused))
    }

    /// Whether it was told to move, or said last that it does.
    fn drives(&self) -> bool {
        let said = self
            .status
            .is_some_and(|told| told.status.moving || told.status.on_its_way);
        self.is_driven() || said
    }

    fn is_driven(&self) -> bool {
        self.motors.is_some() || matches!(self.doing, Doing::Drives { .. })
    }

    /// Whether it takes commands.
    #[must_use]
    pub fn is_linked(&self) -> bool {
        self.linked
    }

    /// Its connection is given up: what was asked is not answered any more.
    pub fn given_up(&mut self) {
        self.out.clear();
        self.asked_status.clear();
        self.asked_pose.clear();
    }

    /// What it said of itself, but for what changes with each reply: where it is, what its status tells, its LEDs, and whether it is
    /// linked.
    pub(crate) fn known(&self) -> (Option<Pose>, Option<Status>, i32, bool) {
        let pose = self.pose.map(|(pose, _)| pose);
        let status = self.status.map(|told| told.status);
        (pose, status, self.leds, self.linked)
    }

    /// The robot takes commands: it is told to stand, whatever it was doing, and asked how it is.
    pub fn linked(&mut self) {
        (self.linked, self.is_ours, self.why) = (true, false, None);
        self.stand();
        self.ask_now();
    }

    /// The robot could not be reached, for this reason.
    pub fn unreached(&mut self, why: &str) {
        self.why = Some(why.to_owned());
    }

    /// The robot's connection is lost, for this reason. What it does now is its own watchdog's business; what was known of it grows old.
    pub fn lost(&mut self, why: &str) {
        if self.linked {
            self.unlinked = self.now;
        }
        self.unreached(why);
        (self.linked, self.rests) = (false, false);
        self.given_up();
        self.doing = Doing::Nothing;
        self.motors = None;
    }

    /// Takes a reply of the robot; an error if it says that the command under way cannot be carried out.
    ///
    /// # Errors
    ///
    /// `obstacle` if a way was given up, `battery` if it is empty.
    pub fn heard(&mut self, reply: &Frame) -> Result<(), DeviceError> {
        match (reply.code(), reply.values()) {
            (Code::STATUS, &[bits]) => {
                let Some(asked) = self.asked_status.pop_front() else {
                    return Ok(());
                };
                self.round_trip = Some(self.now - asked.at);
                // The paper leaves the bits to each robot: what ours mean says nothing of others'.
                let status = match self.is_ours {
                    true => Status::from_bits(bits),
                    false => Status::default(),
                };
                self.status = Some(Told {
                    status,
                    is_ours: self.is_ours,
                    asked: asked.at,
                });
                self.has_gauge |= status.battery > 0;
                self.insist(status, asked.number);
                self.arrived(status, asked.number)
            }
            (Code::POSE, &[x, y, heading]) => {
                self.is_ours = true;
                if let Some(asked) = self.asked_pose.pop_front() {
                    self.pose = Some((Pose { x, y, heading }, asked));
                    self.posed = self.now;
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Has it stand again, if it was told to before it was asked, and says that it does not: whatever became of that order.
    fn insist(&mut self, status: Status, asked: u64) {
        if self.is_driven() || asked < self.stood {
            return;
        }
        if !(status.moving || status.on_its_way) {
            (self.insists, self.rests) = (false, true);
            return;
        }
        let doing = self.doing;
        self.stand();
        self.doing = doing;
        self.ask_now();
    }

    /// Takes note that all was sent that [`Unit::to_send`] gave, but for what failed. So a script of many LEDs says no more at
    /// once than may wait, and one of which some were refused is not finished.
    pub fn sent(&mut self) {
        if let Doing::Shows { leds } = self.doing {
            self.leds = leds;
            self.doing = Doing::Done { at: self.now };
        }
    }

    /// Takes note that a frame was not sent.
    pub fn unsent(&mut self, frame: &Frame) {
        match frame.code() {
            Code::STATUS => drop(self.asked_status.pop_back()),
            Code::POSE => drop(self.asked_pose.pop_back()),
            _ => {}
        }
    }

    /// Whether its way has ended, by a status that was asked after it began: an older one tells of what was before.
    fn arrived(&mut self, status: Status, asked: u64) -> Result<(), DeviceError> {
        let begun = match (self.doing, self.motors) {
            (Doing::Drives { question }, _) => Some(question),
            (_, Some(motors)) => Some(motors.question),
            _ => None,
        };
        let is_empty = self.has_gauge && status.battery == 0 && !status.moving;
        if is_empty && begun.is_some_and(|question| asked >= question) {
            self.stand();
            let text = format!("robot {} stands: its battery is empty", self.number);
            return Err(DeviceError::new(ErrorName::Battery, text));
        }
        let Doing::Drives { question } = self.doing else {
            return Ok(());
        };
        if asked < question || status.on_its_way {
            return Ok(());
        }
        if !self.is_ours {
            self.stand();
            return Err(self.says_no_way());
        }
        if status.gave_up {
            self.doing = Doing::Nothing;
            let why = match status.switches {
                0 => "something was in its way, or it does not know where it is".to_owned(),
                switches => format!(
                    "something was in its way, and presses switches {switches:#06b}; drive it away from there with `motor`"
                ),
            };
            let text = format!("robot {} gave its way up: {why}", self.number);
            return Err(DeviceError::new(ErrorName::Obstacle, text));
        }
        if status.expired {
            self.doing = Doing::Nothing;
            let text = format!("robot {} stopped, as it heard nothing for too long", self.number);
            return Err(DeviceError::new(ErrorName::Link, text));
        }
        self.doing = Doing::Done { at: self.now };
        Ok(())
    }

    fn says_no_way(&self) -> DeviceError {
        let text = format!(
            "robot {} does not say whether it is on its way in a status that this gateway knows, so nobody would know when it is there; drive it by `motor`",
            self.number
        );
        DeviceError::new(ErrorName::Link, text)
    }

    /// Time passes; what was due before was due to a gateway that was not there.
    fn pass(&mut self, now: DeviceTime) {
        let due = self.next_wake().unwrap_or(now).max(self.now);
        self.late = self.late.saturating_add((now - due).max(0));
        self.now = now;
    }

    /// Has the robot stand. That it does is told by what it replies.
    fn stand(&mut self) {
        self.doing = Doing::Nothing;
        self.motors = None;
        self.stood = self.question;
        self.settles = self.now.saturating_add(SETTLES);
        self.insists = true;
        self.say_stop();
    }

    fn say_stop(&mut self) {
        if let (true, Ok(stop)) = (self.linked, Frame::new(&Command::MOTOR, &[0, 0])) {
            self.out.push(stop);
        }
    }

    /// Asks pose and status.
    fn ask_now(&mut self) {
        self.ask = self
            .now
            .saturating_add(match self.is_moving() || self.now < self.settles {
                true => LIVELY,
                false => CALM,
            });
        // Who answers slowly is not asked faster than it answers.
        if !self.linked || self.asked_status.len() >= MOST_ASKED {
            return;
        }
        if self.ask(Code::POSE) {
            self.asked_pose.push_back(self.now);
        }
        if self.ask(Code::STATUS) {
            let (number, at, late) = (self.question, self.now, self.late);
            self.asked_status.push_back(Question { number, at, late });
            self.question += 1;
        }
    }

    /// Asks, if its robots know that question.
    fn ask(&mut self, code: Code) -> bool {
        let command = self.table.get(code);
        let frame = command.and_then(|command| Frame::new(command, &[]).ok());
        self.out.extend(frame);
        frame.is_some()
    }
}

impl Machine for Unit {
    type Action = Action;

    const NAME: &str = "the robot";
    const VERBS: &[&str] = Action::VERBS;
    // No more is known of it than it is asked.
    const PERIOD: DeviceTime = LIVELY;
    // It tells whole mm and degrees.
    const TOLERANCE: f64 = 2.0;
    // Over the radio. A new owner waits for 4 s then, so that of a robot that answers nothing it is told first that it is lost.
    const STOPPING_TIME: DeviceTime = 1_500_000;

    fn card(&self) -> Card {
        orders::card(self.table)
    }

    fn read(verb: Word<'_>, words: &mut Words<'_>) -> Option<Result<Action, DeviceError>> {
        Action::read(verb, words)
    }

    /// What is not known to stand is not said to.
    fn is_moving(&self) -> bool {
        !self.linked || !self.rests || self.drives()
    }

    fn is_reached(&self) -> bool {
        self.linked
    }

    fn plan(&mut self, script: &Script<Action>) -> Result<(), DeviceError> {
        if !self.linked {
            let why = self.why.as_deref().unwrap_or("it has not answered yet");
            let text = format!("robot {} is not connected to its gateway: {why}", self.number);
            return Err(DeviceError::new(ErrorName::Link, text));
        }
        for (action, number) in script.actions() {
            let known = frames(self.number, self.table, action);
            known.map_err(|error| error.at_statement(number))?;
            if matches!(action, Action::Drive(_)) && self.status.is_some_and(|told| !told.is_ours) {
                return Err(self.says_no_way().at_statement(number));
            }
        }
        Ok(())
    }

    fn begin(&mut self, action: &Action, now: DeviceTime) -> Result<(), DeviceError> {
        self.pass(now);
        let frames = frames(self.number, self.table, action)?;
        if self.motors.take().is_some() && !matches!(action, Action::Motor { .. }) {
            self.stand();
        }
        self.out.extend(frames);
        self.doing = match action {
            Action::Motor { ms, .. } => {
                let until = now.saturating_add(DeviceTime::from(*ms) * 1000);
                let question = self.question;
                self.motors = Some(Motors { until, question });
                (self.insists, self.rests) = (false, false);
                self.doing = Doing::Done { at: until };
                // It feeds the watchdog as a question does, and how it goes is told by the next one, or at its end.
                self.ask = self.ask.min(now.saturating_add(LIVELY));
                return Ok(());
            }
            Action::Leds(data) => Doing::Shows { leds: *data },
            // Planned, so that it is none of these.
            Action::Follow { .. } => Doing::Nothing,
            Action::Drive(_) => {
                (self.insists, self.rests) = (false, false);
                Doing::Drives {
                    question: self.question,
                }
            }
        };
        self.ask_now();
        Ok(())
    }

    fn done_at(&self) -> Option<DeviceTime> {
        match self.doing {
            Doing::Nothing | Doing::Drives { .. } | Doing::Shows { .. } => None,
            Doing::Done { at } => Some(at),
        }
    }

    fn halt(&mut self, now: DeviceTime) {
        self.pass(now);
        self.stand();
        self.ask_now();
    }

    fn advance(&mut self, now: DeviceTime) {
        self.pass(now);
        // Later than its end by a moment, so that a `motor` that follows at once sets other values without a stop between.
        if self.motors.is_some_and(|motors| now > motors.until) {
            self.stand();
            self.ask_now();
        }
        if now >= self.ask {
            // The order before may not have reached it.
            if self.insists && !self.is_driven() && self.asked_status.len() < MOST_ASKED {
                self.say_stop();
            }
            self.ask_now();
        }
    }

    fn next_wake(&self) -> Option<DeviceTime> {
        if !self.linked {
            return None;
        }
        let motors = self.motors.map(|motors| motors.until.saturating_add(1));
        // Once it is overdue, that is for its program to see.
        let overdue = self.overdue_at().filter(|due| *due > self.now);
        [motors, overdue, Some(self.ask)].into_iter().flatten().min()
    }

    /// When the oldest part of what it told was asked.
    fn known_at(&self) -> Option<DeviceTime> {
        let status = self.status.map(|told| told.asked);
        let pose = self.pose.map(|(_, asked)| asked);
        match (status, pose) {
            (Some(status), Some(pose)) => Some(status.min(pose)),
            (one, other) => one.or(other),
        }
    }

    /// Its pose was so between its question and its answer; of when its status was asked that says nothing.
    fn measured(&self, _at: DeviceTime) -> Option<Sample> {
        let (_, asked) = self.pose?;
        Some(Sample::of(&self.position(), asked)?.until(self.posed))
    }

    /// `{x, y, heading}` in mm, mm and degrees, once it has said so.
    fn position(&self) -> Map {
        match self.pose {
            None => Map::new(),
            Some((Pose { x, y, heading }, _)) => {
                Map::new().with("x", x).with("y", y).with("heading", heading)
            }
        }
    }

    /// `{unit, linked, reached, unreached-since?, unreached-why?, leds, battery?, charging?, switches?, expired?, round-trip?}`: µs since
    /// 1970, words, percent, a mask of bits, µs. What is told of one that is not reached is what it said last, but for its motion, of which
    /// nobody knows.
    fn report(&self) -> Map {
        let mut map = Map::new()
            .with("unit", i64::from(self.number))
            .with("linked", self.linked)
            .with("reached", self.linked)
            .with("leds", self.leds);
        if let Some(epoch) = self.epoch.filter(|_| !self.linked) {
            map.set("unreached-since", epoch.saturating_add(self.unlinked));
        }
        if let Some(why) = self.why.as_deref().filter(|_| !self.linked) {
            map.set("unreached-why", why);
        }
        if let Some(Told { status, .. }) = self.status.filter(|told| told.is_ours) {
            map.set("battery", i64::from(status.battery));
            map.set("charging", status.charging);
            map.set("switches", i64::from(status.switches));
            map.set("expired", status.expired);
        }
        if let Some(round_trip) = self.round_trip {
            map.set(ROUND_TRIP, round_trip);
        }
        map
    }
}
