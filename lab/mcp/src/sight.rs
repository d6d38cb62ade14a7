//! `look` and `where`: what needs no token.

use std::time::Duration;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use mom_client::{Card, Client, ContextKind, Map, Time, TokenInfo, Value, plain_duration, visible};
use mom_drive::{DeviceChannel, Pose, VerbFailure, believed};
use serde_json::{Value as Json, json};
use tokio::time::timeout;

use crate::answer::Answer;
use crate::assistant::{Assistant, SeenState};
use crate::device::{pose_words, statements};

/// So long the robot may take to tell its state for the first time.
const STATE: Duration = Duration::from_secs(2);
/// So long a model server may take; most hubs have none.
const OBJECTS: Duration = Duration::from_secs(1);
/// The largest image that is handed on, bytes.
const IMAGE: usize = 8 * 1024 * 1024;
/// An older picture is nothing to move by, ms.
const OLD: f64 = 2000.0;
/// The most objects that are told.
const MOST: usize = 100;

/// `look`
pub(crate) async fn look(assistant: &Assistant, camera: &str) -> Answer {
    let cameras = match cameras(assistant).await {
        Ok(cameras) => cameras,
        Err(answer) => return answer,
    };
    if !cameras.iter().any(|name| name == camera) {
        let text = format!("there is no camera {camera:?}; there are {}", cameras.join(", "));
        return Answer::bad("unknown-camera", text).with("cameras", json!(cameras));
    }
    let path = format!("{}/{camera}", assistant.places.cameras.trim_end_matches('/'));
    let asked = async {
        let channel = DeviceChannel::join(&assistant.client, &path).await?;
        let what = format!("ask {path} for an image");
        channel.ask("request", Map::new(), &what).await
    };
    match asked.await {
        Ok(content) => picture(&assistant.client, camera, &content),
        Err(failure) => Answer::from(&failure),
    }
}

/// The names of the cameras.
async fn cameras(assistant: &Assistant) -> Result<Vec<String>, Answer> {
    let path = &assistant.places.cameras;
    let children = assistant.client.list(path).await;
    let children = children.map_err(|error| Answer::of_client(&format!("list {path}"), &error))?;
    let channels = children.iter().filter(|child| child.kind == ContextKind::Channel);
    Ok(channels
        .filter_map(|child| child.path.as_str().rsplit('/').next())
        .map(str::to_owned)
        .collect())
}

/// An image as its camera told it.
fn picture(client: &Client, camera: &str, content: &Value) -> Answer {
    let text = |key: &str| content.get(key).and_then(Value::as_str);
    let media_type = text("media-type").filter(|kind| matches!(*kind, "image/jpeg" | "image/png"));
    let image = content.get("image").and_then(Value::as_binary);
    let (Some(image), Some(media_type)) = (image, media_type) else {
        return Answer::bad(
            "no-image",
            format!("camera {camera} has answered without an image"),
        );
    };
    if image.len() > IMAGE {
        let text = format!(
            "the image of camera {camera} has {} bytes, at most {IMAGE} are taken",
            image.len()
        );
        return Answer::bad("too-large", text);
    }
    let number = |key: &str| content.get(key).and_then(Value::as_int);
    let mut facts = json!({
        "camera": camera,
        "media_type": media_type,
        "width": number("width"),
        "height": number("height"),
    });
    let mut words = format!("camera {camera}");
    if let Some(Value::Time(taken)) = content.get("taken") {
        words.push_str(&format!(", taken {taken}"));
        facts["taken"] = json!(taken.to_string());
        if let Some((age, error, most)) = age(client, *taken) {
            words.push_str(&format!(
                ", {age:.0} ms ago (± {error:.1} ms, at most {most:.0} ms)"
            ));
            if most > OLD {
                words.push_str("; that is too old to move by, look again");
            }
            facts["age_ms"] = json!(age);
            facts["age_error_ms"] = json!(error);
            facts["age_at_most_ms"] = json!(most);
        }
    }
    let pose = content.get("pose").cloned();
    if let Some(pose) = pose.and_then(|pose| mom_client::from_value::<Pose>(pose).ok()) {
        words.push_str(&format!("; it shows the arm at {}", pose_words(&pose)));
        facts["pose"] = json!(pose);
    }
    let mut answer = Answer::good(words, facts);
    answer.picture = Some((STANDARD.encode(image), media_type.to_owned()));
    answer
}

