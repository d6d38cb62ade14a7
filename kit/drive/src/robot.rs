//! Driving a robot: one command after the other, each to its end.

use std::future::Future;
use std::time::Duration;

use mom_client::{Event, Events, Family, Map, Parcel, Value, from_value};
use serde::Deserialize;
use tokio::time::{Instant, timeout, timeout_at};

use crate::asking::{DeviceChannel, closed, refusal};
use crate::{Pose, VerbFailure};

/// A robot that says nothing for so long is not there any more.
const SILENT: Duration = Duration::from_secs(30);
/// So long the link between the robot and its controller may be down.
const UNLINKED: Duration = Duration::from_secs(30);
/// So long the hub may need to measure our clock, and how often the robot is asked meanwhile.
const UNMEASURED: Duration = Duration::from_secs(10);
const MEASURED: Duration = Duration::from_millis(100);

/// What of the robot's state matters to programs that drive it.
#[derive(Debug, Clone, Deserialize)]
#[non_exhaustive]
pub struct RobotState {
    /// Rises with every change of the state.
    pub seq: i64,
    /// Where the hand is.
    pub pose: Pose,
    /// What the jaws hold.
    #[serde(default)]
    pub holding: Option<String>,
    /// Whether it moves, or may do so because the link to its controller is down.
    #[serde(default)]
    pub moving: bool,
    /// Whether it is stopped and takes no command.
    #[serde(default)]
    pub stopped: bool,
    /// Whether its controller is there; a robot that does not say so has no other.
    #[serde(default = "yes")]
    linked: bool,
    /// The newest fence of its token that it has heard of.
    #[serde(default)]
    fence: Option<u64>,
}

/// A report about a command.
#[derive(Debug, Deserialize)]
struct CommandStatus {
    #[serde(default)]
    id: Option<u64>,
    peer: String,
    /// Under which the command came.
    #[serde(default)]
    fence: Option<u64>,
    state: String,
    #[serde(default)]
    error: Option<Value>,
}

const fn yes() -> bool {
    true
}

impl RobotState {
    /// Whether it stands, and has heard that the token's owner has this fence.
    fn stands_for(&self, fence: u64) -> bool {
        !self.moving && self.fence.is_some_and(|known| known >= fence)
    }

    /// Whether it takes commands of the owner with this fence; one that knows no fence does so at once.
    #[must_use]
    pub fn is_under(&self, fence: u64) -> bool {
        self.fence.is_none_or(|stood| stood >= fence)
    }
}

/// What an error of the robot means here.
#[derive(Debug, PartialEq)]
enum Trouble {
    /// It cannot go there; another pose may do.
    Pose,
    /// It is still at what its last owner told it, and tells when it is not.
    ChangingHands,
    /// Its controller is not there, and the command may be sent again once it is.
    Unlinked,
    /// Our clock is still being measured, so that the command's age is not known.
    Unmeasured,
    Stopped,
    /// No pose is any better.
    Other,
}

impl Trouble {
    fn of(error: &Value) -> Trouble {
        let retry = error.get("retry").and_then(Value::as_bool) == Some(true);
        match error.get("name").and_then(Value::as_str) {
            Some("workspace-boundary" | "joint-limit" | "singularity") => Trouble::Pose,
            Some("changing-hands") if retry => Trouble::ChangingHands,
            Some("link") if retry => Trouble::Unlinked,
            Some("too-old") if retry => Trouble::Unmeasured,
            Some("stopped") => Trouble::Stopped,
            _ => Trouble::Other,
        }
    }
}

/// That a device is not there any more, in words that a place follows: it has left, or its connection is lost, and what it does then
/// nobody can tell.
#[must_use]
pub fn gone(event: &Event, device: &str) -> Option<String> {
    match event {
        Event::Left(member) if member.peer == device => Some(format!("{device} has left")),
        Event::Other(parcel) if parcel.is(Family::Event, mom_client::event::LOST) => {
            let lost = parcel.value();
            let is_device = lost.get("peer").and_then(Value::as_str) == Some(device);
            is_device.then(|| format!("the hub has lost the connection of {device}, the device in"))
        }
        _ => None,
    }
}

/// How a command ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CommandEnd {
    /// It was carried out.
    Done,
    /// Why the robot cannot go there.
    Refused(String),
}

/// The robot, under our token.
#[derive(Debug)]
pub struct Robot {
    channel: DeviceChannel,
    events: Events,
    state: Option<RobotState>,
    /// The peer that told it.
    device: Option<String>,
    /// That of the token.
    fence: u64,
    /// Whether a command was sent whose end was not told.
    runs: bool,
}

