//! The state machine of one robot's connection (W10, W11), without IO and without a clock.
//!
//! Times are microseconds of one clock that never goes back. The caller of a [`Circuit`] tells it what happens
//! ([`Circuit::take`]), does what it asks for ([`Circuit::poll`], until there is nothing more), and takes
//! [`Input::Time`] to it at [`Circuit::next_wake`].

mod backoff;
mod budget;
mod faults;
mod options;
mod state;
#[cfg(test)]
mod tests;
mod up;
mod waiting;

use std::collections::VecDeque;

use mom_brs::{Code, Command, Direction, Encoded, Frame, MOST_ASTRAY, Table};

use self::backoff::Backoff;
use self::budget::Budget;
use self::up::{Since, Up};

pub use faults::Faults;
pub use options::Options;
pub use state::{End, Refusal, State, Taken};
pub use waiting::MOST_WAITING;

/// A second, in µs.
pub(crate) const SECOND: i64 = 1_000_000;

/// So many NULLs may be without a reply.
const MOST_UNANSWERED: usize = 64;

/// After so many periods without a reply to a NULL, the robot is silent.
const SILENT_PERIODS: i64 = 3;

/// A robot is left that has answered so many more times than it was asked.
const MOST_UNASKED: u32 = 64;

/// So many replies are waited for at most; a silent robot must not send all of them at once later.
const MOST_OWED: u32 = 256;

/// A robot is left of which there was more to be read than is read, for so long.
const FLOOD: i64 = 3 * SECOND;

/// What happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input<'a> {
    /// A caller wants a connection.
    Connect,
    /// Nobody wants one any more.
    Disconnect,
    /// The TCP connection is up.
    Connected,
    /// The robot does not answer what was asked of it: its connection is given up, and another one attempted.
    GiveUp,
    /// The attempt failed or the connection ended, not by [`Output::Close`] or [`Output::Abort`].
    Ended(End),
    /// Bytes came.
    Bytes(&'a [u8]),
    /// What was given to be written is not all written: nothing more can be, for now.
    Blocked,
    /// All is written.
    Unblocked,
    /// Time has passed.
    Time,
}

/// What is to be done.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// Begin a TCP connection to the robot, and say [`Input::Connected`] or [`Input::Ended`].
    Connect,
    /// End the attempt or the connection, and say nothing of it.
    Close,
    /// End the connection and drop what is under way: what has not arrived yet would be carried out late.
    Abort,
    /// Write these bytes, and say [`Input::Blocked`] if that cannot be done at once.
    Write(Encoded),
    /// Tell the observers.
    Note(Note),
}

/// What there is to tell of a robot.
#[derive(Clone, Debug, PartialEq)]
pub enum Note {
    /// A frame is written.
    Sent(Frame),
    /// A frame has come; of a NULL's reply, the round trip in µs (W8).
    Received(Frame, Option<i64>),
    /// It has another state.
    State(State),
    /// An attempt failed, or the connection ended.
    Ended(End),
}

/// Where the connection is, and what is known only there.
#[derive(Debug)]
enum Phase {
    Disconnected,
    /// The next attempt is at this time.
    Pausing(i64),
    /// The attempt ends at this time.
    Connecting(i64),
    Up(Box<Up>),
}

/// Whether a command stops the motors.
fn is_stop(frame: &Frame) -> bool {
    frame.code() == Code::MOTOR && frame.values() == [0, 0]
}

/// The state machine of one robot's connection.
#[derive(Debug)]
pub struct Circuit {
    table: &'static Table,
    options: Options,
    phase: Phase,
    told: State,
    outputs: VecDeque<Output>,
    backoff: Backoff,
    budget: Budget,
    failed: u32,
    faults: Faults,
    round_trip: Option<i64>,
    status: Option<i32>,
    last_end: Option<End>,
    in_motion: bool,
    /// Whether it was told to move or to stop, and has not confirmed since that it has read a stop: on any connection.
    may_move: bool,
    /// Whether a stop is to be said as soon as there is a connection.
    owes_stop: bool,
    /// When something was taken last.
    taken: i64,
}

impl Circuit {
    /// A circuit in the state disconnected. The seed makes its pauses differ from those of other robots.
    #[must_use]
    pub fn new(table: &'static Table, options: Options, seed: u64) -> Circuit {
        Circuit {
            table,
            options,
            phase: Phase::Disconnected,
            told: State::Disconnected,
            outputs: VecDeque::new(),
            backoff: Backoff::new(options.first_backoff, options.most_backoff, seed),
            budget: Budget::new(options.read_rate),
            failed: 0,
            faults: Faults::default(),
            round_trip: None,
            status: None,
            last_end: None,
            in_motion: false,
            may_move: false,
            owes_stop: false,
            taken: i64::MIN,
        }
    }