/// ms since then by the hub's clock, the error, and how much it is at most: an age that cannot be is not believed.
fn age(client: &Client, then: Time) -> Option<(f64, f64, f64)> {
    let (now, error) = client.clock().now()?;
    let age = now.micros().saturating_sub(then.micros());
    let error = i64::try_from(error.as_micros()).unwrap_or(i64::MAX);
    // The error is half the round trip at least.
    let most = believed(age, error, error.saturating_mul(2));
    Some((
        age.max(0) as f64 / 1000.0,
        error as f64 / 1000.0,
        most as f64 / 1000.0,
    ))
}

/// `where`
pub(crate) async fn places(assistant: &Assistant) -> Answer {
    let (robot, token, objects, card) = tokio::join!(
        assistant.robot_state(STATE),
        assistant.token_info(),
        objects(assistant),
        assistant.card()
    );
    let token = match token {
        Ok(token) => token,
        Err(answer) => return answer,
    };
    let (robot_words, robot) = match &robot {
        Some(seen) => {
            assistant.tell(seen);
            robot_facts(assistant, seen, card.as_ref())
        }
        None => (
            format!("no robot tells its state in {}", assistant.places.robot),
            Json::Null,
        ),
    };
    let (token_words, token) = token_facts(assistant, &token);
    let (object_words, objects) = match objects {
        Ok(objects) => (objects_words(&objects), objects),
        Err(why) => (why, Json::Null),
    };
    Answer::good(
        format!("{robot_words}\n{token_words}\n{object_words}"),
        json!({"robot": robot, "token": token, "objects": objects}),
    )
}

/// The state of the robot in words and as data.
pub(crate) fn robot_facts(assistant: &Assistant, seen: &SeenState, card: Option<&Card>) -> (String, Json) {
    let SeenState { parcel, state } = seen;
    let linked = state.is_linked();
    let name = card.map_or("robot", |card| &card.name);
    let mut words = format!("{} at {}", visible(name), state.place_words(card));
    words.push_str(match (state.stopped, state.moving) {
        (true, _) => ", stopped until a person lets it go",
        (false, true) => ", moving",
        (false, false) => ", standing",
    });
    if !linked {
        words.push_str(", without a link to its controller, so this is what was known last");
    }
    let mut facts = json!({
        "moving": state.moving,
        "stopped": state.stopped,
        "linked": linked,
        "seq": state.seq,
    });
    if let Json::Object(facts) = &mut facts {
        state.add_to(facts);
    }
    if let Some(card) = card {
        let statements = statements(card);
        words.push_str(&format!(
            "; statements of its scripts: {}",
            statements.join(" | ")
        ));
        facts["statements"] = json!(statements);
    }
    if let Some(age) = assistant.client.clock().age(parcel) {
        let millis = age.duration().as_secs_f64() * 1000.0;
        facts["age_ms"] = json!(millis);
        words.push_str(&format!(" (said {millis:.0} ms ago"));
        if let Some(error) = age.error() {
            facts["age_error_ms"] = json!(error.as_secs_f64() * 1000.0);
            words.push_str(&format!(" ± {:.1} ms", error.as_secs_f64() * 1000.0));
        }
        // A robot at rest says nothing new.
        words.push_str(", and nothing has changed since)");
    }
    (words, facts)
}

/// The token in words and as data.
fn token_facts(assistant: &Assistant, info: &TokenInfo) -> (String, Json) {
    let path = &assistant.places.token;
    let me = assistant.client.name();
    let mine = info.owner.as_deref() == Some(me.as_str());
    let millis =
        |time: Option<Duration>| time.map(|time| u64::try_from(time.as_millis()).unwrap_or(u64::MAX));
    let mut facts = json!({
        "path": path,
        "owner": info.owner,
        "owner_level": info.owner_level,
        "yours": mine,
        "you": me,
        "held_ms": millis(info.held),
        "lease_left_ms": millis(info.lease_left),
    });
    let mut words = match (&info.owner, mine) {
        (_, true) => format!("you hold {path}"),
        (Some(owner), _) => {
            let level = info.owner_level.unwrap_or_default();
            let left = info.lease_left.map(|left| {
                format!(
                    "; its lease ends in {} unless it is renewed",
                    plain_duration(left)
                )
            });
            format!(
                "{path} is held by {owner} at level {level}{}",
                left.unwrap_or_default()
            )
        }
        (None, _) if !info.holders.is_empty() => {
            format!(
                "{path} is inhibited by {}, so nobody may drive",
                info.holders.join(", ")
            )
        }
        (None, _) => format!(
            "{path} is free; a person gives it to you by: {}",
            give_command(assistant)
        ),
    };
    if let Some(scope) = &info.delegated {
        facts["scope"] =
            json!({"from": scope.from, "left_ms": millis(scope.left), "commands_left": scope.commands});
        if mine {
            words.push_str(&format!(
                ", given by {}; {}",
                scope.from,
                scope_words(scope.left, scope.commands)
            ));
        }
    } else if mine {
        words.push_str(" without a limit");
    }
    (words, facts)
}

