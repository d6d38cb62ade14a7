//! Driving the robot: one command after the other, each to its end.

use std::time::Duration;

use mom_client::{Event, Family, Parcel, Value, from_value};
use serde::Deserialize;
use tokio::time::timeout;

use crate::asking::{DeviceChannel, closed, refusal};
use crate::{Pose, VerbFailure};

/// A robot that says nothing for so long is not there any more.
const SILENT: Duration = Duration::from_secs(30);

/// What of the robot's state matters here.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct RobotState {
    pub(crate) seq: i64,
    pub(crate) pose: Pose,
    #[serde(default)]
    moving: bool,
    /// The newest fence of its token under which it has stood.
    #[serde(default)]
    fence: Option<u64>,
}

/// A report about a command.
#[derive(Debug, Deserialize)]
struct CommandStatus {
    #[serde(default)]
    id: Option<u64>,
    peer: String,
    state: String,
    #[serde(default)]
    error: Option<Value>,
}

/// How a command ended.
pub(crate) enum CommandEnd {
    Done,
    /// Why the robot did not do it.
    Refused(String),
}

/// The robot, under our token.
pub(crate) struct Robot {
    channel: DeviceChannel,
    state: Option<RobotState>,
    /// That of the token.
    fence: u64,
}

impl Robot {
    pub(crate) fn new(channel: DeviceChannel, fence: u64) -> Robot {
        Robot {
            channel,
            state: None,
            fence,
        }
    }

    /// Carries out a command to its end.
    ///
    /// # Errors
    /// A robot that is stopped or not there; what it cannot do is an end.
    pub(crate) async fn carry_out(
        &mut self,
        command: &str,
        beside: &mut DeviceChannel,
    ) -> Result<CommandEnd, VerbFailure> {
        loop {
            let parcel = Parcel::new(Family::Message, "command").content(command);
            let id = self.channel.send(parcel, &format!("send {command:?}")).await?;
            let status = loop {
                let event = self.next(beside).await?;
                if let Some(status) = self.status(&event, id) {
                    match status.state.as_str() {
                        "finished" => return Ok(CommandEnd::Done),
                        "error" => break status,
                        _ => {}
                    }
                }
            };
            let error = status.error.unwrap_or_default();
            match error.get("name").and_then(Value::as_str) {
                // It is still at what its last owner told it.
                Some("changing-hands") => {
                    while self.state.as_ref().and_then(|state| state.fence) < Some(self.fence) {
                        self.next(beside).await?;
                    }
                }
                Some("stopped") => {
                    return Err(VerbFailure::new(
                        format!("the robot in {} is stopped", self.channel.path()),
                        format!("let it go with: mom unstop {}", self.channel.path()),
                    ));
                }
                _ => return Ok(CommandEnd::Refused(refusal(&error).text)),
            }
        }
    }

    /// The state in which it rests at a pose, where it has just gone.
    pub(crate) async fn rests_at(
        &mut self,
        pose: &Pose,
        beside: &mut DeviceChannel,
    ) -> Result<RobotState, VerbFailure> {
        loop {
            let rests = self
                .state
                .as_ref()
                .filter(|state| !state.moving && state.pose.is_at(pose));
            if let Some(state) = rests {
                return Ok(state.clone());
            }
            self.next(beside).await?;
        }
    }

    /// The next event here; those of the camera meanwhile are of no interest, and must not pile up.
    async fn next(&mut self, beside: &mut DeviceChannel) -> Result<Event, VerbFailure> {
        let next = async {
            loop {
                tokio::select! {
                    event = self.channel.events.next() => return event.ok_or_else(closed),
                    other = beside.events.next() => {
                        other.ok_or_else(closed)?;
                    }
                }
            }
        };
        let event = timeout(SILENT, next).await.map_err(|_| {
            VerbFailure::new(
                format!(
                    "the robot in {} says nothing for {} s",
                    self.channel.path(),
                    SILENT.as_secs()
                ),
                "see who is there: mom tree",
            )
        })??;
        match &event {
            Event::Message(parcel) if parcel.name() == "state" => {
                if let Ok(state) = from_value(parcel.value()) {
                    self.state = Some(state);
                }
            }
            Event::LinkDown => {
                return Err(VerbFailure::plain(
                    "the connection to the hub is lost, and the token with it",
                ));
            }
            Event::Lagged(_) => {
                return Err(VerbFailure::plain(
                    "events of the robot were lost here; what it did is not known",
                ));
            }
            _ => {}
        }
        Ok(event)
    }

    /// What an event says about our command.
    fn status(&self, event: &Event, id: u64) -> Option<CommandStatus> {
        let Event::Message(parcel) = event else {
            return None;
        };
        let status: CommandStatus = match parcel.name() {
            "status" => from_value(parcel.value()).ok()?,
            _ => return None,
        };
        (status.id == Some(id) && status.peer == self.channel.client.name()).then_some(status)
    }
}
