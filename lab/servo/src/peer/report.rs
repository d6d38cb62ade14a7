//! The content of `progress`: how far the agent is, for people and programs.

use mom_client::{Map, Value};
use serde::{Deserialize, Serialize};

use crate::control::{Progress, Whereabouts};
use crate::task::{NAMES, Task};

/// How far the agent is.
///
/// ```
/// use mom_client::{Map, from_value};
/// use mom_servo::peer::report::Report;
///
/// let content = Map::new().with("by", "alice").with("state", "accepted").with("agent", "servo");
/// let report: Report = from_value(content.into())?;
/// assert_eq!((report.state.as_str(), report.phase), ("accepted", None));
/// # Ok::<(), mom_client::WireError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Whose task it is.
    #[serde(rename = "by")]
    pub peer: String,
    /// `accepted`, `working`, `ending`, and at last `done`, `failed`, `cancelled` or `lost`: when the robot has said that it stands, or
    /// has not said so for 4 s.
    pub state: String,
    /// To whom the token is to be given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub agent: Option<String>,
    /// What is being done.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub phase: Option<String>,
    /// The error in the images, pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixels: Option<f64>,
    /// What that is on the table, mm, estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mm: Option<f64>,
    /// How often the block was put down.
    #[serde(default)]
    pub attempts: u32,
    /// Commands sent.
    #[serde(default)]
    pub commands: u32,
    /// Age of the newest image, ms, by the hub's clock.
    #[serde(default, rename = "image-age", skip_serializing_if = "Option::is_none")]
    pub image_age: Option<i64>,
    /// How well that is known, ms.
    #[serde(default, rename = "image-age-error", skip_serializing_if = "Option::is_none")]
    pub image_age_error: Option<i64>,
    /// From a command to its effect in the images, ms.
    #[serde(default, rename = "command-delay", skip_serializing_if = "Option::is_none")]
    pub command_delay: Option<i64>,
    /// How well that is known, ms.
    #[serde(
        default,
        rename = "command-delay-error",
        skip_serializing_if = "Option::is_none"
    )]
    pub command_delay_error: Option<i64>,
    /// Why it goes carefully, if it does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub careful: Option<String>,
    /// What it ended for, where it could not go on safely: `sight`, `control` or `estimate`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// By how many degrees each camera's matrix is corrected.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub corrections: Vec<f64>,
    /// Where the first block is: `jaws`, `table` or `unknown`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub first: Option<String>,
    /// The same in words, and why it ended.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
}

impl Report {
    /// One in this state that says nothing more.
    #[must_use]
    pub fn new(peer: &str, state: &str) -> Report {
        Report {
            peer: peer.to_owned(),
            state: state.to_owned(),
            agent: None,
            phase: None,
            pixels: None,
            mm: None,
            attempts: 0,
            commands: 0,
            image_age: None,
            image_age_error: None,
            command_delay: None,
            command_delay_error: None,
            careful: None,
            reason: None,
            corrections: Vec::new(),
            first: None,
            text: None,
        }
    }

    /// One with the controller's progress; `error` is that of the hub's clock, ms.
    #[must_use]
    pub fn of(peer: &str, state: &str, task: &Task, progress: &Progress, error: Option<i64>) -> Report {
        let first = match progress.first {
            Whereabouts::InJaws => "jaws",
            Whereabouts::OnTable { .. } | Whereabouts::PutDown { .. } => "table",
            Whereabouts::Unknown => "unknown",
        };
        let tenth = |number: f64| (number * 10.0).round() / 10.0;
        let [delay, delay_error] = progress.command_delay.map(|micros| micros / 1000);
        Report {
            phase: Some(progress.phase.name().to_owned()),
            pixels: progress.miss.map(|miss| tenth(miss.pixels)),
            mm: progress.miss.map(|miss| tenth(miss.distance())),
            attempts: progress.attempts,
            commands: progress.commands,
            image_age: progress.image_age.map(|micros| micros / 1000),
            image_age_error: error,
            command_delay: Some(delay),
            command_delay_error: Some(delay_error),
            careful: progress.careful.clone(),
            corrections: progress.corrections.iter().copied().map(tenth).collect(),
            first: Some(first.to_owned()),
            text: Some(format!("{} {}", NAMES[task.first].0, progress.first)),
            ..Report::new(peer, state)
        }
    }

    /// As the content of a message.
    #[must_use]
    pub fn to_map(&self) -> Map {
        match mom_client::to_value(self) {
            Ok(Value::Map(map)) => map,
            // A struct is a map, and all of these have a form on the wire.
            _ => Map::new().with("state", self.state.as_str()),
        }
    }

    /// What it tells beside whose task it is, its state and its text.
    #[must_use]
    pub fn facts(&self) -> Map {
        let mut facts = self.to_map();
        for key in ["by", "state", "text"] {
            facts.remove(key);
        }
        facts
    }

    /// Whether nothing follows.
    #[must_use]
    pub fn is_last(&self) -> bool {
        !matches!(self.state.as_str(), "accepted" | "working" | "ending")
    }

    /// A line for people.
    #[must_use]
    pub fn line(&self) -> String {
        let mut words = vec![self.phase.clone().unwrap_or_else(|| self.state.clone())];
        if let (Some(mm), Some(pixels)) = (self.mm, self.pixels) {
            words.push(format!("{mm:.1} mm, {pixels:.1} px"));
        }
        if let Some(age) = self.image_age {
            words.push(format!("image {age} ms old"));
        }
        if let (Some(delay), Some(error)) = (self.command_delay, self.command_delay_error) {
            words.push(format!("commands take {delay} ± {error} ms"));
        }
        words.push(format!("{} commands", self.commands));
        if let Some(why) = &self.careful {
            words.push(format!("carefully: {why}"));
        }
        words.join("  ")
    }
}