    /// The state.
    #[must_use]
    pub fn state(&self) -> State {
        match &self.phase {
            Phase::Disconnected => State::Disconnected,
            Phase::Pausing(_) | Phase::Connecting(_) => State::Trying,
            Phase::Up(up) if up.heard && up.blocked.is_none() => State::Writable,
            Phase::Up(_) => State::Connected,
        }
    }

    /// The last round trip of a NULL on this connection, in µs.
    #[must_use]
    pub const fn round_trip(&self) -> Option<i64> {
        self.round_trip
    }

    /// The bits of the last STATUS reply on this connection.
    #[must_use]
    pub const fn status(&self) -> Option<i32> {
        self.status
    }

    /// Why the last attempt failed or the last connection ended.
    #[must_use]
    pub const fn last_end(&self) -> Option<&End> {
        self.last_end.as_ref()
    }

    /// What was wrong with what the robot said.
    #[must_use]
    pub fn faults(&self) -> Faults {
        match &self.phase {
            Phase::Up(up) => self.faults.plus(up.parser.faults()),
            _ => self.faults,
        }
    }

    /// How many frames wait.
    #[must_use]
    pub fn waiting(&self) -> usize {
        match &self.phase {
            Phase::Up(up) => up.waiting.len(),
            _ => 0,
        }
    }

    /// Whether the base station has set the robot in motion: the last command that was written to it and can move it
    /// is not MOTOR 0 0. All commands can but NULL, STATUS, LEDS and POSE, as nobody knows those of other tables.
    #[must_use]
    pub const fn is_in_motion(&self) -> bool {
        self.in_motion
    }

    /// Whether the robot may move by what it was told: it is in motion ([`Circuit::is_in_motion`]), or nothing shows that it has read the
    /// stop that was written last. It reads in order, so an answer to a NULL that was written behind the stop does.
    #[must_use]
    pub const fn may_move(&self) -> bool {
        self.may_move
    }

    /// Whether the robot has read the last stop, and nothing waits.
    #[must_use]
    pub fn is_stop_heard(&self) -> bool {
        matches!(&self.phase, Phase::Up(up) if up.waiting.len() == 0) && !self.may_move
    }

    /// How many bytes may be read of the robot now; at 0, wait until [`Circuit::next_wake`].
    #[must_use]
    pub fn may_read(&mut self, now: i64) -> usize {
        self.budget.left(now)
    }

    /// Gives a command to be sent. A stop that cannot be is said first on the next connection ([`Circuit::halt`]).
    ///
    /// # Errors
    ///
    /// It is not sent, and why.
    pub fn send(&mut self, frame: Frame) -> Result<Taken, Refusal> {
        let state = self.state();
        if frame.direction() != Direction::Command {
            return Err(Refusal::NoCommand);
        }
        let up = match &mut self.phase {
            Phase::Up(up) if up.heard => up,
            // Motion is not kept for later, but a stop is.
            _ if is_stop(&frame) => return self.halt().map(|()| Taken::Queued),
            _ => return Err(Refusal::NotWritable(state)),
        };
        if frame.code() == Code::NULL && up.unanswered.len() + up.waiting.nulls() >= MOST_UNANSWERED {
            return Err(Refusal::Unanswered);
        }
        up.waiting.push(frame)
    }

    /// Drops what waits, and stops the motors before anything else: of a robot that takes commands, in motion or not. A NULL behind it
    /// shows that it was read ([`Circuit::is_stop_heard`]). Where there is no connection on which the robot has said anything, it is said
    /// first on the next one; where one is wanted, that is tried at once.
    ///
    /// # Errors
    ///
    /// It has not been said yet.
    pub fn halt(&mut self) -> Result<(), Refusal> {
        let state = self.state();
        match &mut self.phase {
            Phase::Up(up) if up.heard => {
                self.owes_stop = false;
                up.stop()
            }
            phase => {
                self.owes_stop = true;
                if matches!(phase, Phase::Pausing(_)) {
                    self.attempt(self.taken);
                }
                Err(Refusal::NotWritable(state))
            }
        }
    }

