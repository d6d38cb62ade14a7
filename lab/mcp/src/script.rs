//! A script under the token: sent, followed, and ended before its own end where it has to be.

use std::future::pending;
use std::time::Duration;

use mom_client::{
    BASED_ON, Card, Event, Events, Family, Lost, Parcel, TokenGuard, Value, WireError, from_value, visible,
};
use mom_drive::{Doing as _, HALTED, Halt, VerbFailure, halt};
use serde::Deserialize;
use serde_json::json;
use tokio::time::timeout;

use crate::answer::Answer;
use crate::assistant::Assistant;
use crate::device::fastest;
use crate::progress::Progress;

/// So long the robot may take to stand under a new owner.
const HANDS: Duration = Duration::from_secs(5);
/// An arm that says nothing for so long while it works is not there; a statement may wait for a minute.
const SILENT: Duration = Duration::from_secs(90);
/// mm/s and degrees/s of a velocity under a token that came without a scope.
const FASTEST: f64 = 100.0;

/// How a command came to its end.
pub(crate) enum End {
    Finished,
    Failed(Status),
    Lost(Lost),
    Cancelled,
    /// What it may do under the token is over; why.
    Over(String),
    /// What became of it is not known.
    Unknown(Answer),
}

/// A report about a command.
#[derive(Debug, Deserialize)]
pub(crate) struct Status {
    #[serde(default)]
    id: Option<u64>,
    peer: String,
    state: String,
    #[serde(default)]
    pub(crate) statement: u32,
    #[serde(default)]
    pub(crate) of: u32,
    #[serde(default)]
    error: Option<Value>,
}

/// A script that was sent.
pub(crate) struct Running {
    events: Events,
    /// None as long as its receipt has not come.
    id: Option<u64>,
}

/// The error of a command.
pub(crate) fn failed(status: &Status) -> Answer {
    let error = status.error.clone().unwrap_or_default();
    // It is the device's own text.
    let error = error.as_map().map(WireError::from_map).map(|mut error| {
        error.text = visible(&error.text).to_string();
        error
    });
    let place = match status.statement {
        0 => String::new(),
        number => format!(" at statement {number} of {}", status.of),
    };
    let what = format!("the robot ended the script with an error{place}");
    let answer = match error {
        Some(error) => Answer::refused(&what, &error),
        None => Answer::bad("failed", what),
    };
    answer
        .with("status", json!("error"))
        .with("statement", json!(status.statement))
        .with("of", json!(status.of))
}

/// Sends a script and waits for its end.
pub(crate) async fn carry_out(
    assistant: &Assistant,
    guard: &mut TokenGuard,
    (script, is_relative): (&str, bool),
    progress: &mut Progress,
    runs: &mut Option<Running>,
) -> End {
    let fence = guard.fence();
    // A command that comes while the robot still halts for the last owner is refused.
    let stands = assistant.robot_state_when(HANDS, |state| state.is_under(fence));
    tokio::select! {
        biased;
        lost = guard.lost() => return End::Lost(lost),
        why = assistant.over(fence) => return End::Over(why),
        () = progress.cancelled() => return End::Cancelled,
        _stands = stands => {}
    }
    let events = assistant.robot.events();
    let mut parcel = Parcel::new(Family::Message, "command").content(script);
    parcel.fence = Some(fence);
    if is_relative {
        let Some(told) = assistant.told().and_then(|id| i64::try_from(id).ok()) else {
            let text = "the script is relative to where the robot is: call `where` first, so that you know";
            return End::Unknown(Answer::bad("stale-state", text));
        };
        parcel.extra.set(BASED_ON, told);
    }
    // From here on it may run, whether or not its receipt comes.
    let running = runs.insert(Running { events, id: None });
    running.id = match assistant.robot.send(parcel, "send the script").await {
        Ok(id) => Some(id),
        Err(failure) if guard.is_lost() => {
            tracing::debug!("{failure}");
            return End::Lost(guard.lost().await);
        }
        Err(failure) => return End::Unknown(Answer::from(&failure)),
    };
    loop {
        tokio::select! {
            biased;
            lost = guard.lost() => return End::Lost(lost),
            why = assistant.over(fence) => return End::Over(why),
            () = progress.cancelled() => return End::Cancelled,
            next = timeout(SILENT, running.status(assistant)) => match next {
                Ok(Ok(status)) => match status.state.as_str() {
                    "finished" => return End::Finished,
                    "error" => return End::Failed(status),
                    state => {
                        let words = format!("{state} statement {} of {}", status.statement, status.of);
                        progress.tell(status.statement.into(), Some(status.of.into()), words).await;
                    }
                },
                Ok(Err(answer)) => return End::Unknown(answer),
                Err(_) => {
                    let text = format!("the robot has said nothing for {} s; what became of the script is not known", SILENT.as_secs());
                    return End::Unknown(Answer::bad("silent", text));
                }
            },
        }
    }
}

