//! The table of peers: its columns, their order, and its forms for a script.

use std::cmp::Ordering;
use std::time::Duration;

use mom_client::ConnectedPeer;
use serde_json::{Value as Json, json};

use super::sample::{Holds, Owned, Rates, Sample, Stopped};
use crate::output::style::{Tone, ink};
use crate::output::words;

/// The columns, in the order in which they are shown.
pub(super) const COLUMNS: [Column; 9] = [
    Column::Peer,
    Column::User,
    Column::Door,
    Column::From,
    Column::Silent,
    Column::RoundTrip,
    Column::Queue,
    Column::Dropped,
    Column::Tokens,
];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Column {
    Peer,
    User,
    Door,
    From,
    Silent,
    RoundTrip,
    Queue,
    Dropped,
    Tokens,
}

impl Column {
    pub(super) fn heading(self) -> &'static str {
        match self {
            Column::Peer => "peer",
            Column::User => "user",
            Column::Door => "door",
            Column::From => "from",
            Column::Silent => "silent",
            Column::RoundTrip => "round trip",
            Column::Queue => "queue",
            Column::Dropped => "drops",
            Column::Tokens => "tokens",
        }
    }

    /// Numbers are right-aligned.
    pub(super) fn is_number(self) -> bool {
        use Column::{Dropped, Queue, RoundTrip, Silent};
        matches!(self, Silent | RoundTrip | Queue | Dropped)
    }

    /// The peer with the most of a number comes first, words are in their own order.
    fn compare(self, one: &Row<'_>, other: &Row<'_>) -> Ordering {
        let (a, b) = (one.peer, other.peer);
        match self {
            Column::Peer => a.peer.cmp(&b.peer),
            Column::User => a.user.cmp(&b.user),
            Column::Door => door(a).cmp(&door(b)),
            Column::From => a.from.cmp(&b.from),
            Column::Silent => b.heard.cmp(&a.heard),
            Column::RoundTrip => b.round_trip.cmp(&a.round_trip),
            Column::Queue => b.queued.cmp(&a.queued),
            Column::Dropped => b.dropped.cmp(&a.dropped),
            Column::Tokens => other.tokens.len().cmp(&one.tokens.len()),
        }
    }
}

/// One peer, and the tokens that it owns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row<'a> {
    peer: &'a ConnectedPeer,
    tokens: &'a [mom_client::Path],
}

impl Row<'_> {
    pub(super) fn cell(&self, column: Column) -> String {
        let peer = self.peer;
        match column {
            Column::Peer => words::visible(&peer.peer),
            Column::User => words::visible(&peer.user),
            Column::Door => door(peer),
            Column::From => peer.from.as_deref().map_or_else(String::new, words::visible),
            Column::Silent => silence(peer.heard),
            Column::RoundTrip => peer.round_trip.map_or_else(|| "-".to_owned(), words::measured),
            Column::Queue => bytes(peer.queued),
            Column::Dropped => peer.dropped.to_string(),
            Column::Tokens => {
                let paths: Vec<String> = self
                    .tokens
                    .iter()
                    .map(|path| words::visible(path.as_str()))
                    .collect();
                paths.join(" ")
            }
        }
    }
}

/// The rows in the order of a column; where that is equal, in that of arrival.
pub(super) fn rows<'a>(
    sample: &'a Sample,
    owned: &'a Owned,
    by: Option<Column>,
    reversed: bool,
) -> Vec<Row<'a>> {
    let row = |peer: &'a ConnectedPeer| Row {
        peer,
        tokens: owned.get(&peer.peer).map_or(&[], Vec::as_slice),
    };
    let mut rows: Vec<Row<'a>> = sample.stats.peers.iter().map(row).collect();
    if let Some(column) = by {
        rows.sort_by(|one, other| column.compare(one, other));
    }
    if reversed {
        rows.reverse();
    }
    rows
}

/// `tcp binary`, `websocket tls json`.
fn door(peer: &ConnectedPeer) -> String {
    let tls = if peer.tls { " tls" } else { "" };
    let form = match peer.form.as_str() {
        "none" => String::new(),
        form => format!(" {}", words::visible(form)),
    };
    format!("{}{tls}{form}", words::visible(&peer.door))
}