    /// Takes what happened. What does not fit the state is nothing: a connection that nobody wants any more may
    /// still say that it ended. So is what is told of a connection while [`Output::Close`] or [`Output::Connect`] has not
    /// been polled: it is about an older one.
    pub fn take(&mut self, now: i64, input: Input<'_>) {
        self.note_late(now);
        let of_connection = !matches!(
            input,
            Input::Connect | Input::Disconnect | Input::GiveUp | Input::Time
        );
        let input = match of_connection && self.is_connection_older() {
            true => Input::Time,
            false => input,
        };
        match input {
            Input::Connect => {
                if matches!(self.phase, Phase::Disconnected) {
                    self.failed = 0;
                    self.backoff.reset();
                    self.attempt(now);
                }
            }
            Input::Disconnect => match self.phase {
                Phase::Disconnected => {}
                Phase::Pausing(_) => self.phase = Phase::Disconnected,
                Phase::Connecting(_) | Phase::Up(_) => {
                    self.outputs.push_back(Output::Close);
                    self.end(End::Unwanted);
                    self.phase = Phase::Disconnected;
                }
            },
            Input::GiveUp => {
                if matches!(self.phase, Phase::Up(_)) {
                    self.give_up(now, End::Silent);
                }
            }
            Input::Connected => {
                if matches!(self.phase, Phase::Connecting(_)) {
                    self.begin(now);
                }
            }
            Input::Ended(end) => {
                if matches!(self.phase, Phase::Connecting(_) | Phase::Up(_)) {
                    self.fail(now, end);
                }
            }
            Input::Bytes(bytes) => self.read(now, bytes),
            Input::Blocked => {
                if let Phase::Up(up) = &mut self.phase {
                    let late = up.late;
                    up.blocked.get_or_insert(Since { at: now, late });
                }
            }
            Input::Unblocked => {
                if let Phase::Up(up) = &mut self.phase {
                    up.blocked = None;
                }
            }
            Input::Time => {}
        }
        self.pass(now);
        self.tell();
    }

    /// The next thing to do now; `None`: nothing until the next input or [`Circuit::next_wake`].
    pub fn poll(&mut self, now: i64) -> Option<Output> {
        if let Some(output) = self.outputs.pop_front() {
            return Some(output);
        }
        let Phase::Up(up) = &mut self.phase else {
            return None;
        };
        if up.blocked.is_some() {
            return None;
        }
        let frame = if now >= up.next_null && up.unanswered.len() < MOST_UNANSWERED {
            up.next_null = now.saturating_add(self.options.null_period);
            Frame::new(&Command::NULL, &[]).ok()?
        } else {
            up.waiting.pop()?
        };
        let is_answered = self.table.get(frame.code()).is_some_and(|of| of.reply.is_some());
        up.owed = (up.owed + u32::from(is_answered)).min(MOST_OWED);
        match frame.code() {
            Code::NULL => {
                up.nulls_sent += 1;
                up.unanswered.push_back(Since {
                    at: now,
                    late: up.late,
                });
            }
            Code::STATUS | Code::LEDS | Code::POSE => {}
            Code::MOTOR => {
                self.in_motion = frame.values().iter().any(|speed| *speed != 0);
                self.may_move = true;
                up.nulls_before_stop = Some(up.nulls_sent);
            }
            _ => (self.in_motion, self.may_move) = (true, true),
        }
        self.outputs.push_back(Output::Note(Note::Sent(frame)));
        Some(Output::Write(frame.encode()))
    }

    /// When [`Input::Time`] is due, if nothing else happens before.
    #[must_use]
    pub fn next_wake(&self) -> Option<i64> {
        match &self.phase {
            Phase::Disconnected => None,
            Phase::Pausing(until) | Phase::Connecting(until) => Some(*until),
            Phase::Up(up) => {
                let null = match up.blocked {
                    // Only its end lets anything out.
                    Some(_) => None,
                    None if up.unanswered.len() >= MOST_UNANSWERED => None,
                    None => Some(up.next_null),
                };
                let idle = up
                    .parser
                    .is_amid()
                    .then(|| up.last_bytes.saturating_add(self.options.idle));
                let times = [null, idle, self.silent_at(up), self.budget.refilled_at()];
                times.into_iter().flatten().min()
            }
        }
    }

    /// Whether the connection that the driver has is not the one of this phase.
    fn is_connection_older(&self) -> bool {
        let replaces = |output: &Output| matches!(output, Output::Connect | Output::Close | Output::Abort);
        self.outputs.iter().any(replaces)
    }

    fn silent_at(&self, up: &Up) -> Option<i64> {
        let patience = self.options.null_period.saturating_mul(SILENT_PERIODS);
        let since = up.unanswered.front().into_iter().chain(up.blocked.as_ref());
        let ends = since.map(|since| {
            since
                .at
                .saturating_add(patience)
                .saturating_add(up.late - since.late)
        });
        ends.min()
    }

    /// The caller was stopped or had no processor if nothing was taken when it was due.
    fn note_late(&mut self, now: i64) {
        let due = self.next_wake().map(|due| due.max(self.taken));
        if let (Phase::Up(up), Some(due)) = (&mut self.phase, due) {
            up.late = up.late.saturating_add(now.saturating_sub(due).max(0));
        }
        self.taken = self.taken.max(now);
    }

