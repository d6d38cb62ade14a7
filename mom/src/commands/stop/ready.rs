//! `mom stop --ready`: a connection that is there, and a key that stops.

use std::io::{IsTerminal as _, Read as _};
use std::time::Duration;

use mom_client::{Client, LinkState};
use ratatui::crossterm::terminal::{disable_raw_mode, enable_raw_mode};
use tokio::sync::{mpsc, watch};
use tokio::time::{Instant, sleep_until};

use super::{is_unknown, not_stopped, stopped, stopping};
use crate::cli;
use crate::failure::Failure;
use crate::output::Output;

/// A stop that is not answered so soon is told of: the hub waits for devices a second.
const LATE: Duration = Duration::from_millis(1500);

/// Stops at each key press, until Ctrl-C.
pub(super) async fn run(client: &Client, args: &cli::StopArgs, output: Output) -> Result<(), Failure> {
    // A key is heard at once, not with the end of its line; without a terminal each byte is one.
    let raw = std::io::stdin().is_terminal() && enable_raw_mode().is_ok();
    let ready = Ready {
        client,
        args,
        output,
        keys: keys(),
        link: client.state(),
        said: String::new(),
    };
    let result = ready.run().await;
    if raw {
        // What fails here leaves the terminal as it is; `reset` mends it.
        let _ = disable_raw_mode();
    }
    result
}

/// What a key means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Key {
    Stop,
    End,
}

struct Ready<'a> {
    client: &'a Client,
    args: &'a cli::StopArgs,
    output: Output,
    keys: mpsc::UnboundedReceiver<Key>,
    link: watch::Receiver<LinkState>,
    /// The last words about the link.
    said: String,
}

impl Ready<'_> {
    async fn run(mut self) -> Result<(), Failure> {
        self.say(&format!("ready: any key stops {}; Ctrl-C ends", self.args.path));
        loop {
            let key = tokio::select! {
                key = self.keys.recv() => key,
                changed = self.link.changed() => {
                    if changed.is_err() {
                        return Ok(());
                    }
                    self.say_link();
                    continue;
                }
            };
            if key != Some(Key::Stop) || !self.stop().await? {
                return Ok(());
            }
        }
    }

    /// Says it until the hub answers; false if the user ends it.
    async fn stop(&mut self) -> Result<bool, Failure> {
        let pressed = Instant::now();
        let mut late = false;
        loop {
            let sent = stopping(self.client, self.args).send();
            tokio::pin!(sent);
            let error = loop {
                tokio::select! {
                    answer = &mut sent => match answer {
                        Ok(report) => {
                            return match stopped(&report, self.args.measured, self.output) {
                                Ok(()) | Err(Failure::Told) => Ok(true),
                                Err(failure) => {
                                    self.say(&failure.to_string());
                                    Ok(true)
                                }
                            };
                        }
                        Err(error) => break error,
                    },
                    () = sleep_until(pressed + LATE), if !late => {
                        late = true;
                        self.say("no answer yet: it is unknown whether anything has stopped; the stop is sent again as soon as the hub answers");
                    }
                    () = self.ended() => return Ok(false),
                }
            };
            let again = is_unknown(&error);
            self.say(&not_stopped(&self.args.path, error).to_string());
            if !again {
                return Ok(true);
            }
            late = true;
            if !self.connected().await? {
                return Ok(false);
            }
        }
    }

    /// Waits for a connection; false if the user ends it.
    async fn connected(&mut self) -> Result<bool, Failure> {
        let mut link = self.client.state();
        let ends = |state: &LinkState| matches!(state, LinkState::Connected | LinkState::Closed(_));
        tokio::select! {
            state = link.wait_for(ends) => match state.as_deref() {
                Ok(LinkState::Connected) => Ok(true),
                _ => Err(Failure::plain("the hub has closed the connection for good")),
            },
            () = self.ended() => Ok(false),
        }
    }

    /// Says what becomes of the link, until the user ends it. Further keys say what is being said; where none come any more the answer
    /// does all the same.
    async fn ended(&mut self) {
        loop {
            tokio::select! {
                Some(key) = self.keys.recv() => if key == Key::End {
                    return;
                },
                changed = self.link.changed() => {
                    if changed.is_err() {
                        return;
                    }
                    self.say_link();
                }
            }
        }
    }

    fn say_link(&mut self) {
        let words = match &*self.link.borrow() {
            LinkState::Connected => format!("connected: any key stops {}", self.args.path),
            LinkState::Stale { .. } => "the hub is silent".to_owned(),
            LinkState::Resuming { .. } | LinkState::Trying { .. } => {
                "the connection is lost: a stop is said as soon as it is back".to_owned()
            }
            LinkState::Closed(Some(error)) => format!("the hub has closed the connection: {error}"),
            LinkState::Closed(None) => "the connection is closed".to_owned(),
        };
        // Each attempt to connect is a state of its own.
        if words != self.said {
            self.say(&words);
            self.said = words;
        }
    }

    /// A line; in a raw terminal its end goes down, and not back.
    fn say(&self, words: &str) {
        self.output.remark(format_args!("{words}\r"));
    }
}

/// The keys that are pressed; a thread waits for them, which ends with the program.
fn keys() -> mpsc::UnboundedReceiver<Key> {
    let (sender, receiver) = mpsc::unbounded_channel();
    let terminal = std::io::stdin().is_terminal();
    std::thread::spawn(move || {
        let typed = std::io::stdin().lock().bytes().map_while(Result::ok);
        // Without a terminal a line's end belongs to the key before it.
        let pressed = typed.filter(|byte| terminal || *byte != b'\n').map(key);
        pressed.map_while(|key| sender.send(key).ok()).for_each(drop);
    });
    receiver
}

fn key(byte: u8) -> Key {
    match byte {
        // Ctrl-C, Ctrl-D: a terminal in raw mode makes no signal of it.
        0x03 | 0x04 => Key::End,
        _ => Key::Stop,
    }
}
