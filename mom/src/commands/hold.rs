//! Holding a token until something ends it: for all commands that get one.

use std::collections::VecDeque;
use std::future::pending;
use std::io;
use std::time::Duration;

use mom_client::{Client, Event, Events, Lost, Member, Token, TokenGuard};
use serde_json::{Value as Json, json};
use tokio::time::{Instant, sleep, sleep_until};

use crate::cli;
use crate::failure::{Doing as _, Failure};
use crate::input::Answers;
use crate::output::event::member_words;
use crate::output::style::{Tone, ink};
use crate::output::{Output, words};
use mom_drive::loss_words;
use mom_pages::Interrupt;

/// The hub is asked for the lease this often during a lease, within bounds.
const LOOKS_PER_LEASE: u32 = 12;
const SOONEST: Duration = Duration::from_millis(100);
const LATEST: Duration = Duration::from_secs(10);

/// A token that is to be held, with its events since it was joined.
pub(super) struct TokenToHold<'a> {
    pub(super) client: &'a Client,
    pub(super) token: &'a Token,
    pub(super) events: Events,
    pub(super) guard: TokenGuard,
}

/// Holds a token until Ctrl-C, its time, or its loss, and shows what happens to it meanwhile.
pub(super) async fn hold(
    held: TokenToHold<'_>,
    args: &cli::HoldArgs,
    interrupt: &mut Interrupt,
    output: Output,
) -> Result<(), Failure> {
    let TokenToHold {
        client,
        token,
        events,
        mut guard,
    } = held;
    let path = token.path().as_str();
    tell_grabbed(path, &guard, output)?;
    let until = args.time.map(|time| Instant::now() + time);
    let mut visitors = Visitors {
        me: client.name(),
        token,
        events,
        asking: VecDeque::new(),
        answers: match args.answer {
            true => Answers::new(),
            false => Answers::none(),
        },
        output,
    };
    let end = tokio::select! {
        lost = guard.lost() => Err(lost),
        () = interrupt.wait() => Ok(()),
        () = wait(until) => Ok(()),
        // Only writing can fail there: nobody reads the output any more.
        error = watch_renewals(token, output) => return Err(error.into()),
        error = visitors.attend() => return Err(error),
    };
    match end {
        Ok(()) => {
            guard.release().await.doing(format!("release {path}"))?;
            tell_released(path, output)?;
            Ok(())
        }
        Err(lost) => tell_lost(path, &lost, output),
    }
}

pub(super) fn tell_grabbed(path: &str, guard: &TokenGuard, output: Output) -> Result<(), Failure> {
    output.tell(|| grabbed_json(path, guard), || grabbed_line(path, guard))?;
    output.remark(ink("Ctrl-C releases it", Tone::Faint));
    Ok(())
}

fn grabbed_json(path: &str, guard: &TokenGuard) -> Json {
    let mut json = json!({
        "state": "grabbed",
        "path": path,
        "fence": guard.fence(),
        "lease": guard.lease().map(words::in_millis),
    });
    if let Some(deadman) = guard.deadman() {
        json["deadman"] = words::in_millis(deadman).into();
    }
    if let Some(from) = guard.delegation() {
        json["from"] = from.from.as_str().into();
        json["for"] = from.time.map(words::in_millis).into();
        json["commands"] = from.commands.into();
    }
    json
}

fn grabbed_line(path: &str, guard: &TokenGuard) -> String {
    let renewal = guard.lease().into_iter().chain(guard.deadman()).min();
    let lease = match (guard.lease(), renewal) {
        (Some(lease), Some(shorter)) => format!(
            "lease {}, renewed every {}",
            words::duration(lease),
            words::duration(shorter / 3)
        ),
        (None, Some(deadman)) => format!("no lease, renewed every {}", words::duration(deadman / 3)),
        _ => "no lease".to_owned(),
    };
    let from = match guard.delegation() {
        Some(from) => format!(
            ", from {}{}",
            words::visible(&from.from),
            words::extent(from.time, from.commands)
        ),
        None => String::new(),
    };
    let head = ink(format_args!("holding {path}"), Tone::Good);
    format!("{head}  fence {}, {lease}{from}", guard.fence())
}

pub(super) fn tell_released(path: &str, output: Output) -> io::Result<()> {
    output.tell(
        || json!({"state": "released", "path": path}),
        || format!("released {path}"),
    )
}

/// Reports how a token was lost; returns whether the end was agreed on.
pub(super) fn tell_lost(path: &str, lost: &Lost, output: Output) -> Result<(), Failure> {
    let agreed = matches!(lost.reason.as_str(), "given" | "returned");
    let state = if agreed { lost.reason.as_str() } else { "lost" };
    output.tell(
        || json!({"state": state, "path": path, "reason": lost.reason, "by": lost.by}),
        || {
            let head = match agreed {
                true => ink(format_args!("no longer holding {path}:"), Tone::Notice),
                false => ink(format_args!("lost {path}:"), Tone::Bad),
            };
            format!("{head} {}", loss_words(lost))
        },
    )?;
    match agreed {
        true => Ok(()),
        false => Err(Failure::Told),
    }
}

