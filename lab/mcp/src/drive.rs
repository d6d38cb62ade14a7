//! `request_token`, `move`, `return_token` and `stop`.

use std::sync::Arc;
use std::time::Duration;

use mom_client::{ClientError, Family, Loan, Lost, Parcel, TokenGuard, plain_duration};
use serde::Deserialize;
use serde_json::{Value as Json, json};
use tokio::time::{Instant, interval_at, timeout};

use crate::answer::Answer;
use crate::assistant::{Assistant, UNSCOPED, loss_words};
use crate::device::{DeviceState, check};
use crate::progress::Progress;
use crate::script::{End, carry_out, failed, halted, hand_back, has_heard_the_end, too_fast};
use crate::sight::{count_words, give_command, scope_words};

/// How long a person may take by default: clients of MCP wait a minute.
const PATIENCE: u64 = 50;
/// How often a waiting client is told so.
const TOLD: Duration = Duration::from_secs(2);
/// So long devices may take to say that they stand.
const STANDS: Duration = Duration::from_secs(1);
/// So long the state may be behind the report of the same end.
const LATER: Duration = Duration::from_millis(200);
/// Who carries out a command has come to rest so soon after it.
const REST: Duration = Duration::from_secs(2);

/// The arguments of `request_token`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Wish {
    reason: String,
    #[serde(default)]
    for_seconds: Option<u64>,
    #[serde(default)]
    commands: Option<u64>,
    #[serde(default)]
    wait_seconds: Option<u64>,
}

impl Wish {
    /// Whether it can be asked; else what is wrong.
    pub(crate) fn check(&self) -> Result<(), String> {
        if self.reason.trim().is_empty() || self.reason.chars().count() > 500 {
            return Err("`reason` is to say in 1 to 500 characters what you want to do".to_owned());
        }
        for (name, number, most) in [
            ("for_seconds", self.for_seconds, 86_400),
            ("commands", self.commands, 10_000),
            ("wait_seconds", self.wait_seconds, 600),
        ] {
            if number.is_some_and(|number| number == 0 || number > most) {
                return Err(format!("`{name}` must be a number from 1 to {most}"));
            }
        }
        Ok(())
    }

    fn within(&self) -> Duration {
        Duration::from_secs(self.wait_seconds.unwrap_or(PATIENCE))
    }

    /// The reason as the owner reads it.
    fn text(&self) -> String {
        let seconds = self.for_seconds.map(|seconds| format!("{seconds} s"));
        let commands = self.commands.map(count_words);
        let wanted: Vec<String> = seconds.into_iter().chain(commands).collect();
        match wanted.is_empty() {
            true => self.reason.clone(),
            false => format!("{} (for {})", self.reason, wanted.join(" and ")),
        }
    }
}

/// `request_token`
pub(crate) async fn request_token(
    assistant: &Arc<Assistant>,
    wish: &Wish,
    progress: &mut Progress,
) -> Answer {
    if let Some(answer) = granted(assistant) {
        return answer;
    }
    let info = match assistant.token_info().await {
        Ok(info) => info,
        Err(answer) => return answer,
    };
    let (me, path) = (assistant.client.name(), &assistant.places.token);
    let offered = info.offer.is_some_and(|offer| offer.to == me);
    // An offer is accepted as it comes; this one is just about to be.
    if (offered || info.owner.as_deref() == Some(&*me)) && assistant.taken_soon().await {
        return granted(assistant)
            .unwrap_or_else(|| Answer::bad("lost", format!("{path} was granted and lost at once")));
    }
    if !info.holders.is_empty() {
        let holders = info.holders.join(", ");
        return Answer::bad(
            "held",
            format!("{path} is inhibited by {holders}: nobody may drive now"),
        );
    }
    match info.owner {
        Some(owner) => ask(assistant, wish, &owner, progress).await,
        None => wait_for_gift(assistant, wish, progress).await,
    }
}

