//! `mom objects`: where the objects are, and since when that is known.

use std::future::Future;
use std::pin::pin;

use mom_client::{Client, Event, Time, Value};
use mom_drive::{Tell, VerbFailure, closed};
use serde_json::{Value as Json, json};

use super::channel::ModelChannel;
use crate::objects::since_words;
use crate::server::{CHANGED, OBJECTS};
use crate::{Object, Objects};

/// Show where the objects are, by what the cameras see, and since when that is known
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct VerbArgs {
    /// Only these, by their names
    pub names: Vec<String>,
    /// Go on, and tell each object that moves, is taken or is gone
    #[arg(long, short)]
    pub watch: bool,
    /// The model's channel
    #[arg(long, value_name = "PATH", default_value = "/model/objects")]
    pub model: String,
}

const EXAMPLES: &str = "\
Each line has an object's name, the place of its middle in mm, its turn, what it lies on, since when that is known, how far it
may be wrong, and the cameras by which it was found.

Examples:
  mom objects
  mom objects red blue
  mom objects --watch
  mom objects --json | jq -s 'map({name, x, y})'

Ctrl-C ends --watch.";

/// Tells the objects, and with `--watch` what becomes of them until `interrupt` is done.
///
/// # Errors
///
/// [`VerbFailure`]; an object that is not there.
pub async fn run(
    args: &VerbArgs,
    client: &Client,
    interrupt: impl Future<Output = ()>,
    tell: Tell<'_>,
) -> Result<(), VerbFailure> {
    let mut interrupt = pin!(interrupt);
    tokio::select! {
        ended = show(args, client, tell) => ended,
        () = &mut interrupt => Ok(()),
    }
}

async fn show(args: &VerbArgs, client: &Client, tell: Tell<'_>) -> Result<(), VerbFailure> {
    let model = ModelChannel::join(client, &args.model).await?;
    // Before the question, so that no change is missed.
    let mut events = model.channel.events();
    let (mut objects, mut seq) = model.all().await?;
    if let Some(name) = args.names.iter().find(|name| objects.get(name).is_none()) {
        let text = objects.no_such(name, model.now());
        return Err(VerbFailure::new(text, "see what is there: mom objects"));
    }
    let is_wanted = |name: &str| args.names.is_empty() || args.names.iter().any(|wanted| wanted == name);
    for object in objects.iter().filter(|object| is_wanted(&object.name)) {
        tell(
            json_of(object, &objects, model.now()),
            line(object, &objects, model.now()),
        )?;
    }
    if objects.is_empty() && !args.watch {
        tell(json!({"objects": 0}), "no objects were seen yet".to_owned())?;
    }
    if !args.watch {
        return Ok(());
    }
    loop {
        let Event::Message(parcel) = events.next().await.ok_or_else(closed)? else {
            continue;
        };
        let content = parcel.value();
        let number = content.get("seq").and_then(Value::as_int).unwrap_or_default();
        if !(parcel.name() == CHANGED || parcel.name() == OBJECTS) || number <= seq {
            continue;
        }
        let before = objects.clone();
        match parcel.name() == CHANGED && number == seq + 1 {
            true => {
                objects.apply(&content);
                seq = number;
            }
            // A change was missed.
            false => (objects, seq) = model.all().await?,
        }
        for object in objects.iter().filter(|object| is_wanted(&object.name)) {
            if before
                .get(&object.name)
                .is_none_or(|before| is_news(before, object))
            {
                tell(
                    json_of(object, &objects, model.now()),
                    line(object, &objects, model.now()),
                )?;
            }
        }
        for gone in before.iter().filter(|before| objects.get(&before.name).is_none()) {
            if is_wanted(&gone.name) {
                tell(
                    json!({"name": gone.name, "gone": true}),
                    format!("{} is gone", gone.name),
                )?;
            }
        }
    }
}

/// Whether more has changed than that it was seen again.
fn is_news(before: &Object, after: &Object) -> bool {
    let places = |object: &Object| [object.x, object.y, object.z, object.yaw, object.size];
    places(before) != places(after) || before.held != after.held || before.written_by != after.written_by
}

fn json_of(object: &Object, objects: &Objects, now: Time) -> Json {
    let Object {
        name,
        size,
        colour,
        x,
        y,
        z,
        yaw,
        error,
        cameras,
        held,
        ..
    } = object;
    json!({
        "name": name,
        "x": x, "y": y, "z": z, "yaw": yaw,
        "size": size,
        "colour": colour,
        "error": error,
        "cameras": cameras,
        "held": held,
        "on": objects.under(object).map(|under| &under.name),
        "seen": object.seen.map(|seen| seen.to_string()),
        "age": object.age_at(now),
        "written-by": object.written_by,
    })
}

fn line(object: &Object, objects: &Objects, now: Time) -> String {
    let Object {
        name, x, y, z, yaw, ..
    } = object;
    let lies = match (object.held, objects.under(object)) {
        (true, _) => "in the jaws".to_owned(),
        (false, Some(under)) => format!("on {}", under.name),
        (false, None) if *z < 0.0 => "off the table".to_owned(),
        (false, None) => "on the table".to_owned(),
    };
    // 89.9 degrees of a cube are none.
    let turn = yaw.round() % 90.0;
    let place = format!("{x:7.1} {y:7.1} {z:6.1} mm  {turn:3.0}°");
    let mut line = format!("{name:<8} {place}  {lies:<12}  {}", since_words(object, now));
    if !object.cameras.is_empty() {
        line.push_str(&format!(
            "  ±{:.1} mm by {}",
            object.error,
            object.cameras.join(", ")
        ));
    }
    line
}
