//! A script under the token: sent, followed, and ended before its own end where it has to be.

use std::time::Duration;

use mom_client::{Card, Lost, TokenGuard, visible};
use mom_drive::{
    Basis, Command, CommandEnd, Commander, Doing as _, Halt, How, Next, Progress as Step, Report, VerbFailure,
};
use serde_json::json;

use crate::answer::Answer;
use crate::assistant::Assistant;
use crate::device::fastest;
use crate::progress::Progress;

/// So long the robot may take to stand under a new owner.
const HANDS: Duration = Duration::from_secs(5);
/// mm/s and degrees/s of a velocity under a token that came without a scope.
const FASTEST: f64 = 100.0;

/// How a script came to its end.
pub(crate) enum End {
    Ended(CommandEnd),
    Lost(Lost),
    Cancelled,
    /// What it may do under the token is over; why.
    Over(String),
    /// It was not sent.
    Unsent(Answer),
}

/// The answer of a script that was not carried out.
pub(crate) fn failed(end: &CommandEnd) -> Answer {
    match &end.how {
        How::Failed(report) => refused(report),
        How::Refused(error) => Answer::refused("send the script", error),
        _ => {
            let answer = Answer::bad(end.name(), end.text.clone());
            end.hint.iter().fold(answer, |answer, hint| answer.and(hint))
        }
    }
}

/// That of one which the robot has ended.
fn refused(report: &Report) -> Answer {
    let place = match report.statement {
        0 => String::new(),
        number => format!(" at statement {number} of {}", report.of),
    };
    let what = format!("the robot ended the script with an error{place}");
    let answer = match &report.error {
        Some(_) => {
            let mut error = report.wire_error();
            // It is the device's own text.
            error.text = visible(&error.text);
            Answer::refused(&what, &error)
        }
        None => Answer::bad("failed", what),
    };
    answer
        .with("status", json!("error"))
        .with("statement", json!(report.statement))
        .with("of", json!(report.of))
}

/// Sends a script and waits for its end; `runs` has its commander, once it was sent.
pub(crate) async fn carry_out(
    assistant: &Assistant,
    guard: &mut TokenGuard,
    (script, is_relative): (&str, bool),
    progress: &mut Progress,
    runs: &mut Option<Commander>,
) -> End {
    let fence = guard.fence();
    let basis = match (is_relative, assistant.told()) {
        (false, _) => Basis::Nothing,
        (true, Some(told)) => Basis::State(told),
        (true, None) => {
            let text = "the script is relative to where the robot is: call `where` first, so that you know";
            return End::Unsent(Answer::bad("stale-state", text));
        }
    };
    // What comes while the robot still halts for its last owner is refused, and nothing is tried a second time.
    let stands = assistant.robot_state_when(HANDS, |state| state.is_under(fence));
    tokio::select! {
        biased;
        lost = guard.lost() => return End::Lost(lost),
        why = assistant.over(fence) => return End::Over(why),
        () = progress.cancelled() => return End::Cancelled,
        _stands = stands => {}
    }
    let commander = runs.insert(Commander::new(assistant.robot.clone(), fence));
    commander.begin(Command::from(script).based_on(basis).once());
    loop {
        tokio::select! {
            biased;
            lost = guard.lost() => return End::Lost(lost),
            why = assistant.over(fence) => return End::Over(why),
            () = progress.cancelled() => return End::Cancelled,
            next = commander.next() => match next {
                Next::End(end) => return End::Ended(end),
                Next::Progress(Step::Device { state, statement, of }) => {
                    let words = format!("{} statement {statement} of {of}", visible(&state));
                    progress.tell(statement.into(), Some(of.into()), words).await;
                }
                Next::Progress(Step::Again { text, .. }) => progress.tell(0.0, None, format!("not yet: {text}")).await,
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
pub(crate) async fn hand_back(guard: TokenGuard, runs: Option<Commander>) -> HandedBack {
    let what = format!("give {} back", guard.path());
    let release = async { guard.release().await.doing(what) };
    match runs {
        Some(mut commander) => {
            let (released, halt) = commander.halt(release).await;
            (true, released, halt)
        }
        None => (false, release.await, Halt::Confirmed),
    }
}

/// Whether the robot says soon that the script has ended whose token is lost; also where none was sent.
pub(crate) async fn has_heard_the_end(lost: &Lost, runs: Option<Commander>) -> bool {
    let Some(mut commander) = runs else { return true };
    let end = commander.lost(lost).await;
    !end.is_some_and(|end| {
        matches!(
            end.how,
            How::Lost {
                ended: Some(false),
                ..
            } | How::Disconnected
        )
    })
}

/// The answer where a script was ended before its own end.
pub(crate) fn halted(code: &str, why: &str, place: &str, (sent, released, halt): HandedBack) -> Answer {
    let mut answer = Answer::bad(code, why);
    if let Err(failure) = &released {
        answer = answer.and(&format!("{failure}; it halts the robot when it notices that"));
    }
    if !sent {
        return answer
            .and("nothing was sent to the robot")
            .with("ended", json!(true));
    }
    match halt.verdict(place) {
        Ok(()) => answer.and("the robot has ended it").with("ended", json!(true)),
        Err(failure) => answer
            .and(&format!("{failure}: tell a person at once"))
            .with("ended", json!(halt == Halt::Stopped)),
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
