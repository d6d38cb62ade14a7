//! `mom manage`: the chair's answers to the hub's questions.

use std::collections::VecDeque;
use std::io;

use mom_client::{Client, ClientError, Code, Consult, LinkState, Thinning};
use serde_json::{Value as Json, json};
use tokio::time::Instant;

use super::hold::wait;
use super::watch::events;
use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::input::Answers;
use crate::output::style::{Tone, ink};
use crate::output::{Output, words};
use mom_pages::Interrupt;

pub(crate) async fn run(args: &cli::ManageArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Reconnecting).await?;
    let mut interrupt = Interrupt::install()?;
    // Before the first question can come.
    let mut consults = client.consults();
    let mut joined = Vec::new();
    for path in &args.paths {
        let info = client.lookup(path).await.doing(format!("look up {path}"))?;
        joined.push(events(&client, &info, Thinning::default()).await?);
    }
    output.remark(ink(
        format_args!(
            "answering for {} as {}; Ctrl-C ends",
            args.paths.join(", "),
            client.name()
        ),
        Tone::Faint,
    ));
    let mut desk = Desk {
        output,
        allow_all: args.allow_all,
        waiting: VecDeque::new(),
    };
    let mut answers = match args.allow_all {
        true => Answers::none(),
        false => Answers::new(),
    };
    let result = loop {
        let done = tokio::select! {
            consult = consults.next() => match consult {
                Some(consult) => desk.take(consult).await,
                None => break Err(ended(&client)),
            },
            line = answers.next(desk.asks()) => match line {
                Some(line) => desk.answer(line).await,
                None => break desk.leave(),
            },
            () = wait(desk.deadline()) => desk.pass(),
            () = interrupt.wait() => break Ok(()),
        };
        if let Err(failure) = done {
            break Err(failure);
        }
    };
    drop(joined);
    client.close().await;
    result
}

/// Why there are no more questions.
fn ended(client: &Client) -> Failure {
    match &*client.state().borrow() {
        LinkState::Closed(Some(error)) => Failure::Refused {
            what: "the hub closed the connection".to_owned(),
            error: error.clone(),
        },
        _ => Failure::plain("the connection to the hub is closed"),
    }
}

/// The questions without an answer yet, the oldest first.
struct Desk {
    output: Output,
    allow_all: bool,
    waiting: VecDeque<(Consult, Option<Instant>)>,
}

/// The meaning of an input line.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Said {
    Allow,
    AllowFromNowOn,
    Deny(String),
}