fn silence(time: Duration) -> String {
    match time.as_secs() {
        0..60 => words::measured(time),
        seconds => words::duration(Duration::from_secs(seconds)),
    }
}

pub(super) fn bytes(count: u64) -> String {
    words::size(usize::try_from(count).unwrap_or(usize::MAX))
}

/// How many there are, and what they do.
pub(super) fn summary(sample: &Sample, rates: Option<Rates>) -> String {
    let mut parts = vec![words::count(sample.connections(), "connection")];
    if let Some(memory) = &sample.stats.memory {
        parts.push(match memory.bound {
            Some(bound) => format!("hub keeps {} of at most {}", bytes(memory.used), bytes(bound)),
            None => format!("hub keeps {}", bytes(memory.used)),
        });
    }
    if let Some(rates) = rates {
        let speed = |rate: f64| format!("{}/s", bytes(rate as u64));
        parts.push(format!("in {}, out {}", speed(rates.received), speed(rates.sent)));
        parts.push(format!(
            "{:.0} messages/s, {:.0} dropped/s",
            rates.messages, rates.dropped
        ));
    }
    parts.join("   ")
}

/// What is stopped and by whom; none if nothing is.
pub(super) fn stopped(stopped: &Stopped) -> Option<String> {
    let (path, state) = stopped.first_key_value()?;
    let first = format!("{}: {}", words::visible(path.as_str()), words::stopped_by(state));
    Some(match stopped.len() {
        1 => first,
        more => format!("{first}, and {} more; mom tree shows all", more - 1),
    })
}

/// How many peers are not listed.
pub(super) fn more(sample: &Sample) -> Option<String> {
    let more = sample.stats.more_peers;
    (more > 0).then(|| format!("and {more} more peers, which the hub does not list"))
}

