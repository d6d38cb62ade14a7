//! `mom audit`: who was granted or refused what, or lost it, by which rule.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use mom_client::{Client, Family, Map, Parcel, Path, Time, Value};
use tokio::time::{MissedTickBehavior, interval};

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::style::{Tone, ink};
use crate::output::{Output, to_json, words};
use mom_pages::Interrupt;

/// The most facts of one reply.
const PAGE: u64 = 200;

/// With --follow the hub is asked this often.
const AGAIN: Duration = Duration::from_secs(1);

pub(crate) async fn run(args: &cli::AuditArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let path = Path::parse(&args.path).map_err(|error| {
        Failure::usage(
            error.text,
            "paths look like /robot/arm; `mom tree` shows those that exist",
        )
    })?;
    let client = connect(global, Stay::Once).await?;
    let log = Log {
        client: &client,
        path,
        wanted: wanted(args),
    };
    let mut first = log.pages(args.count, None).await?;
    if first.facts.is_empty() && !args.follow {
        output.remark(ink("no facts", Tone::Faint));
    }
    first.tell(output)?;
    if args.follow {
        let mut interrupt = Interrupt::install()?;
        let mut ticks = interval(AGAIN);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut after = first.latest.unwrap_or_default();
        loop {
            tokio::select! {
                () = interrupt.wait() => break,
                _ = ticks.tick() => {}
            }
            let mut new = log.pages(u64::MAX, Some(after)).await?;
            after = new.latest.unwrap_or(after);
            new.tell(output)?;
        }
    }
    client.close().await;
    Ok(())
}

/// What is asked for, but for the page.
fn wanted(args: &cli::AuditArgs) -> Map {
    let mut wanted = Map::new();
    let texts = [
        ("peer", &args.peer),
        ("user", &args.about),
        ("verb", &args.verb),
        ("rule", &args.rule),
        ("code", &args.code),
        ("text", &args.text),
    ];
    for (key, text) in texts {
        if let Some(text) = text {
            wanted.set(key, text.as_str());
        }
    }
    if !args.what.is_empty() {
        let what = args.what.iter().map(|what| Value::from(what.as_str()));
        wanted.set("what", what.collect::<Vec<_>>());
    }
    if let Some(since) = args.since.and_then(ago) {
        wanted.set("since", since);
    }
    wanted
}

/// The time so long ago, by this machine's clock.
fn ago(time: Duration) -> Option<Time> {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).ok()?;
    let then = now.saturating_sub(time).as_micros();
    Time::from_micros(i64::try_from(then).ok()?)
}

struct Log<'a> {
    client: &'a Client,
    path: Path,
    wanted: Map,
}

/// Facts, the newest first.
struct Facts {
    facts: Vec<Map>,
    latest: Option<i64>,
}

impl Log<'_> {
    /// So many facts, page by page; those after a number, or all.
    async fn pages(&self, most: u64, after: Option<i64>) -> Result<Facts, Failure> {
        let mut all = Facts {
            facts: Vec::new(),
            latest: None,
        };
        let mut before = None;
        loop {
            let left = most.saturating_sub(all.facts.len() as u64);
            let mut content = self
                .wanted
                .clone()
                .with("most", i64::try_from(left.min(PAGE)).unwrap_or(1));
            for (key, number) in [("before", before), ("after", after)] {
                if let Some(number) = number {
                    content.set(key, number);
                }
            }
            let parcel = Parcel::new(Family::Context, "audit")
                .context(self.path.clone())
                .content(content);
            let reply = self.client.request(parcel).await;
            let reply = reply.doing(format!("audit {}", self.path))?.value();
            let facts = reply.get("facts").and_then(Value::as_list).unwrap_or_default();
            all.facts.extend(facts.iter().filter_map(Value::as_map).cloned());
            all.latest = all.latest.or_else(|| reply.get("latest")?.as_int());
            before = reply.get("next").and_then(Value::as_int);
            if before.is_none() || all.facts.len() as u64 >= most {
                return Ok(all);
            }
        }
    }
}

impl Facts {
    /// Shows them, the oldest first.
    fn tell(&mut self, output: Output) -> Result<(), Failure> {
        for fact in self.facts.drain(..).rev() {
            output.tell(|| to_json(&fact), || line(&fact))?;
        }
        Ok(())
    }
}

/// `10:00:04.000981 refused bob (level 1) grab /robot/token: held, ally has it; by robot-token`
fn line(fact: &Map) -> String {
    let text = |key: &str| fact.get(key).and_then(Value::as_str).map(words::visible);
    let time = match fact.get("at") {
        Some(Value::Time(time)) => time.to_string(),
        _ => String::new(),
    };
    let time = time.split('.').next().unwrap_or_default().replace('T', " ");
    let what = text("what").unwrap_or_default();
    let tone = match what.as_str() {
        "refused" | "fault" | "audit-lost" => Tone::Bad,
        "granted" | "lost" | "expelled" => Tone::Notice,
        _ => Tone::Strong,
    };
    let mut line = format!("{} {}", ink(time, Tone::Faint), ink(&what, tone));
    if let Some(peer) = text("peer").or_else(|| text("user")) {
        line.push_str(&format!(" {}", ink(&peer, Tone::Peer)));
        let user = text("user").filter(|user| *user != peer);
        let level = fact.get("level").and_then(Value::as_int);
        let who = [user, level.map(|level| format!("level {level}"))];
        let who: Vec<String> = who.into_iter().flatten().collect();
        if !who.is_empty() {
            line.push_str(&format!(" ({})", who.join(", ")));
        }
    }
    for key in ["verb", "message", "context"] {
        line.extend(text(key).map(|word| format!(" {word}")));
    }
    let mut more = Vec::new();
    more.extend(text("code"));
    more.extend(text("reason"));
    more.extend(text("by").map(|by| format!("by {by}")));
    more.extend(text("rule").map(|rule| format!("rule {rule}")));
    more.extend(text("text"));
    more.extend(text("from").map(|from| format!("from {from}")));
    more.extend(text("config"));
    let count = fact.get("count").and_then(Value::as_int);
    more.extend(count.map(|count| format!("{count} times")));
    if !more.is_empty() {
        line.push_str(&format!(": {}", more.join(", ")));
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_says_who_what_where_and_why() {
        let fact = Map::new()
            .with("at", Time::default())
            .with("seq", 13)
            .with("what", "refused")
            .with("peer", "bobby")
            .with("user", "bob")
            .with("level", 1)
            .with("verb", "grab")
            .with("context", "/robot/token")
            .with("rule", "robot-token")
            .with("code", "held")
            .with("by", "al\u{1b}ly")
            .with("count", 3);
        let shown = anstream::adapter::strip_str(&line(&fact)).to_string();
        assert_eq!(
            shown,
            "1970-01-01 00:00:00 refused bobby (bob, level 1) grab /robot/token: held, by al\\u{1b}ly, rule robot-token, 3 times"
        );
    }
}
