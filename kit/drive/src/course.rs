//! The course of the commands to one device, from sending to the end, without IO and clock.
//!
//! `tests/cases/commander.txt` says as dialogues what it does; the clients in Python and JavaScript replay them too.

mod ending;
mod wait;

use std::collections::VecDeque;
use std::time::Duration;

use mom_client::{Path, WireError};

use self::wait::Wait;
use crate::end::{Halt, How, Whose};
use crate::heard::{Report, StateNews};
use crate::insist::TIMES;
use crate::step::{Basis, Progress, Step};

/// ms in which a device answers a command, and the hub a question.
const ANSWER: u64 = 10_000;
/// ms in which the hub gives a receipt; who sends waits for one for 10 s.
const RECEIPT: u64 = 15_000;
/// ms after which a device that says nothing is not there any more; a statement may wait for a minute.
const SILENT: u64 = 90_000;
/// ms for which a device may do what its last owner began, or its mechanism may be out of reach.
const STANDING: u64 = 60_000;
/// ms for which the hub may measure our clock, and between two commands to a device that may take the next one.
const MEASURED: u64 = 10_000;
const SOON: u64 = 100;
/// ms within which a device that asks for its commands does so, unless it has something to do.
const ASKS: u64 = 65_000;
/// ms in which the hub takes a token back.
const RELEASED: u64 = 1_000;
/// So long a device may take to end a command after the hub's `halt`.
pub const HALTED: Duration = Duration::from_millis(HALTED_MS);
const HALTED_MS: u64 = 2_000;
/// ms between two stops of a device that does not end its command.
const REPEATED: u64 = 300;
/// Reports that may come before the receipt.
const EARLY: usize = 64;

/// The commands to one device under one fence.
#[derive(Debug)]
pub(crate) struct Course {
    me: String,
    fence: u64,
    whose: Whose,
    text: String,
    basis: Basis,
    pulls: bool,
    /// Whether it is never sent again.
    once: bool,
    /// When what is in the way was first met, by its name.
    since: Option<(String, u64)>,
    ids: Vec<u64>,
    /// Those of commands that were given up for another, and whose end was not heard.
    left: VecDeque<u64>,
    early: VecDeque<Report>,
    wait: Wait,
    /// Whether it was sent, and no end of it was heard.
    runs: bool,
    /// Whether the device has said anything of it, and that it has begun it; and who said so first.
    reported: bool,
    begun: bool,
    worker: Option<String>,
    /// When it was sent last.
    sent_at: u64,
    device: Option<String>,
    state: Option<StateNews>,
    now: u64,
    steps: VecDeque<Step>,
}

impl Course {
    pub(crate) fn new(me: String, whose: Whose, fence: u64) -> Course {
        Course {
            me,
            fence,
            whose,
            text: String::new(),
            basis: Basis::Nothing,
            pulls: false,
            once: false,
            since: None,
            ids: Vec::new(),
            left: VecDeque::new(),
            early: VecDeque::new(),
            wait: Wait::Nothing,
            runs: false,
            reported: false,
            begun: false,
            worker: None,
            sent_at: 0,
            device: None,
            state: None,
            now: 0,
            steps: VecDeque::new(),
        }
    }

    /// That of a command which runs, and whose end is all that is waited for.
    pub(crate) fn running(place: Path) -> Course {
        let whose = Whose { place, token: None };
        let mut course = Course::new(String::new(), whose, 0);
        course.runs = true;
        course
    }

    /// Whether a command is under way.
    pub(crate) fn is_under_way(&self) -> bool {
        !matches!(
            self.wait,
            Wait::Nothing | Wait::Release { .. } | Wait::Ended { .. }
        )
    }

    /// This peer's name.
    pub(crate) fn me(&self) -> &str {
        &self.me
    }

    /// The device's peer, once it has said something.
    pub(crate) fn device(&self) -> Option<&str> {
        self.device.as_deref()
    }

    /// What is to be done next.
    pub(crate) fn poll(&mut self) -> Option<Step> {
        self.steps.pop_front()
    }

    /// Whether something is to be done.
    pub(crate) fn has_steps(&self) -> bool {
        !self.steps.is_empty()
    }

