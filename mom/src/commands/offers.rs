//! Waits for an offer of a token, to accept or decline it.

use std::time::Duration;

use mom_client::{Event, Events, Token};
use serde_json::json;
use tokio::time::Instant;

use super::hold::wait;
use crate::failure::Failure;
use crate::output::event::event_words;
use crate::output::style::{Tone, ink};
use crate::output::{Output, words};
use mom_pages::Interrupt;

/// The awaited offer, and how long to wait.
#[derive(Clone, Copy, Debug)]
pub(super) struct AwaitedOffer<'a> {
    /// To this peer, which waits.
    pub(super) me: &'a str,
    /// Only from this peer.
    pub(super) peer: Option<&'a str>,
    /// For ever if absent.
    pub(super) within: Option<Duration>,
}

/// Waits until a token is offered to this peer, and shows the offer.
pub(super) async fn offer(
    token: &Token,
    events: &mut Events,
    awaited: AwaitedOffer<'_>,
    interrupt: &mut Interrupt,
    output: Output,
) -> Result<(), Failure> {
    let (path, me) = (token.path(), awaited.me);
    output.remark(ink(
        format_args!("waiting for {path} to be offered to {me}; Ctrl-C ends"),
        Tone::Faint,
    ));
    let until = awaited.within.map(|within| Instant::now() + within);
    let event = tokio::select! {
        event = find(events, me, awaited.peer) => event,
        () = wait(until) => {
            let within = words::duration(awaited.within.unwrap_or_default());
            return Err(Failure::plain(format!("nobody offered {path} to {me} within {within}")));
        }
        () = interrupt.wait() => return Err(Failure::plain(format!("interrupted before {path} was offered"))),
    };
    let Some(event) = event else {
        return Err(Failure::plain(format!(
            "{path} is gone, or the connection to the hub"
        )));
    };
    let Event::Offer {
        by, time, commands, ..
    } = &event
    else {
        return Ok(());
    };
    output.tell(
        || {
            json!({"state": "offered", "path": path.as_str(), "by": by,
                   "for": time.map(words::in_millis), "commands": commands})
        },
        || event_words(&event),
    )?;
    Ok(())
}

async fn find(events: &mut Events, me: &str, from: Option<&str>) -> Option<Event> {
    loop {
        let event = events.next().await?;
        if let Event::Offer { by, to, .. } = &event
            && to == me
            && from.is_none_or(|from| from == by)
        {
            return Some(event);
        }
    }
}