/// What is left of a scope.
pub(crate) fn scope_words(left: Option<Duration>, commands: Option<u64>) -> String {
    let time = left.map(plain_duration);
    let commands = commands.map(count_words);
    match (time, commands) {
        (None, None) => "without a limit".to_owned(),
        (time, commands) => {
            let parts: Vec<String> = time.into_iter().chain(commands).collect();
            format!("left of the scope: {}", parts.join(" and "))
        }
    }
}

/// `1 command`, `5 commands`
pub(crate) fn count_words(commands: u64) -> String {
    match commands {
        1 => "1 command".to_owned(),
        count => format!("{count} commands"),
    }
}

/// How a person gives the token.
pub(crate) fn give_command(assistant: &Assistant) -> String {
    format!(
        "mom give {} {} --for 2m --commands 5",
        assistant.client.name(),
        assistant.places.token
    )
}

/// What the model server knows, if there is one; the reason if not.
async fn objects(assistant: &Assistant) -> Result<Json, String> {
    let path = &assistant.places.objects;
    let asked = async {
        let channel = DeviceChannel::join(&assistant.client, path).await?;
        channel.ask("query", Map::new(), &format!("ask {path}")).await
    };
    let content = match timeout(OBJECTS, asked).await {
        Ok(Ok(content)) => content,
        Ok(Err(VerbFailure::Failed { .. })) | Err(_) => {
            return Err(format!(
                "there is no model of the objects in {path}; look at them"
            ));
        }
        Ok(Err(failure)) => return Err(format!("no model of the objects: {failure}")),
    };
    let content = serde_json::to_value(&content).map_err(|error| error.to_string())?;
    let Some(objects) = content.get("objects").and_then(Json::as_array) else {
        return Err(format!("the model of the objects in {path} cannot be read"));
    };
    Ok(objects.iter().take(MOST).cloned().collect())
}

fn objects_words(objects: &Json) -> String {
    let objects = objects.as_array().map(Vec::as_slice).unwrap_or_default();
    let words: Vec<String> = objects.iter().map(object_words).collect();
    match words.is_empty() {
        true => "the model of the table knows no objects".to_owned(),
        false => words.join("\n"),
    }
}

/// `red at x -150.0 y 100.0 z 20.0 mm ± 0.8 mm, as of 120 ms ago`
fn object_words(object: &Json) -> String {
    let name = object.get("name").and_then(Json::as_str).unwrap_or("something");
    let mut words = format!("{name} at");
    for key in ["x", "y", "z"] {
        match object.get(key).and_then(Json::as_f64) {
            Some(number) => words.push_str(&format!(" {key} {number:.1}")),
            None => words.push_str(&format!(" {key} unknown")),
        }
    }
    words.push_str(" mm");
    if let Some(error) = object.get("error").and_then(Json::as_f64) {
        words.push_str(&format!(" ± {error:.1} mm"));
    }
    let age = object.get("age").or_else(|| object.get("age-ms"));
    if let Some(age) = age.and_then(Json::as_f64) {
        words.push_str(&format!(", as of {age:.0} ms ago"));
    }
    if let Some(held) = object
        .get("held")
        .filter(|held| !held.is_null() && *held != &json!(false))
    {
        let held = held
            .as_str()
            .map_or("held".to_owned(), |by| format!("held by {by}"));
        words.push_str(&format!(", {held}"));
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scope_in_words() {
        let seconds = |seconds| Some(Duration::from_secs(seconds));
        for (left, commands, words) in [
            (None, None, "without a limit"),
            (None, Some(1), "left of the scope: 1 command"),
            (seconds(30), Some(3), "left of the scope: 30 s and 3 commands"),
        ] {
            assert_eq!(scope_words(left, commands), words);
        }
    }

    #[test]
    fn objects_in_words() {
        for (object, words) in [
            (
                json!({"name": "red", "x": -150.0, "y": 100, "z": 20.04, "age-ms": 120, "held": "alice"}),
                "red at x -150.0 y 100.0 z 20.0 mm, as of 120 ms ago, held by alice",
            ),
            (
                json!({"held": false}),
                "something at x unknown y unknown z unknown mm",
            ),
            (json!(7), "something at x unknown y unknown z unknown mm"),
        ] {
            assert_eq!(object_words(&object), words);
        }
        assert_eq!(
            objects_words(&json!([])),
            "the model of the table knows no objects"
        );
    }
}