    /// When it is to be woken, ms.
    pub(crate) fn next_wake(&self) -> Option<u64> {
        match &self.wait {
            Wait::Nothing => None,
            Wait::State { since } => Some(since + self.patience()),
            Wait::Next { since } => Some(since + ASKS),
            Wait::Running { heard, .. } => Some(heard + SILENT),
            Wait::Obstacle { until, again, .. } => Some(again.map_or(*until, |again| again.min(*until))),
            Wait::Receipt { until }
            | Wait::Answer { until }
            | Wait::Asked { until, .. }
            | Wait::Loss { until, .. }
            | Wait::Release { until }
            | Wait::Ended { until, .. } => Some(*until),
        }
    }

    /// What comes next happens at this time; what has come before a time-out counts.
    pub(crate) fn at(&mut self, now: u64) {
        self.now = self.now.max(now);
    }

    /// Nothing has come until this time.
    pub(crate) fn wake(&mut self, now: u64) {
        self.at(now);
        if self.next_wake().is_none_or(|due| now < due) {
            return;
        }
        match std::mem::replace(&mut self.wait, Wait::Nothing) {
            // It says itself that it moves.
            Wait::State { .. } if self.state.is_some() => self.send(None),
            Wait::State { .. } | Wait::Answer { .. } => self.end(How::NoAnswer),
            Wait::Next { .. } => self.end(How::AsksNothing),
            Wait::Running { .. } => self.end(How::Silent),
            Wait::Obstacle { report, until, .. } => match now < until {
                true => self.begin_again(),
                false => self.ask(How::Failed(report)),
            },
            Wait::Asked { end, .. } => self.end(end),
            Wait::Loss { lost, .. } => self.end(How::Lost {
                lost,
                ended: Some(false),
            }),
            Wait::Release { until } => {
                self.wait = Wait::Release { until };
                self.released();
            }
            Wait::Ended { stops, .. } if stops < TIMES => {
                self.steps.push_back(Step::Stop);
                self.wait = Wait::Ended {
                    until: self.now + REPEATED,
                    stops: stops + 1,
                };
            }
            Wait::Ended { .. } => self.steps.push_back(Step::Halted(Halt::Silent)),
            Wait::Receipt { .. } => self.end(How::Unanswered("no receipt within 15 s".to_owned())),
            Wait::Nothing => {}
        }
    }

    /// A command is to be carried out. One before that has not ended goes on.
    pub(crate) fn begin(&mut self, text: &str, basis: Basis, pulls: bool, once: bool) {
        text.clone_into(&mut self.text);
        (self.basis, self.pulls, self.once, self.since) = (basis, pulls, once, None);
        if self.runs {
            self.left.extend(self.ids.drain(..));
            let most = self.left.len().saturating_sub(EARLY);
            self.left.drain(..most);
        }
        (self.runs, self.reported, self.begun) = (false, false, false);
        self.worker = None;
        self.steps.clear();
        self.begin_again();
    }

    fn begin_again(&mut self) {
        self.ids.clear();
        let since = self.now;
        match (self.pulls, self.basis) {
            (true, _) => self.wait = Wait::Next { since },
            (false, Basis::Newest) => {
                self.wait = Wait::State { since };
                self.is_based();
            }
            (false, _) => self.send(None),
        }
    }

    /// So long the state is waited for that a relative command is based on.
    fn patience(&self) -> u64 {
        if self.state.is_some() { STANDING } else { ANSWER }
    }

    /// Sends a relative command, if the device rests.
    fn is_based(&mut self) {
        if matches!(self.wait, Wait::State { .. }) && self.state.as_ref().is_some_and(|state| !state.moving) {
            self.send(None);
        }
    }

    fn send(&mut self, to: Option<u64>) {
        let on = match self.basis {
            Basis::Nothing => None,
            Basis::Newest => self.state.as_ref().and_then(|state| state.id),
            Basis::State(id) => Some(id),
        };
        // From here on it may run, whether or not its receipt comes.
        self.runs = true;
        self.reported = false;
        self.sent_at = self.now;
        self.early.clear();
        self.wait = Wait::Receipt {
            until: self.now + RECEIPT,
        };
        self.steps.push_back(Step::Send { on, to });
    }