impl Desk {
    fn asks(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// When the oldest question is answered by the hub itself.
    fn deadline(&self) -> Option<Instant> {
        self.waiting.front().and_then(|(_, deadline)| *deadline)
    }

    async fn take(&mut self, consult: Consult) -> Result<(), Failure> {
        self.output
            .tell(|| question_json(&consult), || question_line(&consult))?;
        if self.allow_all {
            return self.say(consult, Said::Allow).await;
        }
        let deadline = Instant::now().checked_add(consult.left());
        self.waiting.push_back((consult, deadline));
        if self.waiting.len() == 1 {
            self.prompt();
        }
        Ok(())
    }

    async fn answer(&mut self, line: io::Result<String>) -> Result<(), Failure> {
        let Some(said) = Said::read(&line?) else {
            self.prompt();
            return Ok(());
        };
        let Some((consult, _)) = self.waiting.pop_front() else {
            return Ok(());
        };
        self.say(consult, said).await?;
        self.next();
        Ok(())
    }

    async fn say(&self, consult: Consult, said: Said) -> Result<(), Failure> {
        let number = consult.number;
        let (answer, answered) = match &said {
            Said::Allow => ("allowed", consult.allow().await),
            Said::AllowFromNowOn => ("allowed from now on", consult.allow_from_now_on().await),
            Said::Deny(text) => ("denied", consult.deny(text).await),
        };
        match answered {
            Ok(()) => self.tell(number, answer, Tone::Good),
            Err(ClientError::Refused(error)) if error.code == Code::TOO_LATE => {
                self.tell(number, "too late: it is answered already, or over", Tone::Notice)
            }
            Err(error) => Err(Failure::of_client(format!("answer question {number}"), error)),
        }
    }

    /// The oldest question is over.
    fn pass(&mut self) -> Result<(), Failure> {
        if let Some((consult, _)) = self.waiting.pop_front() {
            self.tell(
                consult.number,
                "not answered in time, so the hub refuses",
                Tone::Bad,
            )?;
            self.next();
        }
        Ok(())
    }

    /// No answers will come any more.
    fn leave(&self) -> Result<(), Failure> {
        match self.waiting.len() {
            0 => {
                self.output.remark(ink("no more answers", Tone::Faint));
                Ok(())
            }
            open => Err(Failure::plain(format!(
                "the answers ended with {} open; the hub refuses them",
                words::count(open as u64, "question")
            ))),
        }
    }

    fn next(&self) {
        if let Some((consult, _)) = self.waiting.front() {
            self.output.remark(question_line(consult));
            self.prompt();
        }
    }

    fn prompt(&self) {
        self.output
            .remark(ink("  y yes, a yes from now on, n no, or n and why", Tone::Faint));
    }

    fn tell(&self, number: u64, answer: &str, colour: Tone) -> Result<(), Failure> {
        self.output.tell(
            || json!({"consult": number, "answer": answer}),
            || {
                format!(
                    "  {} {}",
                    ink(format_args!("#{number}"), Tone::Faint),
                    ink(answer, colour)
                )
            },
        )?;
        Ok(())
    }
}

impl Said {
    fn read(line: &str) -> Option<Said> {
        let line = line.trim();
        let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        match word {
            "y" | "yes" => Some(Said::Allow),
            "a" | "always" => Some(Said::AllowFromNowOn),
            "n" | "no" => Some(Said::Deny(rest.trim().to_owned())),
            _ => None,
        }
    }
}

fn question_json(consult: &Consult) -> Json {
    json!({
        "consult": consult.number,
        "verb": consult.verb,
        "context": consult.context.as_str(),
        "peer": consult.peer,
        "user": consult.user,
        "level": consult.level,
        "groups": consult.groups,
        "message": consult.message,
        "size": consult.size,
        "kind": consult.kind,
        "within": words::in_millis(consult.within),
        "rule": consult.rule,
    })
}

/// `#7 bob (level 1) wants to send command (12 B) to /robot/arm  5 s, rule chairs`
fn question_line(consult: &Consult) -> String {
    let path = ink(&consult.context, Tone::Place);
    let what = match (&consult.message, &consult.kind) {
        (Some(message), _) => {
            let size = consult
                .size
                .and_then(|size| usize::try_from(size).ok())
                .map(|size| format!(" ({})", words::size(size)));
            format!(
                "send {}{} to {path}",
                ink(words::visible(message), Tone::Strong),
                size.unwrap_or_default()
            )
        }
        (None, Some(kind)) if consult.verb == "create" => {
            format!("create the {} {path}", words::visible(kind))
        }
        _ => format!("{} {path}", ink(words::visible(&consult.verb), Tone::Strong)),
    };
    let rule = match &consult.rule {
        Some(rule) => format!(", asked by {}", words::visible(rule)),
        None => String::new(),
    };
    format!(
        "{} {} wants to {what}{}",
        ink(format_args!("#{}", consult.number), Tone::Faint),
        who(consult),
        ink(
            format_args!("  {} to answer{rule}", words::duration(consult.left())),
            Tone::Faint
        )
    )
}

/// `bob~2 (bob, level 1, students)`
fn who(consult: &Consult) -> String {
    let mut facts = Vec::new();
    if consult.user != consult.peer {
        facts.push(words::visible(&consult.user));
    }
    facts.push(format!("level {}", consult.level));
    facts.extend(consult.groups.iter().map(|group| words::visible(group)));
    format!(
        "{} ({})",
        ink(words::visible(&consult.peer), Tone::Peer),
        facts.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_line_says() {
        for (line, said) in [
            ("y", Some(Said::Allow)),
            (" yes ", Some(Said::Allow)),
            ("a", Some(Said::AllowFromNowOn)),
            ("n", Some(Said::Deny(String::new()))),
            (
                "n  not now, please",
                Some(Said::Deny("not now, please".to_owned())),
            ),
            ("", None),
            ("nobody", None),
        ] {
            assert_eq!(Said::read(line), said, "{line:?}");
        }
    }
}
