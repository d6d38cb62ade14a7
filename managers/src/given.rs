//! From peers' answers to a manager's verdict.

use mom_proto::Code;

use crate::{GivenAnswer, Question, Scope, Verdict};

impl GivenAnswer {
    /// Whether a peer said yes; an answer without a peer does not count.
    pub(crate) fn allows(&self) -> bool {
        self.allow && self.by.is_some()
    }

    /// The verdict for a yes: it stands for messages of that name if the peer says so.
    pub(crate) fn keep(&self, verdict: Verdict) -> Verdict {
        match self.stands && self.by.is_some() {
            true => verdict.stands(Scope::ThisName),
            false => verdict,
        }
    }

    /// The refusal for a no, or for no answer.
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
