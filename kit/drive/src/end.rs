//! How commands, and the work under a token, end, in the same words everywhere.

use mom_client::{Lost, Path, WireError, visible};

use crate::VerbFailure;
use crate::heard::Report;
use crate::insist::TIMES;

/// How a command ended.
#[derive(Debug, Clone, PartialEq)]
pub enum How {
    /// It was carried out: so many statements.
    Finished(u32),
    /// The device has refused it, or ended it with an error.
    Failed(Report),
    /// The hub has refused it.
    Refused(WireError),
    /// The hub has dropped it on its way to the device; the reason.
    Dropped(String),
    /// The hub has not said whether it has it; why.
    Unanswered(String),
    /// No device answers.
    NoAnswer,
    /// The device asks for no commands.
    AsksNothing,
    /// The device has begun it, and says nothing any more.
    Silent,
    /// The device has left, or the hub misses it.
    Gone {
        /// Its name.
        device: String,
        /// Whether the hub has lost its connection.
        missed: bool,
    },
    /// The link to the hub is down.
    Disconnected,
    /// So many events were lost here.
    Lagged(u64),
    /// The token was lost.
    Lost {
        /// How.
        lost: Lost,
        /// Whether the device has said that it has ended the command; none if that was never sent.
        ended: Option<bool>,
    },
}

/// A command's end, and how it is told.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct CommandEnd {
    /// How it ended.
    pub how: How,
    /// In words.
    pub text: String,
    /// What to do, where something can be done.
    pub hint: Option<String>,
    /// What the device's error is called, as one may show it.
    error: String,
}

/// The longest name of an error that is told, characters.
const NAME: usize = 64;
/// What a device's error may not be called: these are words of the commander's own.
const OWN: [&str; 10] = [
    "finished",
    "error",
    "dropped",
    "unanswered",
    "no-answer",
    "silent",
    "gone",
    "disconnected",
    "lagged",
    "lost",
];

/// What the error of a report is called, as one may show it.
fn error_of(how: &How) -> String {
    let name = match how {
        How::Failed(report) => report.error_name().unwrap_or_default(),
        _ => "",
    };
    let name: String = visible(name).chars().take(NAME).collect();
    match name.is_empty() || OWN.contains(&name.as_str()) {
        true => "error".to_owned(),
        false => name,
    }
}

/// What is commanded.
#[derive(Debug, Clone)]
pub(crate) struct Whose {
    pub(crate) place: Path,
    pub(crate) token: Option<Path>,
}

impl Whose {
    fn token(&self) -> &str {
        self.token.as_ref().map_or("the token", Path::as_str)
    }

    /// Where to see who is there.
    fn around(&self) -> String {
        let parent = self.place.parent().unwrap_or_else(Path::root);
        format!("see who is there: mom tree {parent}")
    }

    fn look_or_stop(&self) -> String {
        let place = &self.place;
        format!("look at it: mom watch {place}; stop it: mom stop {place}")
    }
}

impl CommandEnd {
    pub(crate) fn new(how: How, whose: &Whose, command: &str, runs: bool) -> CommandEnd {
        let (text, hint) = words(&how, whose, command, runs);
        let error = error_of(&how);
        CommandEnd {
            how,
            text,
            hint,
            error,
        }
    }

    /// Whether it was carried out.
    #[must_use]
    pub fn is_finished(&self) -> bool {
        matches!(self.how, How::Finished(_))
    }

    /// The word for it: the name of the device's error, the code of the hub's, or what became of it else.
    #[must_use]
    pub fn name(&self) -> &str {
        match &self.how {
            How::Finished(_) => "finished",
            How::Failed(_) => &self.error,
            How::Refused(error) => error.code.word(),
            How::Dropped(_) => "dropped",
            How::Unanswered(_) => "unanswered",
            How::NoAnswer | How::AsksNothing => "no-answer",
            How::Silent => "silent",
            How::Gone { .. } => "gone",
            How::Disconnected => "disconnected",
            How::Lagged(_) => "lagged",
            How::Lost { .. } => "lost",
        }
    }

    /// None if it was carried out; the device's words, if it can read the command and cannot go there, so that another pose may do.
    ///
    /// # Errors
    /// It ended otherwise.
    pub fn unreachable(self) -> Result<Option<String>, VerbFailure> {
        let poses = ["workspace-boundary", "joint-limit", "singularity"];
        match &self.how {
            How::Failed(report) if report.error_name().is_some_and(|name| poses.contains(&name)) => {
                Ok(Some(report.wire_error().text))
            }
            _ => self.done().map(|()| None),
        }
    }

    /// Nothing, if it was carried out.
    ///
    /// # Errors
    /// It was not.
    pub fn done(self) -> Result<(), VerbFailure> {
        match self.how {
            How::Finished(_) => Ok(()),
            _ => Err(VerbFailure::Failed {
                text: self.text,
                hint: self.hint,
            }),
        }
    }
}

/// Of a command that the device cannot have heard of.
const NOTHING: &str = "; nothing of the command ran";