/// Those who ask the owner for its token.
struct Visitors<'a> {
    me: String,
    token: &'a Token,
    events: Events,
    asking: VecDeque<String>,
    answers: Answers,
    output: Output,
}

impl Visitors<'_> {
    /// Shows requests and forwards the answers; ends only with an error.
    async fn attend(&mut self) -> Failure {
        loop {
            let done = tokio::select! {
                event = self.events.next() => match event {
                    Some(event) => self.show(&event),
                    // The guard knows what that means.
                    None => return pending().await,
                },
                line = self.answers.next(!self.asking.is_empty()) => match line {
                    Some(line) => self.answer(line).await,
                    None => Ok(()),
                },
            };
            if let Err(failure) = done {
                return failure;
            }
        }
    }

    fn show(&mut self, event: &Event) -> Result<(), Failure> {
        match event {
            Event::Requested {
                member, within, text, ..
            } if member.peer != self.me => {
                self.asking.push_back(member.peer.clone());
                self.tell_asking(member, *within, text.as_deref())
            }
            Event::Lapsed { what, by, reason, .. } if what == "request" && *by != self.me => {
                self.asking.retain(|asking| asking != by);
                self.tell(
                    "lapsed",
                    by,
                    &format!("no longer asks for it: {}", words::visible(reason)),
                )
            }
            _ => Ok(()),
        }
    }

    fn tell_asking(&self, member: &Member, within: Duration, text: Option<&str>) -> Result<(), Failure> {
        let path = self.token.path().as_str();
        self.output.tell(
            || {
                json!({"state": "requested", "path": path, "peer": member.peer, "user": member.user,
                       "level": member.level, "within": words::in_millis(within), "text": text})
            },
            || {
                let text = text.map(|text| format!(": {}", words::visible(text)));
                let how = match self.answers.is_open() {
                    true => "y hands it over for good, n does not",
                    false => "Ctrl-C releases it; with --answer you can hand it over",
                };
                format!(
                    "{} asks for it{}, {} to answer; {}",
                    member_words(member),
                    text.unwrap_or_default(),
                    words::duration(within),
                    ink(how, Tone::Faint)
                )
            },
        )?;
        Ok(())
    }

    async fn answer(&mut self, line: io::Result<String>) -> Result<(), Failure> {
        let line = line?;
        let (word, text) = line.trim().split_once(' ').unwrap_or((line.trim(), ""));
        let hands_over = match word {
            "y" | "yes" => true,
            "n" | "no" => false,
            _ => {
                self.output
                    .remark("y hands it over for good, n or n and why does not");
                return Ok(());
            }
        };
        let Some(peer) = self.asking.pop_front() else {
            return Ok(());
        };
        let answered = match hands_over {
            true => self.token.accept_request(&peer).await,
            false => self.token.decline_request(&peer, text.trim()).await,
        };
        match (answered, hands_over) {
            // The guard reports the loss.
            (Ok(()), true) => Ok(()),
            (Ok(()), false) => self.tell("declined", &peer, "is told no"),
            (Err(error), _) => {
                let failure = Failure::of_client(format!("answer {peer}"), error);
                self.output.failure(&failure);
                Ok(())
            }
        }
    }

    fn tell(&self, state: &str, peer: &str, what: &str) -> Result<(), Failure> {
        let path = self.token.path().as_str();
        self.output.tell(
            || json!({"state": state, "path": path, "peer": peer}),
            || format!("{} {what}", ink(words::visible(peer), Tone::Peer)),
        )?;
        Ok(())
    }
}

/// Reports each renewal, as shown by the hub's answer about the lease; ends only if that cannot be written.
async fn watch_renewals(token: &Token, output: Output) -> io::Error {
    let mut before: Option<Duration> = None;
    loop {
        let Ok(status) = token.status().await else {
            // A user that may not ask goes without; a lost link ends the guard.
            return pending().await;
        };
        let Some(lease) = status.lease else {
            return pending().await;
        };
        let left = status.lease_left.unwrap_or_default();
        if before.is_some_and(|before| left > before) {
            let told = output.tell(
                || json!({"state": "renewed", "path": token.path().as_str(), "lease-left": words::in_millis(left)}),
                || ink(format_args!("renewed, {} left", words::duration(left)), Tone::Faint),
            );
            if let Err(error) = told {
                return error;
            }
        }
        before = Some(left);
        sleep((lease / LOOKS_PER_LEASE).clamp(SOONEST, LATEST)).await;
    }
}

/// Until a time, or for ever.
pub(super) async fn wait(until: Option<Instant>) {
    match until {
        Some(until) => sleep_until(until).await,
        None => pending().await,
    }
}
