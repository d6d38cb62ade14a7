//! `mom stop` and `mom unstop`: all devices of a place, and what each of them says to it.

use std::collections::BTreeSet;
use std::time::Duration;

use mom_client::{Client, ClientError, Code, ContextInfo, ContextKind, Event, Events, Parcel, Value, event};
use serde_json::{Value as Json, json};
use tokio::task::JoinSet;
use tokio::time::{Instant, timeout_at};

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::style::{Tone, ink};
use crate::output::{Output, words};

/// Devices that say nothing for so long are silent.
const PATIENCE: Duration = Duration::from_secs(1);

/// What devices are told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Order {
    Stop,
    Unstop,
}

/// What came of it in one place.
#[derive(Debug)]
struct Outcome {
    path: String,
    result: Result<Heard, ClientError>,
}

/// Who said what.
#[derive(Debug, Default)]
struct Heard {
    /// Members whose queue took it.
    delivered: u64,
    /// Devices that have obeyed.
    obeyed: BTreeSet<String>,
    /// Devices that have not said so.
    silent: BTreeSet<String>,
    /// The hub does not tell this user who is there.
    unseen: bool,
}

pub(crate) async fn run(
    order: Order,
    args: &cli::StopArgs,
    global: &GlobalArgs,
    output: Output,
) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let what = format!("{} {}", order.word(), args.path);
    let top = client.lookup(&args.path).await.doing(what)?;
    if top.kind == ContextKind::Token {
        let text = format!("{} is a token; devices are in channels", top.path);
        return Err(Failure::usage(text, "see which channel it guards with: mom tree"));
    }
    let named = top.path.clone();
    let mut all = JoinSet::new();
    begin(&client, order, top, &mut all).await;
    let mut outcomes = Vec::new();
    while let Some(outcome) = all.join_next().await {
        let outcome = outcome.map_err(|error| Failure::plain(error.to_string()))?;
        // What this user may not stop is no device of theirs, unless they name it.
        let denied = outcome
            .result
            .as_ref()
            .is_err_and(|error| error.wire().is_some_and(|error| error.code == Code::DENIED));
        if !denied || outcome.path == named.as_str() {
            outcomes.push(outcome);
        }
    }
    client.close().await;
    outcomes.sort_by(|one, other| one.path.cmp(&other.path));
    tell(order, &outcomes, output)
}

impl Order {
    fn word(self) -> &'static str {
        match self {
            Order::Stop => event::STOP,
            Order::Unstop => event::UNSTOP,
        }
    }

    /// What a device does that has obeyed.
    fn obeyed(self) -> &'static str {
        match self {
            Order::Stop => "stands",
            Order::Unstop => "may move",
        }
    }

    /// Whether a device says by this that it has obeyed.
    fn is_answered_by(self, parcel: &Parcel) -> bool {
        let stopped = match parcel.value() {
            Value::Map(map) => map.get("stopped").cloned(),
            _ => None,
        };
        parcel.name() == "state" && stopped == Some(Value::Bool(self == Order::Stop))
    }
}

/// Begins with each channel as soon as it is known.
async fn begin(client: &Client, order: Order, top: ContextInfo, all: &mut JoinSet<Outcome>) {
    let mut contexts = vec![top];
    while let Some(context) = contexts.pop() {
        let path = context.path.to_string();
        match context.kind {
            ContextKind::Token => {}
            ContextKind::Channel => {
                let client = client.clone();
                all.spawn(async move {
                    let result = tell_channel(&client, order, &path).await;
                    Outcome { path, result }
                });
            }
            ContextKind::Session => match client.list(&path).await {
                Ok(children) => contexts.extend(children),
                Err(error) => {
                    let result = Err(error);
                    all.spawn(std::future::ready(Outcome { path, result }));
                }
            },
        }
    }
}

async fn tell_channel(client: &Client, order: Order, path: &str) -> Result<Heard, ClientError> {
    let channel = client.channel(path).await?;
    let mut events = channel.events();
    // The order first: who is there can be asked meanwhile.
    let (receipt, members) = tokio::join!(
        channel.message(order.word()).no_echo().send_acknowledged(),
        client.members(path)
    );
    let end = Instant::now() + PATIENCE;
    let mut heard = Heard {
        delivered: receipt?.delivered,
        unseen: members.is_err(),
        ..Heard::default()
    };
    let devices = members.unwrap_or_default().into_iter();
    heard.silent = devices
        .filter(|member| member.device)
        .map(|member| member.peer)
        .collect();
    listen(&mut events, order, end, &mut heard).await;
    Ok(heard)
}

