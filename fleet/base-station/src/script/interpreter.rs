//! What a script does as time goes by.

use std::collections::HashMap;

use mom_brs::{Code, Frame};
use mom_toml_faults::Spot;

use super::{REPLY_WITHIN, Script, Step};
use crate::fleet::Unit;

/// A wait counts from the moment at which the one before it should have ended, so that repetitions keep their rate; unless
/// that is longer ago than this, in µs.
const LATE: i64 = 1_000_000;

/// What is to be done next.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Send this, and ask again.
    Send(Unit, Frame),
    /// Nothing until this time, in µs, or until a reply was told by [`Interpreter::replied`]; then ask again.
    Wait(i64),
    /// It has ended.
    Done,
    /// It has failed, and ended.
    Failed(NoReply),
}

/// A reply did not come in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{spot}: unit {unit} did not reply within 3 s")]
pub struct NoReply {
    /// Who did not reply.
    pub unit: Unit,
    /// The statement that waited for it.
    pub spot: Spot,
}

/// Carries out a script, without IO and without a clock; times are µs of a clock that never goes back.
#[derive(Clone, Debug)]
pub struct Interpreter {
    script: Script,
    /// The next step.
    at: usize,
    /// How many units of that step have been sent to.
    sent: usize,
    /// What is left of the repetitions that are under way, the innermost last.
    left: Vec<u64>,
    /// The time at which the next step should be.
    due: i64,
    /// Since when the present step waits for a reply.
    waits_since: Option<i64>,
    /// Whether a unit has replied since the command was sent to it, of those that a statement asks for.
    replied: HashMap<(Unit, Code), bool>,
    failed: Option<NoReply>,
}

impl Interpreter {
    /// Begins a script.
    #[must_use]
    pub fn new(script: Script, now: i64) -> Interpreter {
        let asked = |step: &Step| match step {
            Step::Reply { unit, code, .. } => Some(((*unit, *code), false)),
            _ => None,
        };
        let replied = script.steps.iter().filter_map(asked).collect();
        Interpreter {
            script,
            at: 0,
            sent: 0,
            left: Vec::new(),
            due: now,
            waits_since: None,
            replied,
            failed: None,
        }
    }

    /// Tells of a reply.
    pub fn replied(&mut self, unit: Unit, reply: &Frame) {
        if let Some(replied) = self.replied.get_mut(&(unit, reply.code())) {
            *replied = true;
        }
    }

    /// The next thing to do. It never does nothing for ever: each answer but `Wait` is a step forward.
    pub fn poll(&mut self, now: i64) -> Action {
        if let Some(failed) = self.failed {
            return Action::Failed(failed);
        }
        if self.due > now {
            return Action::Wait(self.due);
        }
        while let Some(step) = self.script.steps.get(self.at) {
            match step {
                Step::Send { units, frame } => {
                    if let Some(unit) = units.get(self.sent) {
                        self.sent += 1;
                        if let Some(replied) = self.replied.get_mut(&(*unit, frame.code())) {
                            *replied = false;
                        }
                        return Action::Send(*unit, *frame);
                    }
                    self.sent = 0;
                }
                Step::Wait { micros } => {
                    if now.saturating_sub(self.due) > LATE {
                        self.due = now;
                    }
                    self.due = self.due.saturating_add(*micros);
                    if self.due > now {
                        self.at += 1;
                        return Action::Wait(self.due);
                    }
                }
                Step::Reply { unit, code, spot } => {
                    let replied = self.replied.get_mut(&(*unit, *code));
                    if replied.is_some_and(std::mem::take) {
                        self.waits_since = None;
                        self.due = now;
                    } else {
                        let until = self.waits_since.get_or_insert(now).saturating_add(REPLY_WITHIN);
                        if until > now {
                            return Action::Wait(until);
                        }
                        let failed = NoReply {
                            unit: *unit,
                            spot: *spot,
                        };
                        self.failed = Some(failed);
                        return Action::Failed(failed);
                    }
                }
                Step::Repeat { count } => self.left.push(*count),
                Step::End { first } => {
                    let again = self.left.last_mut().is_some_and(|left| {
                        *left = left.saturating_sub(1);
                        *left > 0
                    });
                    if again {
                        self.at = *first;
                        continue;
                    }
                    self.left.pop();
                }
            }
            self.at += 1;
        }
        Action::Done
    }
}
