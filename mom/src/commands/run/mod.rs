//! `mom run`: runs a script on the robot under its token.

mod progress;
mod script;

use std::time::Duration;

use mom_arm::{ArmState, CommandState, Pose, Script, Status, pose, rapid};
use mom_client::{
    BASED_ON, Card, Channel, Client, ClientError, Event, Events, Family, Lost, Parcel, Path, Token,
    TokenGuard, Value, from_value,
};
use mom_device::ErrorName;
use serde_json::json;
use tokio::time::{Instant, sleep, timeout_at};

pub(crate) use self::progress::error_words;
use self::progress::{ProgressDisplay, StatusChange};
pub(super) use self::script::ScriptLine;
use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::input;
use crate::output::event::lost_words;
use crate::output::style::{Tone, ink};
use crate::output::{Output, words};
use mom_pages::Interrupt;

/// How long a robot may take for its first status of a command.
const ANSWER: Duration = Duration::from_secs(10);

/// How long it may take to end what its last owner has begun.
const STANDING: Duration = Duration::from_secs(60);
/// Between two tries of a command whose age is not known yet.
const MEASURED: Duration = Duration::from_millis(100);

pub(crate) async fn run(args: &cli::RunArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let errand = Errand {
        device: "robot",
        channel: &args.channel,
        token: &args.token,
        zones: &args.zones,
        keep_going: args.keep_going,
        checked: (!args.no_check).then(|| name(args)),
        shown: args.show.map(|_| pose::HOME),
    };
    errand.run(&read(args)?, global, output).await
}

/// How a device is driven.
pub(super) struct Errand<'a> {
    /// What it is, in words.
    pub(super) device: &'static str,
    /// Its channel.
    pub(super) channel: &'a str,
    /// The token that guards that.
    pub(super) token: &'a str,
    /// The zones that are grabbed with it.
    pub(super) zones: &'a [String],
    /// Whether the next command is sent after one that failed.
    pub(super) keep_going: bool,
    /// Where the commands stand, if they are checked by the device's card before the first of them is sent.
    pub(super) checked: Option<String>,
    /// Where the arm is taken to be first, if it is to be shown what a controller would be told.
    pub(super) shown: Option<Pose>,
}

impl Errand<'_> {
    /// Grabs the token, runs the commands one after the other, and releases it.
    pub(super) async fn run(
        self,
        commands: &[ScriptLine],
        global: &GlobalArgs,
        output: Output,
    ) -> Result<(), Failure> {
        let device = self.device;
        let client = connect(global, Stay::Driving).await?;
        let mut interrupt = Interrupt::install()?;
        let card = card_of(&client, self.channel).await?;
        if let (Some(name), Some(card)) = (&self.checked, &card) {
            script::check(name, commands, card)?;
        }
        let (channel, token, mut guard) = drive(&client, self.channel, self.token).await?;
        let events = channel.events();
        let zones = grab_zones(&client, self.zones).await?;
        output.remark(ink(
            format_args!("holding {} (fence {})", self.token, guard.fence()),
            Tone::Faint,
        ));
        let mut job = Job {
            client: client.clone(),
            channel: channel.path().clone(),
            events,
            progress: ProgressDisplay::new(output, commands.len()),
            robot: None,
            device,
            keep_going: self.keep_going,
            fence: guard.fence(),
            newest: None,
            moves: false,
            card,
            shown: self.shown,
            output,
        };
        let result = tokio::select! {
            biased;
            lost = guard.lost() => Err(lost_failure(self.token, device, &lost)),
            () = interrupt.wait() => Err(Failure::plain(format!("interrupted; the token is released, and the hub halts the {device}"))),
            result = job.carry_out(commands) => match is_done(&result) || !is_lost(&token, &guard).await {
                true => result,
                false => Err(lost_failure(self.token, device, &guard.lost().await)),
            },
        };
        job.progress.end();
        let released = match guard.is_lost() {
            true => Ok(()),
            false => guard.release().await.doing(format!("release {}", self.token)),
        };
        // After the robot's, so that nobody enters one while the robot is still driven there.
        for (zone, path) in zones.into_iter().zip(self.zones) {
            zone.release().await.doing(format!("release {path}"))?;
        }
        client.close().await;
        let outcome = result?;
        released?;
        outcome.tell(commands.len(), &self, output)
    }
}

/// What the device of a channel says that it can do; none where it says nothing, or there is no such channel.
async fn card_of(client: &Client, channel: &str) -> Result<Option<Card>, Failure> {
    match client.card(channel).await {
        Ok(card) => Ok(card.map(|(_, card)| card)),
        // To join the channel says more; and a card of a later form is none to this program.
        Err(ClientError::Refused(_) | ClientError::Local(_)) => Ok(None),
        Err(error) => Err(error).doing(format!("read the card of the device in {channel}")),
    }
}