/// The table as text.
pub(super) fn text(hub: &str, sample: &Sample, holds: &Holds) -> String {
    let rows = rows(sample, &holds.owned, None, false);
    let width = |column: Column| {
        let cells = rows.iter().map(|row| row.cell(column).chars().count());
        cells.max().unwrap_or_default().max(column.heading().len())
    };
    let widths = COLUMNS.map(width);
    let line = |cell: &dyn Fn(Column) -> String| {
        let cells = COLUMNS.iter().zip(widths).map(|(column, width)| {
            let cell = cell(*column);
            match column.is_number() {
                true => format!("{cell:>width$}"),
                false => format!("{cell:<width$}"),
            }
        });
        cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    let head = format!("{}   {}", ink(words::visible(hub), Tone::Place), clock(sample));
    let mut lines = vec![head, summary(sample, None)];
    lines.extend(stopped(&holds.stopped).map(|stopped| ink(stopped, Tone::Bad)));
    lines.push(ink(line(&|column| column.heading().to_owned()), Tone::Faint));
    lines.extend(rows.iter().map(|row| line(&|column| row.cell(column))));
    lines.extend(more(sample).map(|more| ink(more, Tone::Faint)));
    lines.join("\n")
}

/// The hub's clock, to the second.
pub(super) fn clock(sample: &Sample) -> String {
    let time = sample.stats.time.to_string();
    let seconds = time.split(['.', 'Z']).next().unwrap_or_default();
    format!("{} UTC", seconds.replace('T', " "))
}

/// As on the wire, and with tokens and rates.
pub(super) fn to_json(hub: &str, sample: &Sample, holds: &Holds, rates: Option<Rates>) -> Json {
    let micros = |time: Duration| u64::try_from(time.as_micros()).unwrap_or(u64::MAX);
    let peers = rows(sample, &holds.owned, None, false).into_iter().map(|row| {
        let peer = row.peer;
        json!({
            "peer": peer.peer, "user": peer.user,
            "form": peer.form, "door": peer.door, "tls": peer.tls, "from": peer.from,
            "since": peer.since.to_string(), "heard": micros(peer.heard),
            "round-trip": peer.round_trip.map(micros),
            "queued": peer.queued, "sent": peer.sent, "received": peer.received, "dropped": peer.dropped,
            "tokens": row.tokens.iter().map(|path| path.as_str()).collect::<Vec<_>>(),
        })
    });
    let stopped = holds.stopped.iter().map(|(path, state)| {
        json!({
            "path": path.as_str(), "number": state.number, "by": state.by, "reason": state.reason,
            "since": state.since.map(|since| since.to_string()), "only": state.only,
        })
    });
    let memory = sample.stats.memory.as_ref();
    json!({
        "hub": hub,
        "time": sample.stats.time.to_string(),
        "connections": sample.connections(),
        "memory": memory.map(|memory| json!({"used": memory.used, "bound": memory.bound})),
        "rates": rates.map(|rates| json!({
            "messages": rates.messages, "delivered": rates.delivered, "dropped": rates.dropped,
            "received": rates.received, "sent": rates.sent,
        })),
        "peers": peers.collect::<Vec<_>>(),
        "more-peers": sample.stats.more_peers,
        "stopped": stopped.collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use mom_client::{Path, StopState};

    use super::super::tests::{peer, stats};
    use super::*;

    fn sample() -> Sample {
        let alice = peer("alice", |peer| {
            (peer.queued, peer.dropped) = (2048, 3);
            peer.round_trip = Some(Duration::from_micros(420));
            peer.heard = Duration::from_secs(90);
        });
        let mut stats = stats(vec![
            alice,
            peer("bad\u{1b}[2J", |peer| (peer.tls, peer.from) = (true, None)),
        ]);
        stats.more_peers = 4;
        Sample::new(stats, Instant::now())
    }

    fn holds() -> Holds {
        let path = |text| Path::parse(text).unwrap();
        let stop = StopState {
            number: 7,
            stopped: true,
            by: Some("bob".to_owned()),
            reason: Some("smoke\u{7}".to_owned()),
            ..StopState::default()
        };
        Holds {
            owned: [("alice".to_owned(), vec![path("/robot/token")])].into(),
            stopped: [(path("/robot/arm"), stop.clone()), (path("/robot/mount"), stop)].into(),
        }
    }

    #[test]
    fn the_table() {
        let shown = text("bin://lab", &sample(), &holds());
        assert_eq!(
            anstream::adapter::strip_str(&shown).to_string(),
            "\
bin://lab   1970-01-01 00:00:00 UTC
6 connections   hub keeps 1.0 MiB of at most 2.0 MiB
/robot/arm: stopped by bob (smoke\\u{7}), and 1 more; mom tree shows all
peer          user          door            from           silent  round trip    queue  drops  tokens
alice         alice         tcp binary      127.0.0.1  1 min 30 s     0.42 ms  2.0 KiB      3  /robot/token
bad\\u{1b}[2J  bad\\u{1b}[2J  tcp tls binary                0.00 ms           -      0 B      0
and 4 more peers, which the hub does not list"
        );
    }

    #[test]
    fn the_order_of_a_column() {
        let (sample, owned) = (sample(), holds().owned);
        let names = |by, reversed| -> Vec<String> {
            let rows = rows(&sample, &owned, Some(by), reversed);
            rows.iter().map(|row| row.cell(Column::Peer)).collect()
        };
        for column in [
            Column::Queue,
            Column::Dropped,
            Column::RoundTrip,
            Column::Silent,
            Column::Tokens,
        ] {
            assert_eq!(names(column, false)[0], "alice", "{column:?}");
            assert_eq!(names(column, true)[1], "alice", "{column:?}");
        }
        assert_eq!(names(Column::From, false)[1], "alice");
    }

    #[test]
    fn the_json_form() {
        let json = to_json("bin://lab", &sample(), &holds(), None);
        assert_eq!(json["peers"][0]["tokens"], json!(["/robot/token"]));
        let stop = &json["stopped"][1];
        assert_eq!(
            (&stop["path"], &stop["number"]),
            (&json!("/robot/mount"), &json!(7))
        );
        assert_eq!(
            (&json["peers"][0]["round-trip"], &json["connections"]),
            (&json!(420), &json!(6))
        );
        assert_eq!(
            (&json["peers"][1]["from"], &json["rates"]),
            (&Json::Null, &Json::Null)
        );
    }
}
