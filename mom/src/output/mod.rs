//! Output for people (lines with colour) and programs (JSON, one object per line).

pub(crate) mod event;
mod handover;
pub(crate) mod record;
pub(crate) mod refusal;
pub(crate) mod style;
pub(crate) mod words;

use std::fmt::Display;
use std::io::{self, Write as _};
use std::process::ExitCode;

use mom_client::{Map, WireError};
use serde::Serialize;
use serde_json::{Value as Json, json};

use self::style::{Tone, ink};
use crate::failure::Failure;

/// Standard output and standard error, in the form that was asked for.
///
/// Results go to standard output, remarks and errors to standard error, so that a pipe carries results only.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Output {
    json: bool,
}

impl Output {
    /// Output as JSON lines, or for people.
    pub(crate) fn new(json: bool) -> Output {
        Output { json }
    }

    /// Whether a program reads it.
    pub(crate) fn is_json(self) -> bool {
        self.json
    }

    /// One result, in the one form or the other.
    pub(crate) fn tell(self, json: impl FnOnce() -> Json, human: impl FnOnce() -> String) -> io::Result<()> {
        match self.json {
            true => self.line(&words::shown_json(&json().to_string())),
            false => self.line(&words::shown(&human())),
        }
    }

    /// A result for people only.
    pub(crate) fn human(self, line: impl Display) -> io::Result<()> {
        match self.json {
            true => Ok(()),
            false => self.line(&words::shown(&line.to_string())),
        }
    }

    /// A remark beside the results, for people.
    pub(crate) fn remark(self, text: impl Display) {
        if !self.json {
            self.complain(&words::shown(&text.to_string()));
        }
    }

    /// Reports a failure, and gives the exit code.
    pub(crate) fn failure(self, failure: &Failure) -> ExitCode {
        let code = failure.exit_code();
        if code != 0 && !matches!(failure, Failure::Told) {
            match self.json {
                true => self.complain(&words::shown_json(&failure_json(failure).to_string())),
                false => self.complain(&words::shown(&failure_text(failure))),
            }
        }
        ExitCode::from(code)
    }

    /// Bytes as they are.
    pub(crate) fn bytes(self, bytes: &[u8]) -> io::Result<()> {
        let mut stdout = io::stdout().lock();
        stdout.write_all(bytes)?;
        stdout.flush()
    }

    fn line(self, line: &str) -> io::Result<()> {
        let mut stdout = anstream::stdout().lock();
        writeln!(stdout, "{line}")?;
        stdout.flush()
    }

    // If standard error is closed nobody can be told.
    fn complain(self, text: &str) {
        let _ = writeln!(anstream::stderr().lock(), "{text}");
    }
}

/// An error of the wire for JSON: `code`, `name`, `text` and the details that apply.
fn error_map(error: &WireError) -> Map {
    // The code goes first: what stands already keeps its place.
    let mut map = Map::new().with("code", u32::from(error.code.number()));
    for (key, value) in error.to_map() {
        map.set(&key, value);
    }
    map
}

/// The whole help, for a command line without a command.
pub(crate) fn help(command: &mut clap::Command) -> ExitCode {
    // Nothing was asked for, so nothing was done: the code for a command line that makes no sense.
    match command.print_help() {
        Ok(()) => ExitCode::from(2),
        Err(_) => ExitCode::FAILURE,
    }
}

/// Anything as JSON; times as text, bytes as base64.
pub(crate) fn to_json(object: &impl Serialize) -> Json {
    // What this program prints are values of the wire and its own structs with keys of text.
    serde_json::to_value(object).unwrap_or(Json::Null)
}

fn failure_json(failure: &Failure) -> Json {
    let error = match failure {
        Failure::Refused { what, error } => {
            let mut json = to_json(&error_map(error));
            json["what"] = what.as_str().into();
            json
        }
        Failure::Usage { text, hint } => json!({"name": "usage", "text": text, "hint": hint}),
        Failure::Failed { text, hint } => json!({"name": "failed", "text": text, "hint": hint}),
        Failure::Io(error) => json!({"name": "io", "text": error.to_string()}),
        Failure::Told => Json::Null,
    };
    json!({"error": error})
}

fn failure_text(failure: &Failure) -> String {
    let (label, headline, hints) = match failure {
        Failure::Refused { what, error } => return refusal_text(what, error),
        Failure::Usage { text, hint } => ("error", text.clone(), Some(hint)),
        Failure::Failed { text, hint } => ("error", text.clone(), hint.as_ref()),
        Failure::Io(error) => ("error", error.to_string(), None),
        Failure::Told => return String::new(),
    };
    let mut text = format!("{} {headline}", ink(format_args!("{label}:"), Tone::Bad));
    for hint in hints.into_iter().flat_map(|hint| hint.lines()) {
        text.push_str(&format!("\n  {} {hint}", ink("->", Tone::Faint)));
    }
    text
}

/// A refusal for people: its headline, and below it a line for each fact.
pub(crate) fn refusal_text(what: &str, error: &WireError) -> String {
    let refusal = refusal::refusal(what, error);
    let width = refusal
        .facts
        .iter()
        .map(|(label, _)| label.len())
        .max()
        .unwrap_or(0);
    let mut text = format!("{} {}", ink("refused:", Tone::Bad), refusal.headline);
    for (label, fact) in &refusal.facts {
        text.push_str(&format!(
            "\n  {}  {fact}",
            style::padded(label, width, Tone::Faint)
        ));
    }
    text
}

#[cfg(test)]
mod tests {
    use mom_client::Code;

    use super::*;

    fn check(failure: &Failure, text: &str, json: &str) {
        assert_eq!(
            anstream::adapter::strip_str(&failure_text(failure)).to_string(),
            text
        );
        assert_eq!(failure_json(failure).to_string(), json);
    }

    #[test]
    fn failures_for_people_and_programs() {
        check(
            &Failure::new("cannot reach a hub", "start one\nor name another"),
            "error: cannot reach a hub\n  -> start one\n  -> or name another",
            r#"{"error":{"name":"failed","text":"cannot reach a hub","hint":"start one\nor name another"}}"#,
        );
        check(
            &Failure::Refused {
                what: "grab /x".to_owned(),
                error: WireError::new(Code::HELD, "/x is held by bob").owner("bob", 2),
            },
            "refused: grab /x: /x is held by bob\n  owner  bob, level 2\n  code   held (101)\n  try    wait for your turn with `mom grab --wait 5m`, or ask the owner with `mom request`",
            r#"{"error":{"code":101,"name":"held","text":"/x is held by bob","owner":"bob","owner-level":2,"what":"grab /x"}}"#,
        );
        check(
            &Failure::plain("lost"),
            "error: lost",
            r#"{"error":{"name":"failed","text":"lost","hint":null}}"#,
        );
    }
}