/// Joins a robot's channel and grabs its token.
pub(crate) async fn drive(
    client: &Client,
    channel: &str,
    token: &str,
) -> Result<(Channel, Token, TokenGuard), Failure> {
    let joined = join_device(client, channel).await?;
    let held = client.token(token).await.doing(format!("join {token}"))?;
    let guard = held.grab().await.doing(format!("grab {token}"))?;
    Ok((joined, held, guard))
}

/// Joins a device's channel; where there is none, a fleet is pointed at.
pub(crate) async fn join_device(client: &Client, channel: &str) -> Result<Channel, Failure> {
    match client.channel(channel).await.doing(format!("join {channel}")) {
        Err(failure) => Err(failure.at_a_fleet(client).await),
        joined => joined,
    }
}

/// Grabs zones, after the robot's token: a robot lets its driver have the one in which it stands.
async fn grab_zones(client: &Client, paths: &[String]) -> Result<Vec<TokenGuard>, Failure> {
    let mut held = Vec::new();
    for path in paths {
        let zone = client.token(path).await.doing(format!("join {path}"))?;
        held.push(zone.grab().await.doing(format!("grab {path}"))?);
    }
    Ok(held)
}

fn read(args: &cli::RunArgs) -> Result<Vec<ScriptLine>, Failure> {
    let file = args.script.to_string_lossy();
    let text = input::text(&file).map_err(|error| {
        Failure::usage(
            format!("cannot read {file}: {error}"),
            "name a file of commands, or - for standard input",
        )
    })?;
    let name = name(args);
    let commands = script::commands(&text);
    if commands.is_empty() {
        return Err(Failure::usage(
            format!("there is no command in {name}"),
            "write one command per line, such as: move 100 50 200 0 0; grip close",
        ));
    }
    Ok(commands)
}

/// Where the commands of `mom run` stand.
fn name(args: &cli::RunArgs) -> String {
    let file = args.script.to_string_lossy();
    if file == "-" {
        "standard input".to_owned()
    } else {
        file.into_owned()
    }
}

/// The outcome of the commands.
#[derive(Clone, Copy, Debug, Default)]
struct RunOutcome {
    done: usize,
    failed: usize,
    /// Whether the robot refuses commands because it was stopped.
    stopped: bool,
}

impl RunOutcome {
    fn tell(self, total: usize, errand: &Errand<'_>, output: Output) -> Result<(), Failure> {
        let RunOutcome {
            done,
            failed,
            stopped,
        } = self;
        let commands = words::count(total as u64, "command");
        if output.is_json() || failed == 0 {
            output.tell(
                || json!({"done": done, "failed": failed, "of": total}),
                || ink(format_args!("{commands} done, token released"), Tone::Good),
            )?;
        }
        if stopped {
            return Err(Failure::new(
                format!("{failed} of {commands} failed; token released"),
                format!(
                    "the {} is stopped; let it go with: mom unstop {}",
                    errand.device, errand.channel
                ),
            ));
        }
        match (failed, total - done - failed) {
            (0, _) => Ok(()),
            (_, 0) => Err(Failure::plain(format!(
                "{failed} of {commands} failed; token released"
            ))),
            (_, rest) => Err(Failure::new(
                format!("{failed} of {commands} failed, {rest} not sent; token released"),
                "with --keep-going the rest is sent all the same",
            )),
        }
    }
}

/// Runs the commands one after the other, because a later one may rely on an earlier one.
struct Job {
    client: Client,
    channel: Path,
    events: Events,
    progress: ProgressDisplay,
    /// What is driven, in words.
    device: &'static str,
    /// The robot's peer, once it has answered.
    robot: Option<String>,
    keep_going: bool,
    /// What it says that it can do.
    card: Option<Card>,
    /// That of the token.
    fence: u64,
    /// The id of the newest state.
    newest: Option<u64>,
    /// Whether it said then that it moves.
    moves: bool,
    /// Where the hand is, if it is to be shown what a controller would be told.
    shown: Option<Pose>,
    output: Output,
}

impl Job {
    /// All of them, up to the first that fails, unless it is to go on.
    async fn carry_out(&mut self, commands: &[ScriptLine]) -> Result<RunOutcome, Failure> {
        let mut outcome = RunOutcome::default();
        for (index, command) in commands.iter().enumerate() {
            let number = index + 1;
            self.show(command);
            self.progress.begin(number, command);
            let end = self.one(number, command).await?;
            match end.error {
                None => outcome.done += 1,
                Some(error) => {
                    outcome.failed += 1;
                    outcome.stopped = error.get("name").and_then(Value::as_str) == Some("stopped");
                }
            }
            if outcome.failed > 0 && !self.keep_going {
                break;
            }
        }
        Ok(outcome)
    }