impl Robot {
    /// The robot in this channel, as the owner of its token with this fence.
    #[must_use]
    pub fn new(channel: DeviceChannel, fence: u64) -> Robot {
        Robot {
            events: channel.events(),
            channel,
            state: None,
            device: None,
            fence,
            runs: false,
        }
    }

    /// Carries out a command to its end.
    ///
    /// # Errors
    /// A robot that is stopped or not there, or that began and failed; a pose that it cannot reach is an end.
    pub async fn carry_out(&mut self, command: &str) -> Result<CommandEnd, VerbFailure> {
        self.carry_out_with(command, &Map::new()).await
    }

    /// The same with bytes that the command names, such as a sound: a map of names to binary values.
    ///
    /// # Errors
    /// As [`carry_out`](Self::carry_out).
    pub async fn carry_out_with(
        &mut self,
        command: &str,
        attachments: &Map,
    ) -> Result<CommandEnd, VerbFailure> {
        let content = match attachments.is_empty() {
            true => Value::from(command),
            false => Map::new()
                .with("script", command)
                .with("attachments", attachments.clone())
                .into(),
        };
        let (mut unlinked, mut unmeasured) = (None, None);
        loop {
            let mut parcel = Parcel::new(Family::Message, "command").content(content.clone());
            // Not under another ownership, should the token be lost and come back meanwhile.
            parcel.fence = Some(self.fence);
            let what = format!("send {command:?}");
            // From here on it may run, whether or not its receipt comes.
            self.runs = true;
            let id = self.channel.send(parcel, &what).await?;
            let status = self.outcome(Some(id)).await?;
            if status.state == "finished" {
                return Ok(CommandEnd::Done);
            }
            let error = status.error.unwrap_or_default();
            match Trouble::of(&error) {
                Trouble::Pose => return Ok(CommandEnd::Refused(refusal(&error).text)),
                Trouble::ChangingHands => {
                    while !self
                        .state
                        .as_ref()
                        .is_some_and(|state| state.stands_for(self.fence))
                    {
                        self.next().await?;
                    }
                }
                Trouble::Unlinked => {
                    let until = *unlinked.get_or_insert_with(|| Instant::now() + UNLINKED);
                    self.linked(until, &error).await?;
                }
                // No event tells that it is done.
                Trouble::Unmeasured
                    if Instant::now() < *unmeasured.get_or_insert_with(|| Instant::now() + UNMEASURED) =>
                {
                    self.rest(MEASURED).await?;
                }
                Trouble::Stopped => {
                    return Err(VerbFailure::new(
                        format!("the robot in {} is stopped", self.channel.path()),
                        format!("let it go with: mom unstop {}", self.channel.path()),
                    ));
                }
                Trouble::Unmeasured | Trouble::Other => {
                    let error = refusal(&error);
                    return Err(VerbFailure::Refused { what, error });
                }
            }
        }
    }

    /// The last report about a command; about any of ours if its id is not known.
    async fn outcome(&mut self, id: Option<u64>) -> Result<CommandStatus, VerbFailure> {
        loop {
            let event = self.next().await?;
            if let Some(status) = self.status(&event, id)
                && matches!(status.state.as_str(), "finished" | "error")
            {
                self.runs = false;
                return Ok(status);
            }
        }
    }

    /// Gives the token back by `release`, so that the hub halts it; what runs is heard to have ended.
    pub(crate) async fn halt(
        &mut self,
        release: impl Future<Output = Result<(), VerbFailure>>,
    ) -> Result<(), VerbFailure> {
        if !self.runs {
            return release.await;
        }
        // Its own ends are told to the next driver, too.
        let device = self.channel.clone();
        let ended = async {
            // Where events end or were lost, its end is not known, and it says nothing.
            if self.outcome(None).await.is_err() {
                std::future::pending::<()>().await;
            }
        };
        let (released, halt) = crate::ending::halt(&device, release, ended).await;
        crate::both(released, halt.verdict(device.path().as_str()))
    }

    /// Waits for news that the controller is there, of which this error said that it is not.
    async fn linked(&mut self, until: Instant, error: &Value) -> Result<(), VerbFailure> {
        loop {
            let event = timeout_at(until, self.next()).await.map_err(|_| {
                VerbFailure::plain(format!(
                    "the robot in {} has had no link to its controller for {} s: {}",
                    self.channel.path(),
                    UNLINKED.as_secs(),
                    refusal(error).text
                ))
            })??;
            let news = matches!(&event, Event::Message(parcel) if parcel.name() == "state");
            if news && self.state.as_ref().is_some_and(|state| state.linked) {
                return Ok(());
            }
        }
    }

