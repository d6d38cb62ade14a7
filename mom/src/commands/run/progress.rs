//! The progress of the commands (M42): a moving line at a terminal, one line per change elsewhere.

use std::io::{self, IsTerminal as _};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use mom_arm::CommandState;
use mom_client::Value;
use serde_json::{Value as Json, json};

use super::script::ScriptLine;
use crate::output::style::{Tone, ink};
use crate::output::{Output, to_json, words};

const TICK: Duration = Duration::from_millis(100);

/// A change of status of one command.
#[derive(Clone, Debug)]
pub(super) struct StatusChange {
    pub(super) state: CommandState,
    /// The statement being executed, 0 before the first.
    pub(super) statement: u32,
    /// How many statements the command has, 0 while that is not known.
    pub(super) of: u32,
    /// `{name, code, text}`, where the state is `error`.
    pub(super) error: Option<Value>,
}

impl StatusChange {
    /// A state without details.
    pub(super) fn to(state: CommandState) -> StatusChange {
        StatusChange {
            state,
            statement: 0,
            of: 0,
            error: None,
        }
    }

    fn is_end(&self) -> bool {
        matches!(self.state, CommandState::Finished | CommandState::Error)
    }
}

/// Shows the commands of one run.
pub(super) struct ProgressDisplay {
    output: Output,
    total: usize,
    /// The moving line, at a terminal.
    bar: Option<ProgressBar>,
    begun: Instant,
}

impl ProgressDisplay {
    pub(super) fn new(output: Output, total: usize) -> ProgressDisplay {
        let terminal = !output.is_json() && io::stdout().is_terminal() && io::stderr().is_terminal();
        ProgressDisplay {
            output,
            total,
            bar: terminal.then(make_bar),
            begun: Instant::now(),
        }
    }

    /// A command begins its way; `number` counts from 1.
    pub(super) fn begin(&mut self, number: usize, command: &ScriptLine) {
        self.begun = Instant::now();
        if let Some(bar) = &self.bar {
            bar.set_prefix(format!("{number}/{}", self.total));
            bar.set_length(1);
            bar.set_position(0);
            bar.set_message(words::visible(&command.text));
            bar.enable_steady_tick(TICK);
        }
    }

    /// A command has come further.
    pub(super) fn change(
        &self,
        number: usize,
        command: &ScriptLine,
        change: &StatusChange,
    ) -> io::Result<()> {
        let took = self.begun.elapsed();
        match &self.bar {
            None => self.output.tell(
                || change_json(number, command, change, took),
                || change_line(number, self.total, command, change, took),
            ),
            Some(bar) if change.is_end() => {
                bar.suspend(|| self.output.human(end_line(number, command, change, took)))
            }
            Some(bar) => {
                bar.set_length(change.of.max(1).into());
                // A statement that has begun is not yet done.
                bar.set_position(change.statement.saturating_sub(1).into());
                let step = match change.of {
                    0 | 1 => String::new(),
                    of => format!(" {} of {of}", change.statement),
                };
                bar.set_message(format!(
                    "{}{step}  {}",
                    word(change.state),
                    words::visible(&command.text)
                ));
                Ok(())
            }
        }
    }

