//! `mom token`: a token's owner, queue, offers and lease.

use std::time::Duration;

use mom_client::{Code, ContextKind, TokenInfo, Value, WireError};

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::event::member_words;
use crate::output::style::{Tone, ink, padded};
use crate::output::{Output, to_json, words};

/// Letters of the lease's bar.
const BAR: u32 = 20;
/// Letters of the labels.
const LABEL: usize = 8;
/// The most entries shown of a queue; of the others only the number.
const SHOWN: usize = 10;

pub(crate) async fn run(args: &cli::TokenArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let path = &args.path;
    let info = client.info(path).await.doing(format!("look at {path}"))?;
    client.close().await;
    let kind = info.get("kind").and_then(Value::as_str).unwrap_or_default();
    if kind != ContextKind::Token.word() {
        let text = format!("{path} is a {}, not a token", words::visible(kind));
        return Err(Failure::Refused {
            what: format!("look at {path}"),
            error: WireError::new(Code::WRONG_KIND, text),
        });
    }
    output.tell(|| to_json(&info), || picture(path, &TokenInfo::read(&info)))?;
    Ok(())
}

/// The token, a line for each fact.
fn picture(path: &str, info: &TokenInfo) -> String {
    let mut lines = vec![format!("{}  fence {}", ink(path, Tone::Strong), info.fence)];
    let mut fact = |label: &str, text: String| {
        lines.push(format!("  {}  {text}", padded(label, LABEL, Tone::Faint)));
    };
    fact("owner", owner(path, info));
    if let Some(lease) = lease(info) {
        fact("lease", lease);
    }
    if let Some(deadman) = info.deadman {
        let every = words::duration(deadman);
        fact("deadman", format!("lost after {every} without a renewal"));
    }
    if let Some(given) = &info.delegated {
        let left = words::extent(given.left, given.commands);
        fact(
            "given by",
            format!("{}, still{left}", words::visible(&given.from)),
        );
    }
    if let Some(offer) = &info.offer {
        let extent = words::extent(offer.time, offer.commands);
        let left = words::duration(offer.within);
        fact(
            "offered",
            format!("to {}{extent}, {left} left to accept", words::visible(&offer.to)),
        );
    }
    for asking in &info.requests {
        let left = words::duration(asking.within);
        fact(
            "asked by",
            format!("{}, {left} left to answer", words::visible(&asking.peer)),
        );
    }
    for (label, text) in queue(info) {
        fact(label, text);
    }
    lines.join("\n")
}

fn owner(path: &str, info: &TokenInfo) -> String {
    if !info.holders.is_empty() {
        let holders: Vec<String> = info.holders.iter().map(|peer| words::visible(peer)).collect();
        let (verb, who) = match holders.len() {
            1 => ("inhibits", ""),
            _ => ("inhibit", "all of "),
        };
        return format!("nobody: {who}{} {verb} it", ink(holders.join(", "), Tone::Peer));
    }
    if let Some(owner) = &info.owner {
        let level = info.owner_level.map(|level| format!(" (level {level})"));
        let held = info
            .held
            .map(|held| format!(", for {} now", words::duration(held)));
        return format!(
            "{}{}{}",
            ink(words::visible(owner), Tone::Peer),
            level.unwrap_or_default(),
            held.unwrap_or_default()
        );
    }
    if let Some(reserved) = &info.reserved {
        let left = words::duration(reserved.time);
        return match &reserved.peer {
            Some(peer) => format!(
                "nobody; reserved for {}, its owner before the hub's restart, for {left}",
                words::visible(peer)
            ),
            None => format!("nobody; reserved for {left}, because its last owner is unknown"),
        };
    }
    format!("{}; grab it with: mom grab {path}", ink("nobody", Tone::Good))
}

/// `████████░░░░  1 min 41 s of 3 min left, then the next grab takes it`
fn lease(info: &TokenInfo) -> Option<String> {
    let lease = info.lease?;
    if info.owner.is_none() {
        return Some(format!("{} from a grab on", words::duration(lease)));
    }
    let left = info.lease_left.unwrap_or_default();
    let full = words::duration(lease);
    let then = match (info.expiry.as_deref(), left.is_zero()) {
        (Some("eager"), _) => "then it is lost",
        (_, true) => "the next grab takes it",
        (_, false) => "then the next grab takes it",
    };
    let filled = cells(left, lease);
    let bar = format!(
        "{}{}",
        ink("█".repeat(filled), Tone::Notice),
        ink("░".repeat(BAR as usize - filled), Tone::Faint)
    );
    Some(match left.is_zero() {
        true => format!("{bar}  {full} are over, {then}"),
        false => format!("{bar}  {} of {full} left, {then}", words::duration(left)),
    })
}

