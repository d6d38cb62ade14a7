//! `mom stats`: statistics of channels as a table, once or repeatedly.

use std::collections::BTreeMap;
use std::time::Duration;

use mom_client::{ChannelStats, ContextKind, Counts, Stats};
use serde_json::{Value as Json, json};
use tokio::time::{MissedTickBehavior, interval};

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::style::{Tone, ink, padded};
use crate::output::{Output, words};
use mom_pages::Interrupt;

/// The columns after the name.
const HEADINGS: [&str; 7] = [
    "sent",
    "bytes",
    "delivered",
    "queued",
    "age p50",
    "age p99",
    "dropped",
];

pub(crate) async fn run(args: &cli::StatsArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let asking = || format!("ask for the statistics of {}", args.path);
    let kind = client.lookup(&args.path).await.doing(asking())?.kind;
    let tell = |stats: &Stats| output.tell(|| to_json(stats, kind), || table(stats, kind));
    let Some(seconds) = args.watch else {
        let stats = client.stats(&args.path).await.doing(asking())?;
        client.close().await;
        return Ok(tell(&stats)?);
    };
    let mut interrupt = Interrupt::install()?;
    let mut ticks = interval(Duration::from_secs(seconds));
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            () = interrupt.wait() => break,
            _ = ticks.tick() => {}
        }
        let stats = client.stats(&args.path).await.doing(asking())?;
        output.human(ink(stats.time, Tone::Faint))?;
        tell(&stats)?;
        output.human("")?;
    }
    client.close().await;
    Ok(())
}

/// The rows: of one channel itself and its members, or all channels of a session.
fn rows(stats: &Stats, kind: ContextKind) -> Vec<(String, &Counts)> {
    let channel = |channel: &ChannelStats| words::visible(channel.path.as_str());
    let mut rows: Vec<(String, &Counts)> = stats
        .channels
        .iter()
        .map(|stats| (channel(stats), &stats.all))
        .collect();
    if kind == ContextKind::Channel {
        let peers = stats.channels.iter().flat_map(|channel| &channel.peers);
        rows.extend(peers.map(|peer| (format!("  {}", words::visible(&peer.peer)), &peer.counts)));
    }
    rows
}

fn table(stats: &Stats, kind: ContextKind) -> String {
    let rows = rows(stats, kind);
    if rows.is_empty() {
        return "no channels here that you may ask about".to_owned();
    }
    let cells: Vec<(String, [String; 7])> = rows
        .into_iter()
        .map(|(name, counts)| (name, cells(counts)))
        .collect();
    let name_width = cells.iter().map(|(name, _)| name.chars().count()).max();
    let name_width = name_width.unwrap_or_default();
    let widths: Vec<usize> = HEADINGS
        .iter()
        .enumerate()
        .map(|(column, heading)| {
            let cells = cells.iter().map(|(_, cells)| cells[column].chars().count());
            cells.max().unwrap_or_default().max(heading.len())
        })
        .collect();
    let line = |name: String, cells: &[&str], as_ink: Option<Tone>| {
        let mut line = name;
        for (column, cell) in cells.iter().enumerate() {
            let last = column + 1 == HEADINGS.len();
            let blanks = " ".repeat(widths[column].saturating_sub(cell.chars().count()));
            let cell = match as_ink {
                Some(as_ink) => ink(cell, as_ink),
                None => (*cell).to_owned(),
            };
            // Numbers are right-aligned, words left-aligned.
            line.push_str(&if last {
                format!("  {cell}")
            } else {
                format!("  {blanks}{cell}")
            });
        }
        line.trim_end().to_owned()
    };
    let heading = line(" ".repeat(name_width), &HEADINGS, Some(Tone::Faint));
    let body = cells.iter().map(|(name, cells)| {
        let colour = if name.starts_with(' ') {
            Tone::Peer
        } else {
            Tone::Place
        };
        let cells: Vec<&str> = cells.iter().map(String::as_str).collect();
        line(padded(name, name_width, colour), &cells, None)
    });
    let mut lines: Vec<String> = std::iter::once(heading).chain(body).collect();
    if stats.more {
        lines.push(ink("and more: ask for a session below", Tone::Faint));
    }
    lines.join("\n")
}

fn cells(counts: &Counts) -> [String; 7] {
    let size = |bytes: u64| words::size(usize::try_from(bytes).unwrap_or(usize::MAX));
    let age = |age: Option<Duration>| age.map_or_else(|| "-".to_owned(), words::measured);
    let listed = |counts: &BTreeMap<String, u64>| {
        let counts = counts.iter();
        let counts: Vec<String> = counts
            .map(|(word, count)| format!("{count} {}", words::visible(word)))
            .collect();
        counts.join(", ")
    };
    let dropped = match counts.dropped_classes.is_empty() {
        true => listed(&counts.dropped),
        false => format!(
            "{} ({})",
            listed(&counts.dropped),
            listed(&counts.dropped_classes)
        ),
    };
    [
        counts.sent.to_string(),
        size(counts.bytes),
        counts.delivered.to_string(),
        size(counts.queued),
        age(counts.age.map(|ages| ages.p50)),
        age(counts.age.map(|ages| ages.p99)),
        dropped,
    ]
}

