//! `mom fleet feed`: hands out commands to a robot that asks for them (W22).

use std::collections::VecDeque;
use std::future::Future;
use std::path::Path;
use std::time::Duration;

use mom_client::{Client, Code, Event, Parcel, Value, WireError};
use mom_device::{ErrorName, Script};
use mom_drive::{DeviceChannel, Holding, Tell, VerbFailure, WorkEnd, closed, lost_words, refusal};
use serde_json::json;
use tokio::time::timeout;

use crate::Unit;

/// A robot that asks does so within this time, unless it has something to do.
const ASKS: Duration = Duration::from_secs(65);

/// What is fed to whom.
pub(super) struct Feeding<'a> {
    /// The robot's session.
    pub(super) robot: &'a str,
    pub(super) statements: VecDeque<String>,
    /// For how long each is good.
    pub(super) within: Duration,
}

/// The statements of a file, one each, if all of them can be read.
pub(super) fn statements(file: &Path) -> Result<VecDeque<String>, VerbFailure> {
    let (name, text) = super::steps::text(file)?;
    Script::read::<Unit>(&text).map_err(|error| {
        let (line, column) = error.place().unwrap_or((1, 1));
        VerbFailure::new(
            format!("{name}:{line}:{column}: {error}"),
            "mom fleet send --help lists the statements",
        )
    })?;
    let lines = text
        .lines()
        .map(|line| line.split('#').next().unwrap_or_default());
    let statements = lines.flat_map(|line| line.split(';')).map(str::trim);
    Ok(statements
        .filter(|statement| !statement.is_empty())
        .map(str::to_owned)
        .collect())
}

/// Whether a robot that refuses a statement has not begun it, and asks again. The first one of a new owner may wait in the robot until
/// that knows that it rests, and be too old by then.
fn is_handed_out_again(error: &WireError) -> bool {
    error.code == Code::EXPIRED || error.code.word() == ErrorName::TooOld.as_str()
}

impl Feeding<'_> {
    /// Grabs the token, hands out one statement after the other, and gives the token back.
    pub(super) async fn run(
        self,
        client: &Client,
        interrupt: impl Future<Output = ()>,
        tell: Tell<'_>,
    ) -> Result<(), VerbFailure> {
        let channel = DeviceChannel::join(client, &format!("{}/robot", self.robot)).await?;
        let token = channel.token()?;
        let token = token.as_str();
        let mut holding = Holding::grab(client, token, None).await?;
        let fence = holding.fence();
        let fed = match holding.during(interrupt, self.feed(&channel, fence, tell)).await {
            WorkEnd::Ended(fed) => fed,
            WorkEnd::Interrupted => Err(VerbFailure::plain(
                "interrupted; the token is released, and the hub halts the robot",
            )),
            WorkEnd::Lost(lost) => return Err(VerbFailure::plain(lost_words(token, &lost))),
        };
        mom_drive::both(fed, holding.release().await)
    }

    async fn feed(self, channel: &DeviceChannel, fence: u64, tell: Tell<'_>) -> Result<(), VerbFailure> {
        let mut events = channel.events();
        for statement in &self.statements {
            // The commands by which it was handed out: at most one is ever taken.
            let mut sent: Vec<u64> = Vec::new();
            let mut taken = false;
            loop {
                let event = match taken {
                    true => events.next().await,
                    false => timeout(ASKS, events.next()).await.map_err(|_| self.silent())?,
                };
                let parcel = match event.ok_or_else(closed)? {
                    Event::Message(parcel) => parcel,
                    Event::LinkDown | Event::Lagged(_) => {
                        let text = "events of the robot were lost here; what it did is not known";
                        return Err(VerbFailure::plain(text));
                    }
                    _ => continue,
                };
                let content = parcel.value();
                match parcel.name() {
                    "next" if !taken => {
                        let Some(asked) = parcel.id else { continue };
                        if !sent.is_empty() {
                            tell(
                                json!({"state": "late", "statement": statement}),
                                format!("late      {statement}: not begun in time, handed out again"),
                            )?;
                        }
                        sent.extend(self.hand_out(channel, statement, asked, fence).await?);
                    }
                    "status"
                        if parcel.reference.is_some_and(|id| sent.contains(&id))
                            && content.get("peer").and_then(Value::as_str) == Some(&*channel.me()) =>
                    {
                        match content.get("state").and_then(Value::as_str) {
                            Some("finished") => break,
                            Some("error") => {
                                let error = refusal(content.get("error").unwrap_or(&Value::default()));
                                if !is_handed_out_again(&error) {
                                    let what = format!("have {} do {statement:?}", self.robot);
                                    return Err(VerbFailure::Refused { what, error });
                                }
                                taken = false;
                                tell(
                                    json!({"state": "expired", "statement": statement, "error": error.text}),
                                    format!("expired   {statement}: {error}"),
                                )?;
                            }
                            _ => taken = true,
                        }
                    }
                    _ => {}
                }
            }
            tell(
                json!({"state": "finished", "statement": statement}),
                format!("finished  {statement}"),
            )?;
        }
        Ok(())
    }

    /// The id of the command; none if it expired on its way to the hub.
    async fn hand_out(
        &self,
        channel: &DeviceChannel,
        statement: &str,
        asked: u64,
        fence: u64,
    ) -> Result<Option<u64>, VerbFailure> {
        let mut command = Parcel::new(mom_client::Family::Message, "command").content(statement);
        command.fence = Some(fence);
        command.reference = Some(asked);
        command.expires = u64::try_from(self.within.as_millis()).ok();
        match channel.send(command, &format!("send {statement:?}")).await {
            Ok(id) => Ok(Some(id)),
            Err(VerbFailure::Hub { error, .. }) if error.code() == Some(&Code::EXPIRED) => Ok(None),
            // As long as this program's clock is not measured; the robot asks again.
            Err(VerbFailure::Hub { error, .. }) if error.code() == Some(&Code::TRY_LATER) => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn silent(&self) -> VerbFailure {
        VerbFailure::new(
            format!("{} asks for nothing", self.robot),
            "start it with mom-rover --pull, let it go with mom unstop, or drive it with mom fleet send",
        )
    }
}

#[cfg(test)]
mod tests {
    use mom_device::DeviceError;

    use super::*;

    #[test]
    fn what_a_robot_has_not_begun_is_handed_out_again() {
        let refused = |name| {
            let error = DeviceError::new(name, "the command waited 640 ms longer than it is good for");
            let told = mom_client::to_value(&error).expect("a map");
            is_handed_out_again(&refusal(&told))
        };
        assert!(refused(ErrorName::TooOld));
        assert!(!refused(ErrorName::Obstacle) && !refused(ErrorName::Halted));
        assert!(is_handed_out_again(&WireError::new(Code::EXPIRED, "late")));
    }
}
