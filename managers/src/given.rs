//! What becomes of the answers that peers give for a manager.

use mom_proto::Code;

use crate::{GivenAnswer, Question, Scope, Verdict};

impl GivenAnswer {
    /// Whether a peer said yes; a yes of nobody is none.
    pub(crate) fn allows(&self) -> bool {
        self.allow && self.by.is_some()
    }

    /// The verdict that this answer makes of a yes: it stands for the message asked about, if the peer says so.
    pub(crate) fn keep(&self, verdict: Verdict) -> Verdict {
        match self.stands && self.by.is_some() {
            true => verdict.stands(Scope::ThisName),
            false => verdict,
        }
    }

    /// The refusal that a no, or nobody's answer, makes.
    pub(crate) fn refusal(&self, rule: &str, question: &Question<'_>, who: &str) -> Verdict {
        let context = question.context;
        let what = match question.message {
            Some(message) => format!("{message} to {context}"),
            None => format!("{} of {context}", question.verb),
        };
        let (code, mut text) = match &self.by {
            Some(by) => (Code::DECLINED, format!("{who}, {by}, declined {what}")),
            None => (
                Code::TIMED_OUT,
                format!("{who} did not decide on {what} in time, or is gone"),
            ),
        };
        if !self.text.is_empty() {
            text = format!("{text}: {}", self.text);
        }
        self.keep(Verdict::deny(code, rule, text))
    }
}