    /// Shows what a controller of the real arm would be told, from where the arm was seen last.
    fn show(&mut self, command: &ScriptLine) {
        if self.shown.is_none() {
            return;
        }
        while let Some(event) = self.events.try_next() {
            self.see(&event);
        }
        let Some(from) = self.shown else { return };
        let Ok(script) = command.text.parse::<Script>() else {
            return;
        };
        match rapid::text(&script, &from) {
            Ok(text) => self.output.remark(text.trim_end()),
            Err(error) => self
                .output
                .remark(format_args!("! {}: {error}", words::visible(&command.text))),
        }
    }

    /// Notes where the arm is.
    fn see(&mut self, event: &Event) {
        let Event::Message(parcel) = event else { return };
        if parcel.name() != "state" {
            return;
        }
        self.newest = parcel.id.or(self.newest);
        self.moves = parcel.value().get("moving").and_then(Value::as_bool) == Some(true);
        if !parcel.is_history() {
            self.robot = parcel.sender.as_deref().map(str::to_owned).or(self.robot.take());
        }
        if let Some(shown) = &mut self.shown
            && let Ok(state) = from_value::<ArmState>(parcel.value())
        {
            *shown = state.pose;
        }
    }

    /// The id of the newest state, which the robot tells to new members; once it stands, since no other is of where it will be.
    async fn newest_state(&mut self) -> Result<u64, Failure> {
        let begin = Instant::now();
        loop {
            let patience = match self.newest {
                Some(newest) if !self.moves => return Ok(newest),
                Some(_) => STANDING,
                None => ANSWER,
            };
            let event = match (
                timeout_at(begin + patience, self.events.next()).await,
                self.newest,
            ) {
                (Ok(event), _) => event.ok_or_else(closed)?,
                // It says itself that it moves.
                (Err(_), Some(newest)) => return Ok(newest),
                (Err(_), None) => return Err(self.nobody()),
            };
            self.see(&event);
            self.read(&event, 0)?;
        }
    }

    /// One command, to its end; once more when the robot stands, if it came while that was changing hands or out of its controller's reach.
    async fn one(&mut self, number: usize, command: &ScriptLine) -> Result<StatusChange, Failure> {
        let began = Instant::now();
        loop {
            let end = self.attempt(number, command).await?;
            let Some(obstacle) = passing_obstacle(&end) else {
                return Ok(end);
            };
            match obstacle {
                // Our clock is being measured, of which no state tells.
                ErrorName::TooOld if began.elapsed() > STANDING => return Ok(end),
                ErrorName::TooOld => sleep(MEASURED).await,
                _ => self.stands(obstacle).await?,
            }
        }
    }

    /// Waits until the robot says that it stands under our fence.
    async fn stands(&mut self, obstacle: ErrorName) -> Result<(), Failure> {
        let deadline = Instant::now() + STANDING;
        let device = self.device;
        let still = match obstacle {
            ErrorName::Link => format!("the link from the {device} to its controller is still down"),
            _ => format!("the {device} still does what its last owner told it"),
        };
        loop {
            let event = timeout_at(deadline, self.events.next()).await.map_err(|_| {
                Failure::new(
                    format!("{still}, after {} s", STANDING.as_secs()),
                    format!(
                        "look at it: mom watch {}; halt it: mom stop {}",
                        self.channel, self.channel
                    ),
                )
            })?;
            let event = event.ok_or_else(closed)?;
            if let Event::Message(parcel) = &event
                && parcel.name() == "state"
                && let Ok(state) = from_value::<ArmState>(parcel.value())
                && state.fence.is_some_and(|fence| fence >= self.fence)
                && state.linked
                && !state.moving
            {
                self.see(&event);
                return Ok(());
            }
            self.see(&event);
            self.read(&event, 0)?;
        }
    }

    async fn attempt(&mut self, number: usize, command: &ScriptLine) -> Result<StatusChange, Failure> {
        self.progress
            .change(number, command, &StatusChange::to(CommandState::Sending))?;
        let id = self.send(command).await?;
        let mut deadline = Some(Instant::now() + ANSWER);
        loop {
            let next = self.events.next();
            let event = match deadline {
                Some(deadline) => timeout_at(deadline, next).await.map_err(|_| self.nobody())?,
                None => next.await,
            };
            let event = event.ok_or_else(closed)?;
            self.see(&event);
            let Some((change, robot)) = self.read(&event, id)? else {
                continue;
            };
            deadline = None;
            self.robot = robot.or(self.robot.take());
            if passing_obstacle(&change).is_none() {
                self.progress.change(number, command, &change)?;
            }
            match change.state {
                CommandState::Finished | CommandState::Error => return Ok(change),
                _ => {}
            }
        }
    }