    /// Lets it rest for so long; whatever is said meanwhile must not pile up.
    ///
    /// # Errors
    /// A lost connection, lost events.
    pub async fn rest(&mut self, time: Duration) -> Result<(), VerbFailure> {
        let until = Instant::now() + time;
        while let Ok(event) = timeout_at(until, self.event()).await {
            self.note(&event?)?;
        }
        Ok(())
    }

    /// The newest state that it has told; waits for the first.
    ///
    /// # Errors
    /// A robot that says nothing; a lost connection, lost events.
    pub async fn state(&mut self) -> Result<RobotState, VerbFailure> {
        // What has come meanwhile is newer.
        while let Ok(event) = timeout(Duration::ZERO, self.event()).await {
            self.note(&event?)?;
        }
        loop {
            if let Some(state) = &self.state {
                return Ok(state.clone());
            }
            self.next().await?;
        }
    }

    /// The state in which it rests at a pose, where it has just gone.
    ///
    /// # Errors
    /// As [`state`](Self::state).
    pub async fn rests_at(&mut self, pose: &Pose) -> Result<RobotState, VerbFailure> {
        loop {
            let rests = self
                .state
                .as_ref()
                .filter(|state| !state.moving && state.pose.is_at(pose));
            if let Some(state) = rests {
                return Ok(state.clone());
            }
            self.next().await?;
        }
    }

    /// The next event here, which comes before long.
    async fn next(&mut self) -> Result<Event, VerbFailure> {
        let event = timeout(SILENT, self.event()).await.map_err(|_| {
            VerbFailure::new(
                format!(
                    "the robot in {} says nothing for {} s",
                    self.channel.path(),
                    SILENT.as_secs()
                ),
                "see who is there: mom tree",
            )
        })??;
        self.note(&event)?;
        Ok(event)
    }

    /// The next event here. Cancel safe.
    async fn event(&mut self) -> Result<Event, VerbFailure> {
        self.events.next().await.ok_or_else(closed)
    }

    /// Takes a state, and fails where what the robot does is not known any more.
    fn note(&mut self, event: &Event) -> Result<(), VerbFailure> {
        match event {
            Event::Message(parcel) if parcel.name() == "state" => {
                if let Ok(state) = from_value(parcel.value()) {
                    self.state = Some(state);
                }
                if !parcel.is_history() {
                    self.device = parcel.sender.as_deref().map(str::to_owned);
                }
            }
            event if let Some(gone) = self.device.as_deref().and_then(|device| gone(event, device)) => {
                return Err(VerbFailure::new(
                    format!("{gone} {}", self.channel.path()),
                    "see who is there: mom tree",
                ));
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
        Ok(())
    }

    /// What an event says about our command.
    fn status(&self, event: &Event, id: Option<u64>) -> Option<CommandStatus> {
        let Event::Message(parcel) = event else {
            return None;
        };
        if parcel.name() != "status" || parcel.is_history() {
            return None;
        }
        let status: CommandStatus = from_value(parcel.value()).ok()?;
        let ours = status.peer == self.channel.me() && status.fence.is_none_or(|fence| fence == self.fence);
        (ours && (id.is_none() || status.id == id)).then_some(status)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_pose_that_cannot_be_reached_is_left_out() {
        for (name, retry, trouble) in [
            ("workspace-boundary", false, Trouble::Pose),
            ("joint-limit", false, Trouble::Pose),
            ("singularity", false, Trouble::Pose),
            ("link", true, Trouble::Unlinked),
            ("link", false, Trouble::Other),
            ("changing-hands", true, Trouble::ChangingHands),
            // It has waited with the command in vain.
            ("changing-hands", false, Trouble::Other),
            ("too-old", true, Trouble::Unmeasured),
            ("too-old", false, Trouble::Other),
            ("stopped", false, Trouble::Stopped),
            ("torque-overload", false, Trouble::Other),
            ("halted", false, Trouble::Other),
            ("queue-full", true, Trouble::Other),
        ] {
            let error = Map::new().with("name", name).with("retry", retry);
            assert_eq!(Trouble::of(&error.into()), trouble, "{name}");
        }
        assert_eq!(Trouble::of(&Value::default()), Trouble::Other);
    }
}
