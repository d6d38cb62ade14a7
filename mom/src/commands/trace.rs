//! `mom trace`: one command and its whole way, with the time of each step by the hub's clock.

use std::time::Duration;

use mom_arm::{CommandState, Status};
use mom_client::{Client, Event, Events, Family, HubClock, Parcel, Time, Value, from_value};
use mom_device::ErrorName;
use serde_json::json;
use tokio::time::{Instant, timeout_at};

use crate::cli::{self, GlobalArgs};
use crate::commands::run::drive;
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::Output;
use mom_drive::error_words;
use mom_pages::Interrupt;

/// How long the clocks may take to be compared; without that only the hub's own steps have a time.
const COMPARED: Duration = Duration::from_secs(3);

/// How long the robot may take for what it is told.
const DONE: Duration = Duration::from_secs(120);

/// One step of the way.
#[derive(Clone, Debug, PartialEq)]
struct Step {
    what: &'static str,
    /// By the hub's clock.
    at: Time,
    error: Known,
}

/// How well a time is known.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Known {
    /// It was stamped by the hub.
    Exactly,
    /// To so many µs.
    Within(u64),
    /// The clock of its sender is not known: it was this time or earlier.
    AtTheLatest,
}

pub(crate) async fn run(args: &cli::TraceArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let mut interrupt = Interrupt::install()?;
    let (channel, _, guard) = drive(&client, &args.channel, &args.token).await?;
    let mut events = channel.events();
    compare_clocks(&client.clock()).await;
    let mut parcel = Parcel::new(Family::Message, "command")
        .context(channel.path().clone())
        .content(args.script.as_str());
    parcel.receipt = Some(true);
    let steps = tokio::select! {
        () = interrupt.wait() => Err(Failure::plain("interrupted; the hub halts the robot")),
        steps = follow(&client, &mut events, parcel) => steps,
    };
    let released = guard.release().await.doing(format!("release {}", args.token));
    client.close().await;
    let (steps, refused) = steps?;
    released?;
    tell(&steps, output)?;
    match refused {
        Some(error) => Err(Failure::plain(error_words(&error))),
        None => Ok(()),
    }
}

