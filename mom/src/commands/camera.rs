//! `mom camera`: tells and changes the settings of a camera (M37).

use mom_camera::{CameraOptions, View};
use mom_client::{Client, Family, Map, Parcel, TokenGuard, Value};
use serde_json::json;
use tokio::time::timeout;

use super::asking::ask;
use super::run::join_device;
use super::snap::nobody;
use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::style::{Tone, ink};
use crate::output::{Output, to_json, words};

pub(crate) async fn run(args: &cli::CameraArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let change = change(args);
    let client = connect(global, Stay::Once).await?;
    let path = format!("{}/{}", args.session.trim_end_matches('/'), args.view);
    let result = settings(&client, &path, change, args).await;
    client.close().await;
    let settings = result?;
    output.tell(
        || {
            let mut json = to_json(&settings);
            json["path"] = json!(path);
            json
        },
        || {
            format!(
                "{}  {}",
                ink(&path, Tone::Place),
                ink(facts(&settings), Tone::Strong)
            )
        },
    )?;
    Ok(())
}

/// What is to be changed, empty if nothing is.
fn change(args: &cli::CameraArgs) -> Map {
    let mut change = Map::new();
    if let Some(size) = args.size {
        change.set("width", size.width);
        change.set("height", size.height);
    }
    if let Some(quality) = args.quality {
        change.set("quality", quality);
    }
    if let Some(format) = &args.format {
        change.set("format", format.as_str());
    }
    if let Some(overlay) = args.overlay {
        change.set("overlay", overlay);
    }
    change
}

/// The settings in use after the change.
async fn settings(
    client: &Client,
    path: &str,
    change: Map,
    args: &cli::CameraArgs,
) -> Result<Value, Failure> {
    let channel = join_device(client, path).await?;
    let mut events = channel.events();
    let token = token(args);
    let (what, guard) = match change.is_empty() {
        true => (format!("ask {path} for its settings"), None),
        false => (format!("set {path}"), own(client, &token).await?),
    };
    let question = Parcel::new(Family::Message, "settings")
        .context(channel.path().clone())
        .content(change);
    let asked = timeout(args.timeout, ask(client, &mut events, question, &what)).await;
    if let Some(guard) = guard
        && !guard.is_lost()
    {
        guard.release().await.doing(format!("release {token}"))?;
    }
    match asked {
        Ok(answer) => Ok(answer?.value()),
        Err(_) => Err(nobody(path, args.timeout)),
    }
}

/// The token of the camera: the lab's cameras know theirs, all others are the robot's.
fn token(args: &cli::CameraArgs) -> String {
    let view = args.view.parse().unwrap_or(View::X);
    let token = args.token.clone();
    token.unwrap_or_else(|| CameraOptions::new(view).token)
}

/// The token for as long as the change takes, if nobody owns it. Otherwise the camera is asked all the same: it knows
/// whose it is, and says so.
async fn own(client: &Client, path: &str) -> Result<Option<TokenGuard>, Failure> {
    let token = client.token(path).await.doing(format!("join {path}"))?;
    let status = token.status().await.doing(format!("look at {path}"))?;
    if status.owner.is_some() || !status.holders.is_empty() {
        return Ok(None);
    }
    token.grab().await.doing(format!("grab {path}")).map(Some)
}

/// `640x480, quality 80, jpeg`. A real camera whose images go out as they came names no quality, and no size before
/// the first of them.
fn facts(settings: &Value) -> String {
    let number = |key: &str| settings.get(key).and_then(Value::as_int);
    let mut facts = Vec::new();
    match (number("width"), number("height")) {
        (Some(width), Some(height)) => facts.push(format!("{width}x{height}")),
        (Some(width), None) => facts.push(format!("{width} wide")),
        (None, Some(height)) => facts.push(format!("{height} high")),
        (None, None) => {}
    }
    facts.extend(number("quality").map(|quality| format!("quality {quality}")));
    facts.extend(settings.get("format").and_then(Value::as_str).map(words::visible));
    if number("quality").is_none() {
        facts.push("as the camera gives it".to_owned());
    }
    if settings.get("overlay").and_then(Value::as_bool) == Some(true) {
        facts.push("overlays drawn in".to_owned());
    }
    facts.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_in_words() {
        let drawn = Map::new()
            .with("width", 640)
            .with("height", 480)
            .with("quality", 80);
        let drawn = drawn.with("format", "jpeg").with("overlay", true);
        let real = Map::new()
            .with("width", 1280)
            .with("height", 720)
            .with("format", "png");
        for (settings, expected) in [
            (drawn, "640x480, quality 80, jpeg, overlays drawn in"),
            (real, "1280x720, png, as the camera gives it"),
            (Map::new().with("overlay", false), "as the camera gives it"),
            (
                Map::new().with("width", 320).with("quality", 60),
                "320 wide, quality 60",
            ),
        ] {
            assert_eq!(facts(&settings.into()), expected);
        }
    }
}