    /// What is due by time alone.
    fn pass(&mut self, now: i64) {
        match &self.phase {
            Phase::Pausing(until) if *until <= now => self.attempt(now),
            Phase::Connecting(until) if *until <= now => {
                self.outputs.push_back(Output::Close);
                self.fail(now, End::TimedOut);
            }
            Phase::Up(up) if self.silent_at(up).is_some_and(|at| at <= now) => {
                self.give_up(now, End::Silent);
            }
            _ => {}
        }
        if let Phase::Up(up) = &mut self.phase
            && up.last_bytes.saturating_add(self.options.idle) <= now
        {
            up.parser.idle();
        }
        self.budget.refill(now);
    }

    fn attempt(&mut self, now: i64) {
        self.phase = Phase::Connecting(now.saturating_add(self.options.connect_timeout));
        self.outputs.push_back(Output::Connect);
    }

    fn begin(&mut self, now: i64) {
        self.round_trip = None;
        self.status = None;
        self.phase = Phase::Up(Box::new(Up::new(self.table, now)));
    }

    /// The end of an attempt or a connection that is still wanted.
    fn fail(&mut self, now: i64, end: End) {
        // One that connects, and says what nobody can use, is not tried again at once.
        let pause = match end {
            End::Flooding | End::Astray => self.backoff.longest(),
            _ => self.backoff.next(),
        };
        self.end(end);
        self.failed = self.failed.saturating_add(1);
        self.phase = match self.options.attempts {
            Some(most) if self.failed >= most => Phase::Disconnected,
            _ => Phase::Pausing(now.saturating_add(pause)),
        };
    }

    fn give_up(&mut self, now: i64, end: End) {
        self.outputs.push_back(Output::Abort);
        self.fail(now, end);
    }

    fn end(&mut self, end: End) {
        // Nothing is sent on the next connection that was meant for this one, but a stop that it may not have read.
        let said = self.may_move && !self.in_motion;
        self.owes_stop |= match &self.phase {
            Phase::Up(up) => up.waiting.ends_in_stop().unwrap_or(said),
            _ => false,
        };
        self.faults = self.faults();
        self.last_end = Some(end.clone());
        self.outputs.push_back(Output::Note(Note::Ended(end)));
    }

    fn read(&mut self, now: i64, bytes: &[u8]) {
        let Phase::Up(up) = &mut self.phase else { return };
        if bytes.is_empty() {
            return;
        }
        let had = self.budget.left(now);
        self.budget.spend(now, bytes.len());
        if had.saturating_mul(2) >= self.options.read_rate as usize {
            up.flood = None;
        } else if self.budget.left(now) == 0 {
            up.flood.get_or_insert(now);
        }
        if up.last_bytes.saturating_add(self.options.idle) <= now {
            up.parser.idle();
        }
        up.last_bytes = now;
        for frame in up.parser.feed(bytes) {
            let mut round_trip = None;
            if !frame.command().is_reply_only() {
                match up.owed.checked_sub(1) {
                    Some(owed) => (up.owed, up.unasked) = (owed, up.unasked.saturating_sub(1)),
                    None => {
                        up.unasked += 1;
                        self.faults.unasked += 1;
                    }
                }
            }
            match frame.code() {
                Code::NULL => {
                    let sent = up.unanswered.pop_front();
                    up.nulls_answered += u64::from(sent.is_some());
                    let has_read = up
                        .nulls_before_stop
                        .is_some_and(|before| up.nulls_answered > before);
                    self.may_move &= self.in_motion || !has_read;
                    round_trip = sent.map(|sent| now.saturating_sub(sent.at).max(0));
                }
                Code::STATUS => self.status = frame.values().first().copied(),
                _ => {}
            }
            self.round_trip = round_trip.or(self.round_trip);
            // A robot that says who holds it closes next: it takes no commands, and to be tried at once would be in vain.
            if !up.heard && frame.code() != Code::HOLDER {
                up.heard = true;
                self.failed = 0;
                self.backoff.reset();
            }
            self.outputs
                .push_back(Output::Note(Note::Received(frame, round_trip)));
        }
        if up.heard && std::mem::take(&mut self.owes_stop) {
            // There is always a place for it.
            let _ = up.stop();
        }
        // A status or an answer found in the middle of something else is worth nothing; without its station the robot stands.
        if up.parser.astray() > MOST_ASTRAY {
            self.give_up(now, End::Astray);
        } else if up.unasked > MOST_UNASKED || up.flood.is_some_and(|since| now - since >= FLOOD) {
            self.give_up(now, End::Flooding);
        }
    }

    fn tell(&mut self) {
        let state = self.state();
        if state != self.told {
            self.told = state;
            self.outputs.push_back(Output::Note(Note::State(state)));
        }
    }
}