    /// Sends a command and gives its id.
    async fn send(&mut self, command: &ScriptLine) -> Result<u64, Failure> {
        let read = |card| mom_device::check_by_card(card, &command.text);
        let based_on = match self.card.as_ref().map(read) {
            Some(Ok(script)) if script.relative => i64::try_from(self.newest_state().await?).ok(),
            _ => None,
        };
        let mut parcel = Parcel::new(Family::Message, "command")
            .context(self.channel.clone())
            .content(command.text.as_str());
        parcel.echo = Some(false);
        if let Some(state) = based_on {
            parcel.extra.set(BASED_ON, state);
        }
        // The receipt refers to the id that the client has given.
        parcel.receipt = Some(true);
        let what = format!("send line {} to {}", command.line, self.channel);
        let receipt = self.client.request(parcel).await.doing(what)?;
        match receipt.value().get("delivered").and_then(Value::as_int) {
            Some(0) => Err(self.nobody()),
            _ => receipt
                .reference
                .ok_or_else(|| Failure::plain("the hub's receipt does not say for what")),
        }
    }

    /// The status in an event about the command `id`, and its sender.
    fn read(&self, event: &Event, id: u64) -> Result<Option<(StatusChange, Option<String>)>, Failure> {
        match event {
            Event::Message(parcel) if parcel.name() == "status" && !parcel.is_history() => {
                let Ok(status) = from_value::<Status>(parcel.value()) else {
                    return Ok(None);
                };
                if status.id != Some(id) || status.peer != self.client.name() {
                    return Ok(None);
                }
                let change = StatusChange {
                    state: status.state,
                    statement: status.statement,
                    of: status.of,
                    error: match status.state {
                        CommandState::Error => Some(status.error.unwrap_or_default()),
                        _ => None,
                    },
                };
                Ok(Some((change, parcel.sender.as_deref().map(str::to_owned))))
            }
            event
                if let Some(gone) = self
                    .robot
                    .as_deref()
                    .and_then(|robot| mom_drive::gone(event, robot)) =>
            {
                Err(Failure::new(
                    format!("{gone} {}", self.channel),
                    "see who is there: mom tree",
                ))
            }
            Event::LinkDown => Err(Failure::new(
                "the connection to the hub is lost, and the token with it",
                format!(
                    "the hub halts the {}; see what it did: mom watch, mom snap",
                    self.device
                ),
            )),
            Event::Lagged(count) => Err(Failure::plain(format!(
                "{} lost here; what became of the command is not known",
                words::count(*count, "event")
            ))),
            _ => Ok(None),
        }
    }

    fn nobody(&self) -> Failure {
        Failure::new(
            format!("no {} answers in {}", self.device, self.channel),
            format!(
                "see who is there: mom tree {}",
                self.channel.parent().unwrap_or_else(Path::root)
            ),
        )
    }
}

fn closed() -> Failure {
    Failure::plain("the connection to the hub is closed")
}

/// Why the robot did not take a command that it will take a little later: when it stands, can be reached, or knows how old the command is.
fn passing_obstacle(change: &StatusChange) -> Option<ErrorName> {
    let error = change.error.as_ref()?;
    let name = error.get("name").and_then(Value::as_str)?;
    let retry = error.get("retry").and_then(Value::as_bool) == Some(true);
    let obstacles = [ErrorName::ChangingHands, ErrorName::Link, ErrorName::TooOld].into_iter();
    obstacles
        .filter(|_| retry)
        .find(|obstacle| obstacle.as_str() == name)
}

fn is_done(result: &Result<RunOutcome, Failure>) -> bool {
    matches!(result, Ok(outcome) if outcome.failed == 0)
}

/// Whether the token is lost by now. A robot that is halted because of that may say so before the hub does.
async fn is_lost(token: &Token, guard: &TokenGuard) -> bool {
    // The hub answers after all that it had to say. Without an answer the link is down, which the failure says.
    let _ = token.info().await;
    guard.is_lost()
}

fn lost_failure(token: &str, device: &str, lost: &Lost) -> Failure {
    Failure::plain(format!(
        "lost {token}: {}; the hub halts the {device}",
        lost_words(lost)
    ))
}