/// The words and the advice.
fn words(how: &How, whose: &Whose, command: &str, runs: bool) -> (String, Option<String>) {
    let place = &whose.place;
    let unknown = match runs {
        true => "; what became of the command is not known",
        false => NOTHING,
    };
    match how {
        How::Finished(_) => ("finished".to_owned(), None),
        How::Failed(report) => {
            let hint = match report.error_name() {
                Some("stopped") => Some(format!("let it go with: mom unstop {place}")),
                Some("estop") => Some(format!(
                    "reset its emergency stop, then let it go with: mom unstop {place}"
                )),
                Some("changing-hands" | "link") => Some(whose.look_or_stop()),
                _ => None,
            };
            (report.error_words(), hint)
        }
        How::Refused(error) => (format!("send {command:?} to {place}: {error}"), None),
        How::Dropped(reason) => (
            format!(
                "send {command:?} to {place}: the hub dropped it on its way: {}{NOTHING}",
                visible(reason)
            ),
            None,
        ),
        How::Unanswered(why) => (
            format!("send {command:?} to {place}: {why}{unknown}"),
            Some(whose.look_or_stop()),
        ),
        How::NoAnswer => (format!("no device answers in {place}"), Some(whose.around())),
        How::AsksNothing => (
            format!("the device in {place} asks for nothing"),
            Some(format!(
                "start it so that it asks for its commands, or let it go with: mom unstop {place}"
            )),
        ),
        How::Silent => (
            format!("the device in {place} has said nothing for 90 s{unknown}"),
            Some(whose.around()),
        ),
        How::Gone { device, missed } => {
            let device = visible(device);
            let gone = match missed {
                true => format!("the hub has lost the connection of {device}, the device in {place}"),
                false => format!("{device} has left {place}"),
            };
            (format!("{gone}{unknown}"), Some(whose.around()))
        }
        How::Disconnected => (
            format!("the connection to the hub is lost, and the token with it{unknown}"),
            runs.then(|| format!("see what it did: mom watch {place}")),
        ),
        How::Lagged(count) => (
            format!(
                "{count} {} lost here{unknown}",
                if *count == 1 { "event was" } else { "events were" }
            ),
            Some(whose.look_or_stop()),
        ),
        How::Lost { lost, ended } => {
            let (ended, hint) = ended_words(*ended);
            let text = format!("{}{ended}", lost_words(whose.token(), lost));
            (text, hint.map(str::to_owned))
        }
    }
}

/// What the device has said of a command whose token was lost, and what to do.
pub(crate) fn ended_words(ended: Option<bool>) -> (&'static str, Option<&'static str>) {
    match ended {
        None => (NOTHING, None),
        Some(true) => ("; the device has ended the command", None),
        Some(false) => (
            "; the device has not said that it has ended the command",
            Some("go and look; switch it off where it moves"),
        ),
    }
}

/// That a token is lost, and why, in words.
#[must_use]
pub fn lost_words(token: &str, lost: &Lost) -> String {
    format!("lost {token}: {}", loss_words(lost))
}

/// Why a token is lost, in words.
#[must_use]
pub fn loss_words(lost: &Lost) -> String {
    let by = lost.by.as_deref().map(visible);
    match (lost.reason.as_str(), by) {
        ("preempted", Some(by)) => format!("{by} has a higher level and took it"),
        ("expired", Some(by)) => format!("the time was over, and {by} was next"),
        ("expired", None) => "the lease was over".to_owned(),
        ("disconnected", _) => "the connection to the hub is lost".to_owned(),
        ("deleted", _) => "it was deleted".to_owned(),
        ("given", Some(by)) => format!("{by} has it now"),
        ("returned", _) => "it returned to its giver".to_owned(),
        ("broken", Some(by)) => format!("{by} took it away"),
        ("revoked", _) => "you may no longer be here".to_owned(),
        (reason, Some(by)) => format!("{} by {by}", visible(reason)),
        (reason, None) => visible(reason),
    }
}

/// How a device took the end of the work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Halt {
    /// It has said that its command has ended, or nothing ran.
    Confirmed,
    /// It has said so after a `stop` only, which holds until an unstop.
    Stopped,
    /// It has said nothing.
    Silent,
}

impl Halt {
    /// Whether the device has obeyed; `device` is its channel.
    ///
    /// # Errors
    /// In words: it was stopped, or says nothing.
    pub fn verdict(self, device: &str) -> Result<(), VerbFailure> {
        match self {
            Halt::Confirmed => Ok(()),
            Halt::Stopped => Err(VerbFailure::new(
                format!(
                    "the device in {device} did not end its command when the hub halted it, so it was stopped"
                ),
                format!("see what is wrong with it, then let it go with: mom unstop {device}"),
            )),
            Halt::Silent => Err(VerbFailure::new(
                format!(
                    "the device in {device} has not said that it has ended its command, though the hub was asked to halt it, and {TIMES} \
                     times to stop it"
                ),
                "go and look; switch it off where it moves",
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn how_this_peer_lost_a_token() {
        for (reason, by, words) in [
            ("preempted", Some("carol"), "carol has a higher level and took it"),
            ("expired", Some("bob"), "the time was over, and bob was next"),
            ("expired", None, "the lease was over"),
            ("disconnected", None, "the connection to the hub is lost"),
            ("broken", Some("carol"), "carol took it away"),
            ("given", Some("bob"), "bob has it now"),
            ("returned", Some("bob"), "it returned to its giver"),
            ("revoked", Some("carol"), "you may no longer be here"),
            ("denied", Some("carol"), "denied by carol"),
            ("denied", None, "denied"),
        ] {
            let lost = Lost {
                reason: reason.to_owned(),
                by: by.map(str::to_owned),
            };
            assert_eq!(loss_words(&lost), words);
        }
    }
}
