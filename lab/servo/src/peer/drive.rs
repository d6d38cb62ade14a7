//! The controller with the hub at both ends: images and reports in, commands out.

use std::collections::BTreeMap;
use std::time::Duration;

use mom_agent::Hired;
use mom_client::{Channel, Client, Event, Events, Family, Parcel, Value, from_value};
use mom_drive::{
    DeviceChannel, Holding, Report as CommandReport, RobotState, VerbFailure, both, closed, halt,
};
use mom_program::work::wall;
use tokio::runtime::{Handle, RuntimeFlavor};
use tokio::task::{block_in_place, yield_now};
use tokio::time::{Instant, sleep};

use super::report::Report;
use super::watch::Eyes;
use crate::Micros;
use crate::control::{Action, Phase, STOOD_STILL, Servo};
use crate::eyes::Seen;
use crate::task::{NAMES, Task};

/// How often the controller is asked, at least.
const TICK: Duration = Duration::from_millis(40);
/// How often progress is told, at least.
const TOLD: Duration = Duration::from_millis(500);
/// Commands that may still be reported.
const MOST_NUMBERS: usize = 64;
/// A command that is still on its way after this is worth nothing, ms: the hand is led by newer pictures.
const EXPIRES: u64 = 1500;
/// ms for which a program that stood still is believed to have.
const LATEST: i64 = 10_000;
/// A robot that moves tells its state more often than this, µs.
const RESTS: Micros = 600_000;
/// The time of one state as two peers tell it, µs.
const SAME: Micros = 100_000;

/// Where the controller's inputs come from and its commands go.
pub(super) struct Links {
    pub(super) hired: Hired<Task>,
    pub(super) arm: Channel,
    pub(super) events: Events,
    pub(super) seen: Eyes,
}

/// The work under the token.
pub(super) struct Drive {
    links: Links,
    servo: Servo,
    fence: u64,
    /// The id of the last command.
    id: u64,
    /// That of the newest one which the robot has said to be over, and with it all before.
    over: u64,
    /// The controller's numbers of the newest ones.
    numbers: BTreeMap<u64, u32>,
    /// That of the command to the jaws which is under way.
    grip: Option<u64>,
    holding: bool,
    /// Whether the robot moves, by its newest state.
    moves: bool,
    /// When the robot told its newest state, and the number of that.
    stated: Micros,
    seq: i64,
    told: Option<(Instant, Phase)>,
}

/// The time by the hub's clock, as all images tell theirs; by the own one as long as that is not known.
pub(super) fn hub_now(client: &Client) -> Micros {
    wall(client).micros()
}

/// Does what takes its time, some tenths of a second on a busy machine, beside the runtime's other work: the signs of life of the link
/// to the hub must not wait for it.
pub(super) fn long<T>(work: impl FnOnce() -> T) -> T {
    match Handle::current().runtime_flavor() {
        RuntimeFlavor::MultiThread => block_in_place(work),
        _ => work(),
    }
}

impl Drive {
    /// `seq`: the number of the state in which the robot was when this began.
    pub(super) fn new(links: Links, servo: Servo, fence: u64, seq: i64) -> Drive {
        Drive {
            links,
            servo,
            fence,
            id: 0,
            over: 0,
            numbers: BTreeMap::new(),
            grip: None,
            holding: false,
            moves: false,
            stated: 0,
            seq,
            told: None,
        }
    }

    /// Works until the blocks are aligned, and says how well.
    pub(super) async fn run(&mut self) -> Result<String, VerbFailure> {
        loop {
            // Images and commands may be ready again and again: who cancels the task, or takes the token, is heard all the same.
            yield_now().await;
            if let Some(seen) = self.links.seen.ready() {
                self.see(seen);
            }
            // Whatever has come already counts before anything is sent, or the arm is blamed for what was not read: also what came while
            // that image took its time.
            while let Some(event) = self.links.events.try_next() {
                self.note(&event)?;
            }
            if let Some((_, error)) = self.links.hired.client.clock().now() {
                let error = Micros::try_from(error.as_micros()).unwrap_or(Micros::MAX / 4);
                self.servo.round_trip(2 * error);
            }
            let now = hub_now(&self.links.hired.client);
            match long(|| self.servo.next(now)) {
                Action::Command(command) => {
                    self.send(&command).await?;
                    continue;
                }
                Action::Wait => {}
                Action::Aligned => return Ok(self.aligned()),
                Action::Failed(why) => return Err(VerbFailure::plain(why)),
            }
            self.tell().await;
            tokio::select! {
                event = self.links.events.next() => self.note(&event.ok_or_else(closed)?)?,
                seen = self.links.seen.next() => {
                    let seen = seen.ok_or_else(|| VerbFailure::plain("there is no longer a camera"))?;
                    self.see(seen);
                }
                () = sleep(TICK) => {}
            }
        }
    }

