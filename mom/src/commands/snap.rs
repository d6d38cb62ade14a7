//! `mom snap`: an image from a camera, as a file.

use std::fs;
use std::path::PathBuf;
use std::time::Duration;

use bytes::Bytes;
use mom_client::{Client, Events, Family, Parcel, Path, Value};
use tokio::time::timeout;

use super::asking::ask;
use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::style::{Tone, ink};
use crate::output::{Output, to_json, words};

pub(crate) async fn run(args: &cli::SnapArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let to_stdout = args.output.as_deref().is_some_and(|file| file.as_os_str() == "-");
    if to_stdout && output.is_json() {
        return Err(Failure::usage(
            "--output - writes the image where --json writes its lines",
            "leave one of them out",
        ));
    }
    let client = connect(global, Stay::Once).await?;
    let path = format!("{}/{}", args.session.trim_end_matches('/'), args.view);
    let channel = client.channel(&path).await.doing(format!("join {path}"))?;
    let mut events = channel.events();
    let content = match timeout(args.timeout, ask_image(&client, channel.path(), &mut events)).await {
        Ok(content) => content?,
        Err(_) => return Err(nobody(&path, args.timeout)),
    };
    client.close().await;
    let image =
        image(&content).ok_or_else(|| Failure::plain(format!("the answer of {path} holds no image")))?;
    if to_stdout {
        return Ok(output.bytes(&image)?);
    }
    let file = match &args.output {
        Some(file) => file.clone(),
        None => PathBuf::from(file_name(&args.view, &content)),
    };
    fs::write(&file, &image)
        .map_err(|error| Failure::plain(format!("cannot write {}: {error}", file.display())))?;
    output.tell(
        || {
            let mut json = to_json(&content);
            // The image is in the file.
            json["image"] = image.len().into();
            json["file"] = file.to_string_lossy().into();
            json
        },
        || {
            format!(
                "{}  {}",
                ink(file.display(), Tone::Strong),
                ink(facts(&content, image.len()), Tone::Faint)
            )
        },
    )?;
    Ok(())
}

/// Asks for an image and gives the content of the answer.
async fn ask_image(client: &Client, path: &Path, events: &mut Events) -> Result<Value, Failure> {
    let request = Parcel::new(Family::Message, "request").context(path.clone());
    let answer = ask(client, events, request, &format!("ask {path} for an image")).await;
    answer.map(|answer| answer.value())
}

/// After so long without an answer.
pub(super) fn nobody(path: &str, after: Duration) -> Failure {
    Failure::new(
        format!("no camera answers in {path} within {}", words::duration(after)),
        "see who is there: mom tree",
    )
}

fn image(content: &Value) -> Option<Bytes> {
    content.get("image").and_then(Value::as_binary).cloned()
}

/// `x-20261121T100000Z.jpg`: camera, time and format.
fn file_name(view: &str, content: &Value) -> String {
    let taken = match content.get("taken") {
        Some(Value::Time(time)) => time.to_string(),
        _ => String::new(),
    };
    // To the second, without the characters that file systems dislike.
    let stamp: String = taken
        .split('.')
        .next()
        .unwrap_or_default()
        .chars()
        .filter(|c| c.is_alphanumeric())
        .collect();
    let ending = match content.get("media-type").and_then(Value::as_str) {
        Some("image/jpeg") => "jpg",
        Some("image/png") => "png",
        _ => "image",
    };
    let view = view.replace('/', "-");
    match stamp.is_empty() {
        true => format!("{view}.{ending}"),
        false => format!("{view}-{stamp}Z.{ending}"),
    }
}

/// `640 x 480, image/jpeg, 23.1 KiB, taken 2026-11-21T10:00:00Z`
fn facts(content: &Value, bytes: usize) -> String {
    let int = |key: &str| content.get(key).and_then(Value::as_int);
    let mut facts = Vec::new();
    if let (Some(width), Some(height)) = (int("width"), int("height")) {
        facts.push(format!("{width} x {height}"));
    }
    facts.extend(
        content
            .get("media-type")
            .and_then(Value::as_str)
            .map(words::visible),
    );
    facts.push(words::size(bytes));
    if let Some(Value::Time(time)) = content.get("taken") {
        facts.push(format!("taken {time}"));
    }
    facts.join(", ")
}

#[cfg(test)]
mod tests {
    use mom_client::{Map, Time};

    use super::*;

    fn content(media_type: &str) -> Value {
        let taken: Time = "2026-11-21T10:00:01.500000Z".parse().unwrap();
        Map::new()
            .with("image", Value::Binary(Bytes::from_static(b"abc")))
            .with("media-type", media_type)
            .with("width", 640)
            .with("height", 480)
            .with("taken", taken)
            .into()
    }

    #[test]
    fn names_of_files() {
        for (content, name) in [
            (content("image/jpeg"), "x-20261121T100001Z.jpg"),
            (content("image/png"), "x-20261121T100001Z.png"),
            (content("../evil"), "x-20261121T100001Z.image"),
            (Value::Null, "x.image"),
        ] {
            assert_eq!(file_name("x", &content), name);
        }
    }

    #[test]
    fn what_is_told_of_an_image() {
        let content = content("image/jpeg");
        assert_eq!(image(&content).as_deref(), Some(&b"abc"[..]));
        assert_eq!(
            facts(&content, 3),
            "640 x 480, image/jpeg, 3 B, taken 2026-11-21T10:00:01.500000Z"
        );
        assert_eq!(image(&Value::Null), None);
    }
}
