//! `mom snap`: an image from a camera, as a file.

use std::fs;
use std::path::PathBuf;
use std::time::Duration;

use bytes::Bytes;
use mom_client::{Client, Event, Events, Family, Parcel, Path, Value};
use serde_json::json;
use tokio::time::{Instant, timeout_at};

use super::asking::{Asked, closed};
use super::run::join_device;
use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::Failure;
use crate::output::style::{Tone, ink};
use crate::output::{Output, to_json, words};

/// So long a camera has to answer where the channel has a picture already.
const PROMPT: Duration = Duration::from_secs(3);

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
    let channel = join_device(&client, &path).await?;
    let mut events = channel.events();
    let picture = picture(&client, channel.path(), &mut events, args).await;
    client.close().await;
    let Picture { content, kept } = picture?;
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
            if let Some(kept) = &kept {
                json["kept"] = json!(true);
                json["age-ms"] = json!(kept.age.map(words::in_millis));
            }
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
    if let Some(kept) = kept {
        output.remark(ink(kept.words(), Tone::Notice));
    }
    Ok(())
}

/// A picture, and of one that no camera has made for us, what is known of it.
struct Picture {
    content: Value,
    kept: Option<Kept>,
}

/// How old a kept picture is, if that is known.
struct Kept {
    age: Option<Duration>,
}

impl Kept {
    fn words(&self) -> String {
        let age = match self.age {
            Some(age) => format!("it is {} old", words::measured(age)),
            None => "its age is not known".to_owned(),
        };
        format!("no camera answers: this is the newest picture in the channel, and {age}")
    }
}

/// Asks for an image, and takes the channel's newest where nobody answers.
async fn picture(
    client: &Client,
    path: &Path,
    events: &mut Events,
    args: &cli::SnapArgs,
) -> Result<Picture, Failure> {
    let what = format!("ask {path} for an image");
    let request = Parcel::new(Family::Message, "request").context(path.clone());
    let asked = Asked::of(client, request, &what).await?;
    let begin = Instant::now();
    let mut newest: Option<Parcel> = None;
    loop {
        let wait = match newest {
            Some(_) => args.timeout.min(PROMPT),
            None => args.timeout,
        };
        let Ok(event) = timeout_at(begin + wait, events.next()).await else {
            let newest = newest.ok_or_else(|| nobody(path.as_str(), args.timeout))?;
            return Ok(kept(client, &newest));
        };
        let Event::Message(parcel) = event.ok_or_else(closed)? else {
            continue;
        };
        if asked.is_answered_by(&parcel, client) {
            let content = asked.answer(parcel)?.value();
            return Ok(Picture { content, kept: None });
        }
        if !args.fresh && image(&parcel.value()).is_some() {
            newest = Some(parcel);
        }
    }
}

fn kept(client: &Client, parcel: &Parcel) -> Picture {
    let age = client.clock().age(parcel).map(|age| age.duration());
    let mut content = parcel.value();
    if let (Value::Map(map), Some(said)) = (&mut content, parcel.timestamp)
        && map.get("taken").is_none()
    {
        map.set("taken", said);
    }
    Picture {
        content,
        kept: Some(Kept { age }),
    }
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
    fn a_kept_picture_says_that_it_is_one_and_how_old() {
        let words = |age| Kept { age }.words();
        assert_eq!(
            words(Some(Duration::from_millis(3_913))),
            "no camera answers: this is the newest picture in the channel, and it is 3.9 s old"
        );
        assert!(words(None).ends_with("and its age is not known"));
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