/// Hears until all devices have said so, or the time is over.
async fn listen(events: &mut Events, order: Order, end: Instant, heard: &mut Heard) {
    while !heard.silent.is_empty() || (heard.unseen && heard.delivered > 0) {
        let Ok(Some(event)) = timeout_at(end, events.next()).await else {
            return;
        };
        let Event::Message(parcel) = event else { continue };
        if let Some(sender) = parcel.sender.as_deref()
            && order.is_answered_by(&parcel)
        {
            heard.silent.remove(sender);
            heard.obeyed.insert(sender.to_owned());
        }
    }
}

/// Tells what came of it; fails unless every device has obeyed.
fn tell(order: Order, outcomes: &[Outcome], output: Output) -> Result<(), Failure> {
    for outcome in outcomes {
        output.tell(|| outcome.json(), || outcome.line(order))?;
    }
    if outcomes.is_empty() {
        return Err(Failure::new(
            format!("there is nothing here that you may {}", order.word()),
            "see what there is with: mom tree",
        ));
    }
    match outcomes.iter().all(Outcome::is_good) {
        true => Ok(()),
        false => Err(Failure::Told),
    }
}

impl Outcome {
    /// Whether nobody is known, or suspected, that may not have obeyed.
    fn is_good(&self) -> bool {
        let is_good = |heard: &Heard| {
            let unknown = heard.unseen && heard.delivered > 0 && heard.obeyed.is_empty();
            heard.silent.is_empty() && !unknown
        };
        self.result.as_ref().is_ok_and(is_good)
    }

    fn json(&self) -> Json {
        match &self.result {
            Ok(heard) => json!({
                "path": self.path,
                "delivered": heard.delivered,
                "obeyed": heard.obeyed,
                "silent": heard.silent,
            }),
            Err(error) => json!({
                "path": self.path,
                "code": error.wire().map(|error| error.code.word()),
                "error": error.to_string(),
            }),
        }
    }

    fn line(&self, order: Order) -> String {
        let path = ink(&self.path, Tone::Place);
        let heard = match &self.result {
            Ok(heard) => heard,
            Err(error) => return format!("{path}: {}", ink(error, Tone::Bad)),
        };
        let named = |names: &BTreeSet<String>| {
            let names: Vec<String> = names.iter().map(|name| words::visible(name)).collect();
            names.join(", ")
        };
        let mut parts = Vec::new();
        if !heard.silent.is_empty() {
            let text = format!("{} said nothing within {PATIENCE:?}", named(&heard.silent));
            parts.push(ink(text, Tone::Bad));
        }
        if !heard.obeyed.is_empty() {
            let text = format!("{} {}", named(&heard.obeyed), order.obeyed());
            parts.push(ink(text, Tone::Good));
        }
        if parts.is_empty() {
            let told = words::count(heard.delivered, "member");
            let (text, tone) = match heard.unseen {
                true => (
                    format!("sent to {told}; you may not see who they are, and none answered"),
                    Tone::Notice,
                ),
                false => (format!("no device; sent to {told}"), Tone::Faint),
            };
            parts.push(ink(text, tone));
        }
        format!("{path}: {}", parts.join("; "))
    }
}

#[cfg(test)]
mod tests {
    use mom_client::{Family, Map};

    use super::*;

    #[test]
    fn only_a_state_that_says_so_is_an_answer() {
        let state = |stopped: Value| {
            Parcel::new(Family::Message, "state").content(Map::new().with("stopped", stopped))
        };
        let (stands, moves) = (state(true.into()), state(false.into()));
        assert!(Order::Stop.is_answered_by(&stands) && !Order::Stop.is_answered_by(&moves));
        assert!(Order::Unstop.is_answered_by(&moves) && !Order::Unstop.is_answered_by(&stands));
        for other in [
            state("yes".into()),
            Parcel::new(Family::Message, "state"),
            Parcel::new(Family::Message, "status").content(Map::new().with("stopped", true)),
        ] {
            assert!(!Order::Stop.is_answered_by(&other) && !Order::Unstop.is_answered_by(&other));
        }
    }
}