    fn see(&mut self, seen: Seen) {
        let shows = shown(seen.taken, seen.shows, self.stated);
        long(|| self.servo.see(&Seen { shows, ..seen }));
    }

    fn aligned(&self) -> String {
        let task = &self.links.hired.task;
        let off = self.servo.progress().miss.map_or(0.0, |miss| miss.level());
        format!(
            "{} stands at the {} of {}, {off:.1} mm off by the images",
            NAMES[task.first].0, task.side, NAMES[task.second].0
        )
    }

    async fn send(&mut self, command: &str) -> Result<(), VerbFailure> {
        // Its own ids, which the arm's reports refer to.
        let now = u64::try_from(hub_now(&self.links.hired.client)).unwrap_or(0);
        self.id = now.max(self.id + 1);
        self.numbers.insert(self.id, self.servo.progress().commands);
        while self.numbers.len() > MOST_NUMBERS {
            self.numbers.pop_first();
        }
        if command.starts_with("grip") {
            self.grip = Some(self.id);
        }
        let mut parcel = Parcel::new(Family::Message, "command")
            .context(self.links.arm.path().clone())
            .content(command);
        parcel.id = Some(self.id);
        parcel.fence = Some(self.fence);
        parcel.expires = Some(EXPIRES);
        parcel.echo = Some(false);
        let sent = self.links.hired.client.send(parcel).await;
        sent.map_err(|error| VerbFailure::Hub {
            what: format!("send {command:?}"),
            error,
        })
    }

    /// Takes what the robot or the hub says.
    fn note(&mut self, event: &Event) -> Result<(), VerbFailure> {
        match event {
            Event::Message(parcel) if parcel.name() == "state" => {
                if let Ok(state) = from_value::<RobotState>(parcel.value()) {
                    self.holding = state.holding.is_some();
                    self.moves = state.moving;
                    // A state that is told again, as to who comes or for a new owner, is not newer: cameras show it already.
                    if state.seq != self.seq {
                        self.seq = state.seq;
                        self.stated = hub_now(&self.links.hired.client) - self.age(parcel);
                    }
                }
            }
            Event::Message(parcel) if parcel.name() == "status" => {
                if let Some(status) = CommandReport::read(parcel) {
                    self.note_status(&status, self.age(parcel));
                }
            }
            Event::Refused(error, id) => {
                self.over = self.over.max(id.unwrap_or(0));
                let now = hub_now(&self.links.hired.client);
                self.servo.refused(
                    "refused",
                    &format!("control: the hub refused a command: {}", error.text),
                    now,
                    now,
                );
            }
            Event::LinkDown => {
                return Err(VerbFailure::plain(
                    "the connection to the hub is lost, and the token with it",
                ));
            }
            Event::Lagged(_) => {
                return Err(VerbFailure::plain(
                    "events of the robot were lost; what it did is not known",
                ));
            }
            _ => {}
        }
        Ok(())
    }

    fn age(&self, parcel: &Parcel) -> Micros {
        let age = self.links.hired.client.clock().age(parcel);
        age.map_or(0, |age| age.micros.max(0))
    }

    fn note_status(&mut self, status: &CommandReport, age: Micros) {
        if status.peer != self.links.hired.client.name() {
            return;
        }
        let now = hub_now(&self.links.hired.client);
        if status.is_end() {
            self.over = self.over.max(status.id.unwrap_or(0));
        }
        match status.state.as_str() {
            "executing" => {
                if let Some(id) = status.id {
                    // Those before it have ended, whatever became of them.
                    self.over = self.over.max(id.saturating_sub(1));
                }
                if let Some(number) = status.id.and_then(|id| self.numbers.get(&id)) {
                    self.servo.begun(*number, now - age);
                }
            }
            "finished" if status.id.is_some() && status.id == self.grip => {
                self.grip = None;
                self.servo.jaws_ended(self.holding, now);
            }
            "error" => {
                let error = status.error.clone().unwrap_or_default();
                let name = error.get("name").and_then(Value::as_str).unwrap_or_default();
                // The robot has not come to rest after its last owner: soon it has.
                let name = if name == "changing-hands" { "busy" } else { name };
                // A velocity that ended because the arm's program stood still, not because the arm was halted.
                let retry = error.get("retry").and_then(Value::as_bool) == Some(true);
                let name = if name == "halted" && retry {
                    STOOD_STILL
                } else {
                    name
                };
                let late = error.get("late").and_then(Value::as_int).unwrap_or(0);
                let at = now - age - late.clamp(0, LATEST) * 1000;
                self.servo.refused(name, &status.wire_error().text, at, now);
            }
            _ => {}
        }
    }