/// Why a script is not carried out under a token that came without a scope: it drives on too fast.
pub(crate) fn too_fast(card: Option<&Card>, script: &str) -> Option<Answer> {
    (fastest(card, script) > FASTEST).then(|| {
        let text = format!(
            "a velocity is at most {FASTEST} mm/s and degrees/s under a token that came without a scope; ask a person to give it with one"
        );
        Answer::bad("too-fast", text)
    })
}

/// Whether a script was sent, whether the hub has the token back, and whether the robot has ended the script.
type HandedBack = (bool, Result<(), VerbFailure>, Halt);

/// Gives the token back, so that the hub halts the robot, and hears that the script has ended.
pub(crate) async fn hand_back(assistant: &Assistant, guard: TokenGuard, runs: Option<Running>) -> HandedBack {
    let what = format!("give {} back", guard.path());
    let release = async { guard.release().await.doing(what) };
    match runs {
        Some(mut running) => {
            let (released, halt) = halt(&assistant.robot, release, running.ended(assistant)).await;
            (true, released, halt)
        }
        None => (false, release.await, Halt::Confirmed),
    }
}

/// Whether the robot says soon that the script has ended whose token is lost; also where none was sent.
pub(crate) async fn has_heard_the_end(assistant: &Assistant, runs: Option<Running>) -> bool {
    match runs {
        Some(mut running) => timeout(HALTED, running.ended(assistant)).await.is_ok(),
        None => true,
    }
}

/// The answer where a script was ended before its own end.
pub(crate) fn halted(code: &str, why: &str, (sent, released, halt): HandedBack) -> Answer {
    let mut answer = Answer::bad(code, why);
    if let Err(failure) = &released {
        answer = answer.and(&format!("{failure}; it halts the robot when it notices that"));
    }
    if !sent {
        return answer
            .and("nothing was sent to the robot")
            .with("ended", json!(true));
    }
    match halt.verdict("the robot") {
        Ok(()) => answer.and("the robot has ended it").with("ended", json!(true)),
        Err(failure) => answer
            .and(&format!("{failure}: tell a person at once"))
            .with("ended", json!(halt == Halt::Stopped)),
    }
}

impl Running {
    /// The next report about our command.
    async fn status(&mut self, assistant: &Assistant) -> Result<Status, Answer> {
        let unknown = |code: &str, why: &str| {
            Answer::bad(
                code,
                format!("{why}; what became of the script is not known, so look"),
            )
        };
        loop {
            match self.events.next().await {
                Some(Event::Message(parcel)) if parcel.name() == "status" && !parcel.is_history() => {
                    if let Ok(status) = from_value::<Status>(parcel.value())
                        && (self.id.is_none() || status.id == self.id)
                        && status.peer == assistant.client.name()
                    {
                        return Ok(status);
                    }
                }
                Some(Event::LinkDown) | None => {
                    return Err(unknown(
                        "disconnected",
                        "the connection to the hub was lost, and the hub halts the robot",
                    ));
                }
                Some(Event::Lagged(_)) => {
                    return Err(unknown("lagged", "events of the robot were lost here"));
                }
                Some(_) => {}
            }
        }
    }

    /// Waits until the robot has said that it is over.
    async fn ended(&mut self, assistant: &Assistant) {
        loop {
            match self.status(assistant).await {
                Ok(status) if matches!(status.state.as_str(), "finished" | "error") => return,
                Ok(_) => {}
                Err(_) => return pending().await,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn velocities_without_a_scope_are_slow() {
        for (script, fast) in [
            ("move 1 2 3 0 0", false),
            ("jog 100 0 0 0 0 1000", false),
            ("home; jog 0 -101 0 0 0 1000", true),
            ("jog", false),
        ] {
            assert_eq!(too_fast(None, script).is_some(), fast, "{script}");
        }
    }
}
