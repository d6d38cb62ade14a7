//! The progress of the commands (M42): a moving line at a terminal, one line per change elsewhere.

use std::fmt;
use std::io::{self, IsTerminal as _};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use mom_drive::{CommandEnd, How, Progress};
use serde_json::{Value as Json, json};

use super::script::ScriptLine;
use crate::output::style::{Tone, ink};
use crate::output::{Output, to_json, words};

const TICK: Duration = Duration::from_millis(100);

/// Shows the commands of one run.
pub(super) struct ProgressDisplay {
    output: Output,
    total: usize,
    /// The moving line, at a terminal.
    bar: Option<ProgressBar>,
    begun: Instant,
    /// Why the command is sent again, as it was told last.
    again: Option<String>,
}

impl ProgressDisplay {
    pub(super) fn new(output: Output, total: usize) -> ProgressDisplay {
        let terminal = !output.is_json() && io::stdout().is_terminal() && io::stderr().is_terminal();
        ProgressDisplay {
            output,
            total,
            bar: terminal.then(make_bar),
            begun: Instant::now(),
            again: None,
        }
    }

    /// A command begins its way; `number` counts from 1.
    pub(super) fn begin(&mut self, number: usize, command: &ScriptLine) -> io::Result<()> {
        self.begun = Instant::now();
        self.again = None;
        if let Some(bar) = &self.bar {
            bar.set_prefix(format!("{number}/{}", self.total));
            bar.set_length(1);
            bar.set_position(0);
            bar.set_message(words::visible(&command.text));
            bar.enable_steady_tick(TICK);
            return Ok(());
        }
        self.output.tell(
            || change_json(number, command, "sending"),
            || {
                line(
                    number,
                    self.total,
                    ink("sending", Tone::Faint),
                    &words::visible(&command.text),
                )
            },
        )
    }

    /// A command has come further.
    pub(super) fn change(
        &mut self,
        number: usize,
        command: &ScriptLine,
        progress: &Progress,
    ) -> io::Result<()> {
        if let Progress::Again { why, .. } = progress
            && self.again.replace(why.clone()).as_ref() == Some(why)
        {
            return Ok(());
        }
        let Some(bar) = &self.bar else {
            return self.output.tell(
                || progress_json(number, command, progress),
                || progress_line(number, self.total, command, progress),
            );
        };
        if let Progress::Device { statement, of, .. } = progress {
            bar.set_length((*of).max(1).into());
            // A statement that has begun is not yet done.
            bar.set_position(statement.saturating_sub(1).into());
        }
        bar.set_message(format!(
            "{}  {}",
            state_words(progress),
            words::visible(&command.text)
        ));
        Ok(())
    }

    /// A command has ended by the device's word.
    pub(super) fn finish(&self, number: usize, command: &ScriptLine, end: &CommandEnd) -> io::Result<()> {
        let took = self.begun.elapsed();
        match &self.bar {
            None => self.output.tell(
                || end_json(number, command, end, took),
                || end_line(number, self.total, command, end, took),
            ),
            Some(bar) => bar.suspend(|| self.output.human(lasting_line(number, command, end, took))),
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

/// How far it has come: `executing 1 of 2`.
fn state_words(progress: &Progress) -> String {
    match progress {
        Progress::Device { state, statement, of } if *of > 1 && *statement > 0 => {
            format!("{} {statement} of {of}", words::visible(state))
        }
        Progress::Device { state, .. } => words::visible(state),
        Progress::Again { text, .. } => format!("not yet: {text}"),
    }
}

/// `[1/3] executing 1 of 2: move 100 50 200 0 0; grip close`
fn progress_line(number: usize, total: usize, command: &ScriptLine, progress: &Progress) -> String {
    let tone = match progress {
        Progress::Device { state, .. } if state == "executing" => Tone::Notice,
        _ => Tone::Faint,
    };
    let state = ink(state_words(progress), tone);
    line(number, total, state, &words::visible(&command.text))
}

fn line(number: usize, total: usize, state: impl fmt::Display, text: &str) -> String {
    let place = ink(format_args!("[{number}/{total}]"), Tone::Faint);
    format!("{place} {state}: {text}")
}

fn end_line(number: usize, total: usize, command: &ScriptLine, end: &CommandEnd, took: Duration) -> String {
    let text = words::visible(&command.text);
    match end.is_finished() {
        true => {
            let state = ink(format_args!("finished in {}", words::duration(took)), Tone::Good);
            line(number, total, state, &text)
        }
        false => line(
            number,
            total,
            ink("error", Tone::Bad),
            &format!("{} ({text})", end.text),
        ),
    }
}

/// The line that stays at a terminal.
fn lasting_line(number: usize, command: &ScriptLine, end: &CommandEnd, took: Duration) -> String {
    let text = words::visible(&command.text);
    match end.is_finished() {
        true => {
            let took = ink(words::duration(took), Tone::Faint);
            format!("{} {number:>2}  {text}  {took}", ink("ok   ", Tone::Good))
        }
        false => format!(
            "{} {number:>2}  {text}\n          {}",
            ink("error", Tone::Bad),
            end.text
        ),
    }
}

fn change_json(number: usize, command: &ScriptLine, state: &str) -> Json {
    json!({
        "command": number,
        "line": command.line,
        "text": command.text,
        "state": state,
    })
}

fn progress_json(number: usize, command: &ScriptLine, progress: &Progress) -> Json {
    match progress {
        Progress::Device { state, statement, of } => {
            let mut json = change_json(number, command, state);
            add_statements(&mut json, *statement, *of);
            json
        }
        Progress::Again { why, .. } => {
            let mut json = change_json(number, command, "again");
            json["why"] = why.as_str().into();
            json
        }
    }
}

fn add_statements(json: &mut Json, statement: u32, of: u32) {
    if of > 0 {
        json["statement"] = statement.into();
        json["of"] = of.into();
    }
}

fn end_json(number: usize, command: &ScriptLine, end: &CommandEnd, took: Duration) -> Json {
    let (state, statement, of, error) = match &end.how {
        How::Failed(report) => ("error", report.statement, report.of, report.error.as_ref()),
        How::Finished(of) => ("finished", *of, *of, None),
        _ => ("error", 0, 0, None),
    };
    let mut json = change_json(number, command, state);
    add_statements(&mut json, statement, of);
    json["took"] = u64::try_from(took.as_millis()).unwrap_or(u64::MAX).into();
    if let Some(error) = error {
        json["error"] = to_json(error);
    }
    json
}
