//! `mom what-if`: what the hub would have decided by another configuration.

use std::io::Read as _;
use std::path::Path as FilePath;

use mom_client::{Family, Map, Parcel, Path, Value};

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::style::{Tone, ink};
use crate::output::{Output, to_json, words};

pub(crate) async fn run(args: &cli::WhatIfArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let mut content = Map::new();
    if let Some(file) = &args.file {
        content.set("config", read(file)?);
        content.set("rules", args.rules);
    }
    let client = connect(global, Stay::Once).await?;
    let parcel = Parcel::new(Family::Context, "what-if")
        .context(Path::root())
        .content(content);
    let reply = client.request(parcel).await;
    let reply = reply.doing("what-if")?.value();
    client.close().await;
    if args.show {
        let config = reply.get("config").and_then(Value::as_str).unwrap_or_default();
        output.tell(|| to_json(&reply), || config.trim_end().to_owned())?;
        return Ok(());
    }
    output.tell(|| to_json(&reply), || shown(&reply))?;
    match reply.get("differ").and_then(Value::as_int) {
        Some(0) => Ok(()),
        _ => Err(Failure::Told),
    }
}

fn read(file: &FilePath) -> Result<String, Failure> {
    let read = match file.to_str() {
        Some("-") => {
            let mut text = String::new();
            std::io::stdin().read_to_string(&mut text).map(|_| text)
        }
        _ => std::fs::read_to_string(file),
    };
    read.map_err(|error| Failure::plain(format!("cannot read {}: {error}", file.display())))
}

fn shown(reply: &Value) -> String {
    let list = reply
        .get("differences")
        .and_then(Value::as_list)
        .unwrap_or_default();
    let mut lines: Vec<String> = list.iter().map(line).collect();
    let number = |key: &str| reply.get(key).and_then(Value::as_int).unwrap_or_default();
    let is = |key: &str| reply.get(key).and_then(Value::as_bool) == Some(true);
    let (inputs, differ) = (number("inputs"), number("differ"));
    if is("more") {
        lines.push(format!("… and {} more", differ.saturating_sub(list.len() as i64)));
    }
    if is("cut") {
        lines.push("the recording is too long: only its beginning was decided again".to_owned());
    }
    if let Some(end) = reply.get("end").and_then(Value::as_str) {
        lines.push(format!("the recording ends early: {}", words::visible(end)));
    }
    let count = |number: i64, one: &str| words::count(u64::try_from(number).unwrap_or_default(), one);
    lines.push(format!(
        "{} decided again: {}",
        count(inputs, "input"),
        match differ {
            0 => ink("nothing differs", Tone::Good),
            1 => ink("1 decision differs", Tone::Notice),
            _ => ink(format_args!("{differ} decisions differ"), Tone::Notice),
        }
    ));
    lines.join("\n")
}

/// `10:00:03 alice: grab /robot/token: alice owns it -> refused denied by "lab" (lab.toml:14)`
fn line(difference: &Value) -> String {
    let text = |key: &str| difference.get(key).and_then(Value::as_str).map(words::visible);
    let at = match difference.get("at") {
        Some(Value::Time(time)) => time.to_string(),
        _ => String::new(),
    };
    let at = at.split('.').next().unwrap_or_default().replace('T', " ");
    let mut line = ink(at, Tone::Faint);
    line.extend(text("peer").map(|peer| format!(" {}:", ink(peer, Tone::Peer))));
    for key in ["request", "message", "context"] {
        line.extend(text(key).map(|word| format!(" {word}")));
    }
    let (old, new) = (text("old").unwrap_or_default(), text("new").unwrap_or_default());
    line.push_str(&format!(": {old} {} {new}", ink("->", Tone::Faint)));
    if let (Some(file), Some(number)) = (text("file"), difference.get("line").and_then(Value::as_int)) {
        line.push_str(&format!(" ({file}:{number})"));
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_and_their_sum() {
        let difference = Map::new()
            .with("at", mom_client::Time::default())
            .with("peer", "alice")
            .with("request", "grab")
            .with("context", "/robot/token")
            .with("old", "ok")
            .with("new", "refused denied by \"lab\"")
            .with("file", "lab.toml")
            .with("line", 14);
        let reply = Map::new()
            .with("inputs", 12)
            .with("differ", 3)
            .with("more", true)
            .with("differences", vec![Value::from(difference)]);
        assert_eq!(
            anstream::adapter::strip_str(&shown(&reply.into())).to_string(),
            "1970-01-01 00:00:00 alice: grab /robot/token: ok -> refused denied by \"lab\" (lab.toml:14)\n\
             … and 2 more\n12 inputs decided again: 3 decisions differ"
        );
    }
}