/// Waits until this end knows the hub's clock, if it ever does.
async fn compare_clocks(clock: &HubClock) {
    let until = Instant::now() + COMPARED;
    while clock.now().is_none() && Instant::now() < until {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Sends a command, and gives the steps of its way and why it failed, if it did.
async fn follow(
    client: &Client,
    events: &mut Events,
    parcel: Parcel,
) -> Result<(Vec<Step>, Option<Value>), Failure> {
    let until = Instant::now() + DONE;
    let sent = here("sent", &client.clock());
    let receipt = client.request(parcel).await.doing("send the command")?;
    let (id, delivered) = (receipt.reference, receipt.timestamp);
    if receipt.value().get("delivered").and_then(Value::as_int) == Some(1) {
        return Err(Failure::new(
            "no robot hears this channel",
            "see who is there: mom tree",
        ));
    }
    let mut steps = Vec::new();
    loop {
        let event = timeout_at(until, events.next()).await;
        let event = event.map_err(|_| Failure::plain("the robot has not ended it in time"))?;
        let event = event.ok_or_else(|| Failure::plain("the connection to the hub is closed"))?;
        let Event::Message(parcel) = event else { continue };
        if parcel.id == id && parcel.name() == "command" && parcel.sender.as_deref() == Some(&client.name()) {
            steps.extend(sent.clone().or_else(|| stamped("sent", &parcel)));
            steps.extend(exact("received by the hub", parcel.received));
            steps.extend(exact("delivered", delivered));
            continue;
        }
        let status = from_value::<Status>(parcel.value()).ok();
        let ours = |status: &Status| status.id == id && status.peer == client.name();
        let Some(status) = status.filter(|status| parcel.name() == "status" && ours(status)) else {
            continue;
        };
        let name = status.error.as_ref().and_then(|error| error.get("name"));
        if name.and_then(Value::as_str) == Some(ErrorName::ChangingHands.as_str()) {
            let text = "the robot still ends what its last owner began; trace again when it is at rest";
            return Err(Failure::plain(text));
        }
        let what = match (status.state, status.statement) {
            (CommandState::Waiting, _) => "taken by the robot",
            (CommandState::Executing, 1) => "begun",
            (CommandState::Executing | CommandState::Sending, _) => continue,
            (CommandState::Finished, _) => "done",
            (CommandState::Error, _) => "failed",
        };
        steps.extend(stamped(what, &parcel));
        if matches!(status.state, CommandState::Finished | CommandState::Error) {
            steps.extend(here("heard here", &client.clock()));
            steps.sort_by_key(|step| place(step.what));
            return Ok((steps, status.error));
        }
    }
}

/// What happens here and now; none while the hub's clock is not known.
fn here(what: &'static str, clock: &HubClock) -> Option<Step> {
    let (at, error) = clock.now()?;
    let error = Known::Within(u64::try_from(error.as_micros()).unwrap_or(u64::MAX));
    Some(Step { what, at, error })
}

/// Steps in the order in which they happen, whatever clocks say.
fn place(what: &str) -> usize {
    const ORDER: [&str; 6] = [
        "sent",
        "received by the hub",
        "delivered",
        "taken by the robot",
        "begun",
        "done",
    ];
    ORDER
        .iter()
        .position(|known| *known == what)
        .unwrap_or(match what {
            "failed" => ORDER.len() - 1,
            _ => ORDER.len(),
        })
}

/// When a message was made, by the hub's clock: it tells how old it was when it came.
fn stamped(what: &'static str, parcel: &Parcel) -> Option<Step> {
    let received = parcel.received?;
    let known = parcel.age.zip(parcel.age_error);
    let (age, error) = match known {
        Some((age, error)) => (age, Known::Within(error)),
        None => (0, Known::AtTheLatest),
    };
    let at = Time::from_micros(received.micros().saturating_sub(age))?;
    Some(Step { what, at, error })
}

fn exact(what: &'static str, at: Option<Time>) -> Option<Step> {
    Some(Step {
        what,
        at: at?,
        error: Known::Exactly,
    })
}

fn tell(steps: &[Step], output: Output) -> Result<(), Failure> {
    let first = steps.first().map_or(0, |step| step.at.micros());
    for step in steps {
        let after = step.at.micros().saturating_sub(first);
        let error = match step.error {
            Known::Exactly => String::new(),
            Known::Within(micros) => format!("±{} ms", millis(i64::try_from(micros).unwrap_or(i64::MAX))),
            Known::AtTheLatest => "or earlier: that clock is not known".to_owned(),
        };
        output.tell(
            || {
                let error = match step.error {
                    Known::Exactly => json!(0),
                    Known::Within(micros) => json!(micros),
                    Known::AtTheLatest => json!(null),
                };
                json!({"step": step.what, "time": step.at.to_string(), "after": after, "error": error})
            },
            || {
                format!("{:<20} {:>12} ms  {error}", step.what, millis(after))
                    .trim_end()
                    .to_owned()
            },
        )?;
    }
    Ok(())
}

fn millis(micros: i64) -> String {
    format!("{:.1}", micros as f64 / 1000.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(micros: i64) -> Time {
        Time::from_micros(micros).unwrap()
    }

    #[test]
    fn a_step_was_before_it_was_received_by_its_age() {
        let mut parcel = Parcel::new(Family::Message, "status");
        assert_eq!(stamped("begun", &parcel), None, "not through a hub");
        parcel.received = Some(at(5000));
        let step = stamped("begun", &parcel).unwrap();
        assert_eq!((step.at, step.error), (at(5000), Known::AtTheLatest));
        (parcel.age, parcel.age_error) = (Some(1200), Some(80));
        let step = stamped("begun", &parcel).unwrap();
        assert_eq!((step.at, step.error), (at(3800), Known::Within(80)));
        // A clock that is ahead by less than its error.
        parcel.age = Some(-30);
        assert_eq!(stamped("begun", &parcel).unwrap().at, at(5030));
    }

    #[test]
    fn steps_stand_in_the_order_of_the_way() {
        let mut words = [
            "heard here",
            "done",
            "sent",
            "begun",
            "delivered",
            "taken by the robot",
        ];
        words.sort_by_key(|word| place(word));
        assert_eq!(
            words,
            [
                "sent",
                "delivered",
                "taken by the robot",
                "begun",
                "done",
                "heard here"
            ]
        );
    }
}