/// Nobody can be asked: says how a person gives the token, and waits for that where the call says for how long.
async fn wait_for_gift(assistant: &Assistant, wish: &Wish, progress: &mut Progress) -> Answer {
    let (path, command) = (&assistant.places.token, give_command(assistant));
    if let Some(seconds) = wish.wait_seconds {
        let words = format!("waiting for a person to give {path}: {command}");
        progress.tell(0.0, None, words).await;
        tokio::select! {
            biased;
            () = progress.cancelled() => return Answer::bad("cancelled", "before anybody gave the token"),
            given = timeout(Duration::from_secs(seconds), assistant.taken()) => {
                if let (Ok(()), Some(answer)) = (given, granted(assistant)) {
                    return answer;
                }
            }
        }
    }
    let text = format!(
        "nobody holds {path}, so there is no peer to ask, and you cannot take it yourself. A person gives it to you by: \
         {command}   (it is accepted as soon as it is offered; then call request_token again, or call it with wait_seconds \
         to wait for that)"
    );
    Answer::bad("not-granted", text).with("give", json!(command))
}

/// Asks the owner and waits for the token, which may be handed over, or given with a scope.
async fn ask(assistant: &Arc<Assistant>, wish: &Wish, owner: &str, progress: &mut Progress) -> Answer {
    let path = &assistant.places.token;
    let Some(token) = assistant.token().await else {
        return Answer::bad(
            "try-later",
            format!("{path} is being joined again; call again in a second"),
        );
    };
    let asked = Instant::now();
    let mut told = interval_at(asked, TOLD);
    let request = token.request().within(wish.within()).text(wish.text());
    let mut request = std::pin::pin!(async move { request.await });
    let error = loop {
        tokio::select! {
            biased;
            () = progress.cancelled() => {
                assistant.withdraw().await;
                return Answer::bad("cancelled", format!("the request to {owner} is taken back"));
            }
            () = assistant.taken() => break None,
            answer = &mut request => match answer {
                Ok(guard) => {
                    assistant.put(guard);
                    assistant.keep_to(&token, wish.for_seconds.map(Duration::from_secs), wish.commands);
                    break None;
                }
                Err(error) => break Some(error),
            },
            _ = told.tick() => {
                let waited = asked.elapsed().as_secs_f64();
                let words = format!("{owner} has been asked for {path} and has not answered yet");
                progress.tell(waited, Some(wish.within().as_secs_f64()), words).await;
            }
        }
    };
    match error {
        None => granted(assistant)
            .unwrap_or_else(|| Answer::bad("lost", format!("{path} was granted and lost at once"))),
        // The owner may have given it instead of answering.
        Some(error) if is_withdrawn(&error) && assistant.taken_soon().await => {
            granted(assistant).unwrap_or_else(|| Answer::of_client("request", &error))
        }
        Some(error) => Answer::of_client(&format!("{owner} was asked for {path}"), &error),
    }
}

fn is_withdrawn(error: &ClientError) -> bool {
    error.code().is_some_and(|code| code.word() == "withdrawn")
}

/// What was granted, if the token is in the hand.
fn granted(assistant: &Assistant) -> Option<Answer> {
    let (fence, loan) = assistant.held(|guard| (guard.fence(), guard.delegation().cloned()))?;
    let path = &assistant.places.token;
    let text = match &loan {
        Some(Loan {
            from, time, commands, ..
        }) => {
            let time = time.map(plain_duration);
            let commands = commands.map(count_words);
            let scope: Vec<String> = time.into_iter().chain(commands).collect();
            format!(
                "you hold {path}, given by {from} for {}; it goes back to {from} by itself then, or at return_token",
                scope.join(" or ")
            )
        }
        None => format!(
            "you hold {path}, handed over for good: it is given back after what you asked for, or else after {} s or {}; call \
             return_token as soon as you are done",
            UNSCOPED.0.as_secs(),
            count_words(UNSCOPED.1)
        ),
    };
    let scope = loan.map(|loan| {
        let seconds = loan.time.map(|time| time.as_secs_f64());
        json!({"from": loan.from, "for_seconds": seconds, "commands": loan.commands})
    });
    Some(Answer::good(
        text,
        json!({"granted": true, "fence": fence, "scope": scope}),
    ))
}