    /// The receipt of the command; none if there is nobody to take it.
    pub(crate) fn sent(&mut self, id: Option<u64>) {
        let Some(id) = id else {
            return self.unsent(How::NoAnswer);
        };
        self.ids.push(id);
        if matches!(self.wait, Wait::Receipt { .. }) {
            self.wait = match self.pulls {
                true => Wait::Next { since: self.now },
                false => Wait::Answer {
                    until: self.now + ANSWER,
                },
            };
        }
        for report in std::mem::take(&mut self.early) {
            self.report(report);
        }
    }

    /// The hub has refused the command.
    pub(crate) fn refused(&mut self, error: WireError) {
        let passes = matches!(error.code.word(), "expired" | "try-later");
        match self.pulls && passes && matches!(self.wait, Wait::Receipt { .. }) {
            true => {
                self.runs = !self.ids.is_empty();
                self.wait = Wait::Next { since: self.now };
                self.again(error.code.word(), &error.text);
            }
            false => self.unsent(How::Refused(error)),
        }
    }

    /// The hub has not said whether it has the command.
    pub(crate) fn unanswered(&mut self, why: String) {
        if matches!(self.wait, Wait::Receipt { .. }) {
            self.end(How::Unanswered(why));
        }
    }

    /// The command did not go out.
    fn unsent(&mut self, end: How) {
        self.runs = !self.ids.is_empty();
        match &self.wait {
            Wait::Receipt { .. } if matches!(end, How::Refused(_)) => self.ask(end),
            Wait::Receipt { .. } => self.end(end),
            Wait::Loss { lost, .. } if !self.runs => {
                let lost = lost.clone();
                self.end(How::Lost { lost, ended: None });
            }
            Wait::Ended { .. } if !self.runs => self.has_ended(),
            _ => {}
        }
    }

    fn again(&mut self, why: &str, text: &str) {
        self.steps.push_back(Step::Tell(Progress::Again {
            why: why.to_owned(),
            text: text.to_owned(),
        }));
    }

    /// The device asks for a command.
    pub(crate) fn asks(&mut self, id: u64) {
        if !matches!(self.wait, Wait::Next { .. }) {
            return;
        }
        if !self.ids.is_empty() {
            self.again("late", "it was not begun in time");
        }
        self.send(Some(id));
    }

    /// The device's state. Old ones are from before this program came.
    pub(crate) fn state_told(&mut self, news: StateNews, by: Option<&str>, is_old: bool) {
        if !is_old {
            self.hears_device(by);
        }
        // What is stopped and rests has ended what it did.
        let obeys = !is_old && news.stopped && !news.moving;
        self.state = Some(news);
        if obeys && matches!(self.wait, Wait::Ended { stops: 1.., .. }) {
            return self.has_ended();
        }
        self.is_based();
        if is_old {
            return;
        }
        let (Wait::Obstacle { report, again, .. }, Some(state)) = (&mut self.wait, &self.state) else {
            return;
        };
        let passed = match report.error_name() {
            Some("changing-hands") => state.stands_for(self.fence),
            Some("link") => state.linked,
            _ => return,
        };
        let soon = self.sent_at + SOON;
        match passed {
            true if self.now < soon => *again = Some(soon),
            true => self.begin_again(),
            false => *again = None,
        }
    }

    fn hears_device(&mut self, by: Option<&str>) {
        self.device = by.map(str::to_owned).or_else(|| self.device.take());
        if let Wait::Running { heard, .. } = &mut self.wait {
            *heard = self.now;
        }
    }

    /// A report about a command.
    pub(crate) fn reported(&mut self, report: Report, by: Option<&str>) {
        if report.peer != self.me || report.fence.is_some_and(|fence| fence != self.fence) {
            return;
        }
        // Where several devices are, it is the one's that has answered.
        if self
            .worker
            .as_deref()
            .is_some_and(|worker| by.is_some_and(|by| by != worker))
        {
            return;
        }
        self.hears_device(by);
        if report.id.is_some_and(|id| self.ids.contains(&id)) {
            self.worker = by.map(str::to_owned);
        }
        self.report(report);
    }