fn to_json(stats: &Stats, kind: ContextKind) -> Json {
    let time = stats.time.to_string();
    match stats.channels.first().filter(|_| kind == ContextKind::Channel) {
        Some(channel) => {
            let peers = channel.peers.iter().map(|peer| {
                let mut json = counts_json(&peer.counts);
                json["peer"] = peer.peer.as_str().into();
                json["user"] = peer.user.as_str().into();
                json
            });
            let mut json = channel_json(channel);
            json["peers"] = peers.collect();
            json["time"] = time.into();
            json
        }
        None => {
            let channels: Vec<Json> = stats.channels.iter().map(channel_json).collect();
            json!({"time": time, "channels": channels, "more": stats.more})
        }
    }
}

fn channel_json(channel: &ChannelStats) -> Json {
    let mut json = counts_json(&channel.all);
    json["path"] = channel.path.as_str().into();
    json["members"] = channel.members.into();
    json
}

/// As on the wire; ages in µs.
fn counts_json(counts: &Counts) -> Json {
    let micros = |age: Duration| u64::try_from(age.as_micros()).unwrap_or(u64::MAX);
    let mut json = json!({
        "sent": counts.sent,
        "bytes": counts.bytes,
        "delivered": counts.delivered,
        "dropped": counts.dropped,
        "dropped-classes": counts.dropped_classes,
        "queued": counts.queued,
    });
    if let Some(ages) = counts.age {
        json["age"] = json!({
            "count": ages.count,
            "p50": micros(ages.p50),
            "p99": micros(ages.p99),
            "most": micros(ages.most),
        });
    }
    json
}

#[cfg(test)]
mod tests {
    use super::*;
    use mom_client::{AgeStats, Path, PeerStats, Time};

    fn stats() -> Stats {
        let age = |p50, p99| AgeStats {
            count: 9,
            p50: Duration::from_micros(p50),
            p99: Duration::from_micros(p99),
            most: Duration::from_secs(9),
        };
        let all = Counts {
            sent: 1234,
            bytes: 20_480,
            delivered: 2468,
            dropped: [("replaced".to_owned(), 7), ("expired".to_owned(), 2)].into(),
            dropped_classes: [("latest".to_owned(), 8), ("fleeting".to_owned(), 1)].into(),
            queued: 3_000_000,
            age: Some(age(420, 12_345)),
        };
        let arm = PeerStats {
            peer: "arm".to_owned(),
            user: "arm".to_owned(),
            counts: Counts {
                sent: 1000,
                age: Some(age(999_000, 3_500_000)),
                ..Counts::default()
            },
        };
        Stats {
            time: Time::default(),
            channels: vec![ChannelStats {
                path: Path::parse("/robot/arm").unwrap(),
                members: 1,
                all,
                peers: vec![arm],
            }],
            more: false,
            memory: None,
            peers: Vec::new(),
            more_peers: 0,
        }
    }

    #[test]
    fn the_table() {
        let stats = stats();
        let text = anstream::adapter::strip_str(&table(&stats, ContextKind::Channel)).to_string();
        assert_eq!(
            text.trim_start(),
            "\
sent     bytes  delivered   queued  age p50  age p99  dropped
/robot/arm  1234  20.0 KiB       2468  2.8 MiB  0.42 ms    12 ms  2 expired, 7 replaced (1 fleeting, 8 latest)
  arm       1000       0 B          0      0 B   999 ms    3.5 s"
        );
        let none = Stats {
            channels: Vec::new(),
            ..stats
        };
        assert!(table(&none, ContextKind::Session).contains("no channels"));
    }

    #[test]
    fn a_session_has_a_row_for_each_channel() {
        let stats = Stats {
            more: true,
            ..stats()
        };
        let text = anstream::adapter::strip_str(&table(&stats, ContextKind::Session)).to_string();
        let lines: Vec<&str> = text.lines().collect();
        assert!(
            lines.len() == 3 && lines[1].starts_with("/robot/arm") && lines[2].contains("more"),
            "{text}"
        );
    }

    #[test]
    fn the_json_form() {
        let channel = to_json(&stats(), ContextKind::Channel);
        assert_eq!(
            (&channel["sent"], &channel["path"]),
            (&json!(1234), &json!("/robot/arm"))
        );
        assert_eq!(channel["peers"][0]["age"]["p99"], 3_500_000);
        assert_eq!(channel["dropped"], json!({"expired": 2, "replaced": 7}));
        assert_eq!(channel["dropped-classes"], json!({"fleeting": 1, "latest": 8}));
        let session = to_json(&stats(), ContextKind::Session);
        assert_eq!(
            (&session["channels"][0]["queued"], &session["more"]),
            (&json!(3_000_000), &json!(false))
        );
    }
}