/// `move`
pub(crate) async fn run(assistant: &Assistant, script: &str, progress: &mut Progress) -> Answer {
    let mut guard = match take(assistant).await {
        Ok(guard) => guard,
        Err(answer) => return *answer,
    };
    let card = assistant.card().await;
    let read = match check(card.as_ref(), script) {
        Ok(is_relative) if assistant.is_unscoped(guard.fence()) => {
            too_fast(card.as_ref(), script).map_or(Ok(is_relative), |answer| Err(Box::new(answer)))
        }
        read => read,
    };
    let is_relative = match read {
        Ok(is_relative) => is_relative,
        Err(answer) => {
            assistant.put(guard);
            return *answer;
        }
    };
    let before = assistant.newest();
    let mut runs = None;
    let end = carry_out(assistant, &mut guard, (script, is_relative), progress, &mut runs).await;
    let path = &assistant.places.token;
    let answer = match end {
        // Nobody watches any more: the lender has it back, and the hub halts the robot.
        End::Cancelled => {
            let ended = hand_back(guard, runs).await;
            return halted(
                "cancelled",
                &format!("{path} is given back"),
                &assistant.places.robot,
                ended,
            );
        }
        End::Over(why) => {
            assistant.lose(Lost {
                reason: format!("{why}, so it was given back"),
                by: None,
            });
            let ended = hand_back(guard, runs).await;
            let answer = halted(
                "over",
                &format!("{why}, so the script was ended and {path} is given back; do not go on"),
                &assistant.places.robot,
                ended,
            );
            return with_rest(assistant, answer, before).await;
        }
        End::Lost(lost) => {
            let has_ended = has_heard_the_end(&lost, runs).await;
            lost_to(assistant, lost, guard.delegation(), has_ended)
        }
        End::Ended(end) if end.is_finished() => Answer::good("finished", json!({"status": "finished"})),
        End::Ended(end) => failed(&end),
        End::Unsent(answer) => answer,
    };
    let last = !guard.is_lost() && assistant.put_after_command(guard).await;
    let answer = with_rest(assistant, answer, before).await;
    match last {
        true => answer.and(&format!(
            "that was the last that you may do with {path}, so it was given back"
        )),
        false => answer,
    }
}

/// The answer where the token is lost. The hub has halted the robot, or it did so itself at the loss of its link; that it has is for it
/// to say.
fn lost_to(assistant: &Assistant, lost: Lost, loan: Option<&Loan>, has_ended: bool) -> Answer {
    let heard = match has_ended {
        true => "the robot has ended the script",
        false => "the robot has not said that it has ended the script: tell a person at once",
    };
    let words = loss_words(&assistant.places.token, &lost, loan);
    let answer = Answer::bad("lost", format!("you have {words}; do not go on; {heard}"))
        .with("ended", json!(has_ended))
        .with("lost", json!({"reason": lost.reason, "by": lost.by}));
    assistant.lose(lost);
    answer
}

/// With where the robot is now, and what is left of the scope.
async fn with_rest(assistant: &Assistant, answer: Answer, before: Option<i64>) -> Answer {
    // Its last state may come after the report. Of a script that was refused at once there is none.
    let _newer = assistant
        .robot_state_when(LATER, |state| Some(state.seq) > before)
        .await;
    let rests = assistant.robot_state_when(REST, |state| !state.moving).await;
    let mut answer = answer;
    let at = match &rests {
        Ok(_) => "the robot is at",
        Err(_) => "by its last word, and perhaps no more, the robot is at",
    };
    if let Ok(seen) | Err(Some(seen)) = rests {
        assistant.tell(&seen);
        let words = format!("{at} {}", seen.state.place_words(assistant.card().await.as_ref()));
        answer = answer.and(&words).with_all(facts_of(&seen.state));
    }
    let Ok(info) = assistant.token_info().await else {
        return answer;
    };
    let me = assistant.client.name();
    if let (Some(scope), true) = (info.delegated, info.owner == Some(me)) {
        let left = json!({"left_seconds": scope.left.map(|left| left.as_secs_f64()), "commands_left": scope.commands});
        let words = match scope.commands {
            Some(0) => "that was the last command of the scope".to_owned(),
            _ => scope_words(scope.left, scope.commands),
        };
        answer = answer.and(&words).with("scope", left);
    }
    answer
}

fn facts_of(state: &DeviceState) -> serde_json::Map<String, Json> {
    let mut facts = serde_json::Map::new();
    state.add_to(&mut facts);
    facts
}