    /// Removes the moving line.
    pub(super) fn end(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

fn make_bar() -> ProgressBar {
    let bar = ProgressBar::new(1);
    if let Ok(style) = ProgressStyle::with_template("{spinner} {prefix} [{bar:12}] {wide_msg}") {
        bar.set_style(style.progress_chars("=> "));
    }
    bar
}

/// `[1/3] executing 1 of 2: move 100 50 200 0 0; grip close`
fn change_line(
    number: usize,
    total: usize,
    command: &ScriptLine,
    change: &StatusChange,
    took: Duration,
) -> String {
    let step = match (change.state, change.of) {
        (CommandState::Executing, of) if of > 1 => format!(" {} of {of}", change.statement),
        (CommandState::Finished, _) => format!(" in {}", words::duration(took)),
        _ => String::new(),
    };
    let state = ink(format_args!("{}{step}", word(change.state)), colour(change.state));
    let text = match &change.error {
        Some(error) => format!("{} ({})", error_words(error), words::visible(&command.text)),
        None => words::visible(&command.text),
    };
    format!(
        "{} {state}: {text}",
        ink(format_args!("[{number}/{total}]"), Tone::Faint)
    )
}

/// The line that stays at a terminal.
fn end_line(number: usize, command: &ScriptLine, change: &StatusChange, took: Duration) -> String {
    let text = words::visible(&command.text);
    match &change.error {
        None => {
            let took = ink(words::duration(took), Tone::Faint);
            format!("{} {number:>2}  {text}  {took}", ink("ok   ", Tone::Good))
        }
        Some(error) => {
            format!(
                "{} {number:>2}  {text}\n          {}",
                ink("error", Tone::Bad),
                error_words(error)
            )
        }
    }
}

fn change_json(number: usize, command: &ScriptLine, change: &StatusChange, took: Duration) -> Json {
    let mut json = json!({
        "command": number,
        "line": command.line,
        "text": command.text,
        "state": word(change.state),
    });
    if change.of > 0 {
        json["statement"] = change.statement.into();
        json["of"] = change.of.into();
    }
    if change.is_end() {
        json["took"] = u64::try_from(took.as_millis()).unwrap_or(u64::MAX).into();
    }
    if let Some(error) = &change.error {
        json["error"] = to_json(error);
    }
    json
}

/// The robot's words for what went wrong, with its code (M53).
pub(crate) fn error_words(error: &Value) -> String {
    let text = error
        .get("text")
        .and_then(Value::as_str)
        .unwrap_or("it failed, and the robot does not say why");
    let mut shown = String::new();
    if let Some(statement) = error.get("statement").and_then(Value::as_int)
        && !text.starts_with("statement ")
    {
        shown.push_str(&format!("statement {statement}: "));
    }
    shown.push_str(&words::visible(text));
    let name = error.get("name").and_then(Value::as_str).map(words::visible);
    let code = error
        .get("code")
        .and_then(Value::as_int)
        .map(|code| code.to_string());
    let known: Vec<String> = [name, code].into_iter().flatten().collect();
    if !known.is_empty() {
        shown.push_str(&format!(" [{}]", known.join(" ")));
    }
    shown
}

fn word(state: CommandState) -> &'static str {
    match state {
        CommandState::Waiting => "waiting",
        CommandState::Sending => "sending",
        CommandState::Executing => "executing",
        CommandState::Finished => "finished",
        CommandState::Error => "error",
    }
}

fn colour(state: CommandState) -> Tone {
    match state {
        CommandState::Waiting | CommandState::Sending => Tone::Faint,
        CommandState::Executing => Tone::Notice,
        CommandState::Finished => Tone::Good,
        CommandState::Error => Tone::Bad,
    }
}

#[cfg(test)]
mod tests {
    use mom_client::Map;

    use super::*;

    fn check(change: &StatusChange, line: &str, end: Option<&str>, json: &str) {
        let command = ScriptLine {
            line: 7,
            indent: 0,
            text: "home; grip close".to_owned(),
        };
        let took = Duration::from_millis(4100);
        let plain = |text: String| anstream::adapter::strip_str(&text).to_string();
        assert_eq!(plain(change_line(2, 3, &command, change, took)), line);
        assert_eq!(change_json(2, &command, change, took).to_string(), json);
        assert_eq!(change.is_end(), end.is_some());
        if let Some(end) = end {
            assert_eq!(plain(end_line(2, &command, change, took)), end);
        }
    }

    #[test]
    fn every_state_of_a_command() {
        check(
            &StatusChange::to(CommandState::Sending),
            "[2/3] sending: home; grip close",
            None,
            r#"{"command":2,"line":7,"text":"home; grip close","state":"sending"}"#,
        );
        check(
            &StatusChange {
                statement: 1,
                of: 2,
                ..StatusChange::to(CommandState::Executing)
            },
            "[2/3] executing 1 of 2: home; grip close",
            None,
            r#"{"command":2,"line":7,"text":"home; grip close","state":"executing","statement":1,"of":2}"#,
        );
        check(
            &StatusChange {
                statement: 2,
                of: 2,
                ..StatusChange::to(CommandState::Finished)
            },
            "[2/3] finished in 4.1 s: home; grip close",
            Some("ok     2  home; grip close  4.1 s"),
            r#"{"command":2,"line":7,"text":"home; grip close","state":"finished","statement":2,"of":2,"took":4100}"#,
        );
        let error = Map::new()
            .with("name", "joint-limit")
            .with("code", 5005)
            .with("text", "too far")
            .with("statement", 2);
        check(
            &StatusChange {
                error: Some(error.into()),
                ..StatusChange::to(CommandState::Error)
            },
            "[2/3] error: statement 2: too far [joint-limit 5005] (home; grip close)",
            Some("error  2  home; grip close\n          statement 2: too far [joint-limit 5005]"),
            r#"{"command":2,"line":7,"text":"home; grip close","state":"error","took":4100,"error":{"name":"joint-limit","code":5005,"text":"too far","statement":2}}"#,
        );
    }

    #[test]
    fn an_error_without_words_is_still_told() {
        assert_eq!(
            error_words(&Value::Null),
            "it failed, and the robot does not say why"
        );
        let twice = Map::new().with("text", "statement 1: no").with("statement", 1);
        assert_eq!(error_words(&twice.into()), "statement 1: no");
    }
}