    /// Tells progress, if there is any or some time is over.
    async fn tell(&mut self) {
        let progress = self.servo.progress();
        if progress.image_age.is_none() {
            // There is nothing to tell before the first image.
            return;
        }
        let due = self
            .told
            .is_none_or(|(at, phase)| phase != progress.phase || at.elapsed() > TOLD);
        if due {
            self.told = Some((Instant::now(), progress.phase));
            self.links.hired.tell(self.report("working").to_map()).await;
        }
    }

    fn report(&self, state: &str) -> Report {
        let error = self.links.hired.client.clock().now().map(|(_, error)| error);
        let error = error.and_then(|error| i64::try_from(error.as_millis()).ok());
        Report::of(
            &self.links.hired.peer,
            state,
            &self.links.hired.task,
            &self.servo.progress(),
            error,
        )
    }

    /// Gives the token back, so that the hub halts the robot, and hears that it stands: what was sent is over, and it does not move.
    pub(super) async fn end(mut self, holding: Holding) -> Result<(), VerbFailure> {
        let device = DeviceChannel::join(&self.links.hired.client, self.links.arm.path().as_str()).await?;
        let stands = async {
            // What comes next is newer than what was sent.
            while self.moves || self.over < self.id {
                match self.links.events.next().await {
                    Some(event) => drop(self.note(&event)),
                    None => std::future::pending().await,
                }
            }
        };
        let (released, halted) = halt(&device, holding.release(), stands).await;
        both(released, halted.verdict(device.path().as_str()))
    }

    /// The last report: why it ended, and where the first block is.
    pub(super) fn last(&mut self, state: &str, why: &str) -> Report {
        self.servo.pass(hub_now(&self.links.hired.client));
        let report = self.report(state);
        let place = report.text.clone().unwrap_or_default();
        let text = match state {
            "done" => why.to_owned(),
            _ => format!("{why}; {place}"),
        };
        Report {
            reason: reason(why),
            text: Some(text),
            ..report
        }
    }
}

/// The word for an end that is nobody's wish: `sight: pictures are 3.5 s old, …`.
fn reason(why: &str) -> Option<String> {
    let (word, _) = why.split_once(": ")?;
    ["sight", "control", "estimate"]
        .contains(&word)
        .then(|| word.to_owned())
}

/// When the hand was as an image shows it that was taken then, from the state of that time; `stated` is the time of the
/// robot's newest state. A robot that rests tells nothing new; where it has told more since, the image is as old as the
/// state that it shows.
fn shown(taken: Micros, shows: Micros, stated: Micros) -> Micros {
    match taken - shows > RESTS && stated <= shows + SAME {
        true => taken,
        false => shows,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_from_an_older_state_than_the_newest_is_as_old_as_that() {
        const S: Micros = 1_000_000;
        for (taken, shows, stated, expected, why) in [
            (10 * S, 10 * S - 50_000, 10 * S, 10 * S - 50_000, "it moves"),
            (10 * S, 7 * S, 7 * S, 10 * S, "it has rested since"),
            (10 * S, 7 * S, 7 * S + 20_000, 10 * S, "two clocks tell one time"),
            (10 * S, 7 * S, 9 * S, 7 * S, "the camera has not heard of it"),
        ] {
            assert_eq!(shown(taken, shows, stated), expected, "{why}");
        }
    }

    #[test]
    fn an_end_for_safety_has_a_word() {
        for (why, word) in [
            ("sight: pictures are 3.5 s old, 2.0 s is the limit", Some("sight")),
            ("control: the arm has not begun", Some("control")),
            ("alice cancelled it", None),
            ("send \"home\": timed out", None),
        ] {
            assert_eq!(reason(why).as_deref(), word);
        }
    }
}