/// Takes the token to move the robot; why nothing is moved.
async fn take(assistant: &Assistant) -> Result<TokenGuard, Box<Answer>> {
    let lost = match assistant.take().await {
        Ok(guard) => return Ok(guard),
        Err(lost) => lost,
    };
    let path = &assistant.places.token;
    let owner = assistant.token_info().await.ok().and_then(|info| info.owner);
    // What was given is just about to be in the hand.
    if owner == Some(assistant.client.name())
        && assistant.taken_soon().await
        && let Ok(guard) = assistant.take().await
    {
        return Ok(guard);
    }
    let now = match owner {
        Some(owner) => format!("{owner} holds it now; ask with request_token"),
        None => format!(
            "nobody holds it now; a person gives it to you by: {}",
            give_command(assistant)
        ),
    };
    let why = lost.map_or_else(
        || format!("you do not hold {path}"),
        |lost| format!("you have {lost}"),
    );
    Err(Box::new(Answer::bad(
        "not-owner",
        format!("nothing was moved: {why}. {now}"),
    )))
}

/// `return_token`
pub(crate) async fn return_token(assistant: &Assistant) -> Answer {
    let path = &assistant.places.token;
    let guard = match assistant.take().await {
        Ok(guard) => guard,
        Err(lost) => {
            assistant.forget_loss();
            let text = match lost {
                Some(lost) => format!("there is nothing to give back: you have {lost}"),
                None => format!("there is nothing to give back: you do not hold {path}"),
            };
            return Answer::good(text, json!({"returned": false}));
        }
    };
    let to = guard.delegation().map(|loan| loan.from.clone());
    match guard.release().await {
        Ok(()) => {
            assistant.forget_loss();
            let text = match &to {
                Some(to) => format!("{path} is given back to {to}; the robot stands"),
                None => format!("{path} is free; the robot stands"),
            };
            Answer::good(text, json!({"returned": true, "to": to}))
        }
        Err(error) => Answer::of_client(&format!("give {path} back"), &error),
    }
}

/// `stop`
pub(crate) async fn stop(assistant: &Assistant) -> Answer {
    let path = &assistant.places.robot;
    let message = Parcel::new(Family::Message, "stop");
    if let Err(failure) = assistant.robot.send(message, &format!("stop {path}")).await {
        return Answer::from(&failure);
    }
    let release = format!("mom unstop {path}");
    match assistant.robot_state_when(STANDS, |state| state.stopped).await {
        Ok(seen) => {
            assistant.tell(&seen);
            let text = format!(
                "the robot stands at {}, and stays so until a person lets it go by: {release}",
                seen.state.place_words(assistant.card().await.as_ref())
            );
            Answer::good(text, json!({"stands": true, "unstop": release})).with_all(facts_of(&seen.state))
        }
        Err(_) => {
            let text = format!(
                "the stop was sent, but the robot has not said within {} s that it stands: tell a person at once",
                STANDS.as_secs()
            );
            Answer::bad("silent", text).with("stands", Json::Null)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wish(json: Json) -> Result<Wish, serde_json::Error> {
        serde_json::from_value(json)
    }

    #[test]
    fn a_wish_has_a_reason_and_limits() {
        let full =
            json!({"reason": "to fetch the cup", "for_seconds": 60, "commands": 5, "wait_seconds": 10});
        let full = wish(full).expect("all are known");
        assert_eq!(full.check(), Ok(()));
        assert_eq!(full.text(), "to fetch the cup (for 60 s and 5 commands)");
        for (bad, named) in [
            (json!({"reason": " "}), "reason"),
            (json!({"reason": "x".repeat(501)}), "reason"),
            (json!({"reason": "x", "for_seconds": 0}), "for_seconds"),
            (json!({"reason": "x", "commands": 10_001}), "commands"),
            (json!({"reason": "x", "wait_seconds": 601}), "wait_seconds"),
        ] {
            let told = wish(bad)
                .expect("it can be read")
                .check()
                .expect_err("it is wrong");
            assert!(told.contains(named), "{told}");
        }
        for bad in [
            json!({}),
            json!({"reason": 7}),
            json!({"reason": "x", "more": 1}),
            json!({"reason": "x", "commands": -1}),
        ] {
            assert!(wish(bad.clone()).is_err(), "{bad}");
        }
    }
}