/// How many letters of the bar are filled; at least one as long as anything is left.
fn cells(left: Duration, lease: Duration) -> usize {
    if left.is_zero() || lease.is_zero() {
        return 0;
    }
    let part = left.as_secs_f64() / lease.as_secs_f64();
    // Between 0 and the width, so nothing is cut off.
    let filled = (part * f64::from(BAR)).round().clamp(1.0, f64::from(BAR));
    filled as usize
}

fn queue(info: &TokenInfo) -> Vec<(&'static str, String)> {
    let mut lines = Vec::new();
    for (place, waiting) in info.queue.iter().take(SHOWN).enumerate() {
        let label = if place == 0 { "queue" } else { "" };
        lines.push((
            label,
            format!(
                "{}  {}, waiting for {}",
                place + 1,
                member_words(&waiting.member),
                words::duration(waiting.waiting)
            ),
        ));
    }
    let more = info.queue.len().saturating_sub(SHOWN);
    if more > 0 {
        lines.push(("", format!("and {more} more")));
    }
    lines
}

#[cfg(test)]
mod tests {
    use mom_client::Map;

    use super::*;

    fn check(info: &Map, lines: &[&str]) {
        let picture = picture("/t", &TokenInfo::read(info));
        let plain = anstream::adapter::strip_str(&picture).to_string();
        assert_eq!(plain.lines().collect::<Vec<_>>(), lines);
    }

    fn peer(name: &str) -> Map {
        Map::new().with("peer", name).with("user", name).with("level", 1)
    }

    #[test]
    fn a_token_that_many_want() {
        let queue = vec![
            peer("bob").with("waiting", 12_000).into(),
            peer("dan").with("waiting", 3000).into(),
        ];
        let info = Map::new()
            .with("fence", (1 << 20) + 7)
            .with("owner", "alice")
            .with("owner-level", 5)
            .with("held", 123_000)
            .with("lease", 180_000)
            .with("lease-left", 90_000)
            .with("expiry", "lazy")
            .with("deadman", 2000)
            .with("queue", queue)
            .with(
                "offer",
                Map::new()
                    .with("to", "bob")
                    .with("within", 8000)
                    .with("commands", 3),
            )
            .with(
                "requests",
                vec![Map::new().with("peer", "dan").with("within", 21_000).into()],
            )
            .with("delegated", Map::new().with("from", "carol").with("left", 41_000));
        check(
            &info,
            &[
                "/t  fence 1048583",
                "  owner     alice (level 5), for 2 min 3 s now",
                "  lease     ██████████░░░░░░░░░░  1 min 30 s of 3 min left, then the next grab takes it",
                "  deadman   lost after 2 s without a renewal",
                "  given by  carol, still for 41 s",
                "  offered   to bob for 3 commands, 8 s left to accept",
                "  asked by  dan, 21 s left to answer",
                "  queue     1  bob (level 1), waiting for 12 s",
                "            2  dan (level 1), waiting for 3 s",
            ],
        );
    }

    #[test]
    fn a_token_that_nobody_has() {
        let free = || Map::new().with("fence", 0);
        check(
            &free().with("lease", 180_000),
            &[
                "/t  fence 0",
                "  owner     nobody; grab it with: mom grab /t",
                "  lease     3 min from a grab on",
            ],
        );
        let holders = |names: &[&str]| names.iter().map(|name| (*name).into()).collect::<Vec<Value>>();
        check(
            &free().with("holders", holders(&["bob", "dan"])),
            &["/t  fence 0", "  owner     nobody: all of bob, dan inhibit it"],
        );
        check(
            &free().with("reserved", Map::new().with("peer", "bob").with("for", 29_000)),
            &[
                "/t  fence 0",
                "  owner     nobody; reserved for bob, its owner before the hub's restart, for 29 s",
            ],
        );
    }

    #[test]
    fn the_bar_is_empty_only_when_nothing_is_left() {
        let seconds = Duration::from_secs;
        for (left, lease, filled) in [
            (0, 100, 0),
            (1, 100, 1),
            (50, 100, 10),
            (100, 100, 20),
            (101, 100, 20),
        ] {
            assert_eq!(cells(seconds(left), seconds(lease)), filled);
        }
        assert_eq!(cells(seconds(1), Duration::ZERO), 0);
    }
}