    /// The hub has dropped a message of ours on its way to a device, for this reason.
    pub(crate) fn dropped(&mut self, reason: &str, receiver: Option<&str>) {
        let is_other = |device: &str| receiver.is_some_and(|receiver| receiver != device);
        if self.reported || !self.runs || self.device.as_deref().is_some_and(is_other) {
            return;
        }
        match &self.wait {
            Wait::Answer { .. } => {
                self.runs = false;
                self.ask(How::Dropped(reason.to_owned()));
            }
            Wait::Loss { lost, .. } => {
                let lost = lost.clone();
                self.runs = false;
                self.end(How::Lost { lost, ended: None });
            }
            Wait::Release { .. } => self.runs = false,
            Wait::Ended { .. } if self.left.is_empty() => self.has_ended(),
            _ => {}
        }
    }

    fn report(&mut self, report: Report) {
        let is_this = report.id.is_some_and(|id| self.ids.contains(&id));
        let was_left = report.id.is_some_and(|id| self.left.contains(&id));
        self.reported |= is_this;
        self.begun |= is_this && report.has_begun();
        if was_left && report.is_end() {
            self.left.retain(|id| Some(*id) != report.id);
        }
        match &self.wait {
            Wait::Release { .. } | Wait::Ended { .. } | Wait::Loss { .. } if report.is_end() => {
                // Which one runs may not be known yet: then the end of any of ours is its end.
                let is_this = is_this || self.ids.is_empty() && !was_left;
                self.ids.retain(|id| Some(*id) != report.id);
                // Of those that a device was given which asks for them, at most one is begun.
                if is_this && (self.ids.is_empty() || !report.was_too_late()) {
                    self.runs = false;
                }
                if !self.may_run() {
                    self.has_ended();
                }
            }
            Wait::Receipt { .. } if !is_this => {
                self.early.push_back(report);
                if self.early.len() > EARLY {
                    self.early.pop_front();
                }
            }
            Wait::Receipt { .. } | Wait::Answer { .. } | Wait::Running { .. } | Wait::Next { .. }
                if is_this =>
            {
                self.comes(report);
            }
            // It has begun all the same.
            Wait::Obstacle { .. } if is_this && !report.is_end() && self.begun => self.comes(report),
            // It was given up.
            Wait::Nothing if is_this && report.is_end() => self.runs = false,
            _ => {}
        }
    }

    /// The command has come further.
    fn comes(&mut self, report: Report) {
        if report.state != "error" && report.statement > 0 {
            // Commands are carried out one after the other.
            self.left.clear();
        }
        match report.state.as_str() {
            "finished" => {
                self.runs = false;
                self.end(How::Finished(report.of));
            }
            "error" => self.fails(report),
            _ => {
                self.wait = Wait::Running {
                    heard: self.now,
                    id: report.id,
                };
                self.steps.push_back(Step::Tell(Progress::Device {
                    state: report.state,
                    statement: report.statement,
                    of: report.of,
                }));
            }
        }
    }

    /// The device does not carry it out; unless what is in the way passes.
    fn fails(&mut self, report: Report) {
        let name = report.error_name().unwrap_or_default().to_owned();
        if self.pulls && report.was_too_late() && !self.begun {
            // Of those that it was given, at most one is ever begun, and none that came before one that it has answered.
            let before = self.ids.iter().position(|id| Some(*id) == report.id);
            self.ids.drain(..before.map_or(0, |before| before + 1));
            let was_next = match &self.wait {
                Wait::Next { .. } => true,
                Wait::Running { id, .. } => *id == report.id,
                _ => false,
            };
            if was_next {
                self.runs = !self.ids.is_empty();
                self.wait = Wait::Next { since: self.now };
                self.again(&name, &report.error_text());
            }
            return;
        }
        self.runs = false;
        let patience = match name.as_str() {
            "changing-hands" | "link" => STANDING,
            "too-old" => MEASURED,
            _ => return self.ask(How::Failed(report)),
        };
        // What may have begun is never said twice.
        if !report.may_retry() || self.pulls || self.once || self.begun {
            return self.ask(How::Failed(report));
        }
        let since = match &self.since {
            Some((met, since)) if *met == name => *since,
            _ => self.now,
        };
        self.since = Some((name.clone(), since));
        let stands = self
            .state
            .as_ref()
            .is_none_or(|state| state.stands_for(self.fence) && state.linked);
        // No state tells that a clock has been measured, nor again that a device stands.
        let again = (name == "too-old" || stands).then_some(self.now + SOON);
        self.again(&name, &report.error_text());
        self.wait = Wait::Obstacle {
            report,
            until: since + patience,
            again,
        };
    }
}

#[cfg(test)]
mod tests;
