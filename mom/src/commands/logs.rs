//! `mom logs`: what programs have reported of their errors to the hub.

use std::time::Duration;

use mom_client::{Event, HISTORY, Parcel, Value};
use serde_json::{Value as Json, json};
use tokio::time::timeout;

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::event::event_words;
use crate::output::style::{Tone, ink};
use crate::output::{Output, to_json, words};
use mom_pages::Interrupt;

/// What is kept comes at once, and nobody says which is the last: a pause as long as this is its end.
const PAUSE: Duration = Duration::from_secs(1);

/// The name of the hub's messages.
const LOG: &str = "log";

pub(crate) async fn run(args: &cli::LogsArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let stay = match args.follow {
        true => Stay::Reconnecting,
        false => Stay::Once,
    };
    let client = connect(global, stay).await?;
    let mut interrupt = Interrupt::install()?;
    let channel = client.channel(&args.path).await;
    let channel = channel.doing(format!("read the reports in {}", args.path))?;
    let mut events = channel.events();
    let mut count = 0;
    loop {
        let next = tokio::select! {
            () = interrupt.wait() => break,
            next = timeout(PAUSE, events.next()) => next,
        };
        match next {
            Err(_) if args.follow => {}
            Err(_) => break,
            Ok(None) => return Err(Failure::plain(format!("{} is gone", args.path))),
            Ok(Some(Event::Message(parcel))) if parcel.name() == LOG => {
                let is_kept = parcel.extra.get(HISTORY).and_then(Value::as_bool) == Some(true);
                if !args.follow && !is_kept {
                    // What was kept is over.
                    break;
                }
                output.tell(|| record(&parcel), || line(&parcel))?;
                count += 1;
            }
            Ok(Some(event @ (Event::LinkDown | Event::Resumed | Event::Rejoined | Event::Lagged(_)))) => {
                output.remark(ink(event_words(&event), Tone::Faint));
            }
            Ok(Some(_)) => {}
        }
    }
    if count == 0 {
        output.remark(ink("no reports", Tone::Faint));
    }
    client.close().await;
    Ok(())
}

/// `2026-11-23 10:00:00 error 127.0.0.1 mom 0.1.0: cannot reach a hub (timed-out)`, in UTC.
fn line(parcel: &Parcel) -> String {
    let content = parcel.value();
    let word = |key: &str| content.get(key).and_then(Value::as_str).map(words::visible);
    let time = parcel.timestamp.map(|time| time.to_string()).unwrap_or_default();
    let time = time
        .split(['.', 'Z'])
        .next()
        .unwrap_or_default()
        .replace('T', " ");
    let level = word("level").unwrap_or_else(|| "?".to_owned());
    let tone = match level.as_str() {
        "error" => Tone::Bad,
        "warn" => Tone::Notice,
        _ => Tone::Faint,
    };
    let mut line = format!(
        "{} {}",
        ink(time, Tone::Faint),
        ink(format_args!("{level:<5}"), tone)
    );
    for part in ["from", "program", "version"].into_iter().filter_map(word) {
        line.push_str(&format!(" {part}"));
    }
    line.push_str(&format!(": {}", word("text").unwrap_or_default()));
    if let Some(code) = word("code") {
        line.push_str(&format!(" ({code})"));
    }
    line
}

/// What was reported, and when by the hub's clock.
fn record(parcel: &Parcel) -> Json {
    let time = parcel.timestamp.map(|time| time.to_string());
    let mut record = json!({ "time": time });
    if let (Some(record), Json::Object(content)) = (record.as_object_mut(), to_json(&parcel.value())) {
        record.extend(content);
    }
    record
}

#[cfg(test)]
mod tests {
    use mom_client::{Family, Map, Time};

    use super::*;

    #[test]
    fn a_line_and_an_object() {
        let content = Map::new()
            .with("text", "cannot reach\u{1b}[2J it")
            .with("level", "error")
            .with("from", "10.0.0.7")
            .with("code", "timed-out")
            .with("program", "mom");
        let mut parcel = Parcel::new(Family::Message, LOG).content(content);
        parcel.timestamp = Some(Time::default());
        let shown = anstream::adapter::strip_str(&line(&parcel)).to_string();
        let expected = "1970-01-01 00:00:00 error 10.0.0.7 mom: cannot reach\\u{1b}[2J it (timed-out)";
        assert_eq!(shown, expected);
        let record = record(&parcel);
        assert_eq!(
            (&record["level"], &record["from"]),
            (&json!("error"), &json!("10.0.0.7"))
        );
    }
}
