//! `mom run`: runs a script on the robot under its token.

mod progress;
mod script;

use mom_arm::{ArmState, Pose, Script, pose, rapid};
use mom_client::{Card, Channel, Client, ClientError, Lost, Token, TokenGuard, from_value};
use mom_drive::{Basis, Command, CommandEnd, Commander, DeviceChannel, How, Next, VerbFailure, lost_words};
use serde_json::json;

use self::progress::ProgressDisplay;
pub(super) use self::script::ScriptLine;
use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::input;
use crate::output::style::{Tone, ink};
use crate::output::{Output, words};
use mom_pages::Interrupt;

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
        let client = connect(global, Stay::Driving).await?;
        let mut interrupt = Interrupt::install()?;
        let card = card_of(&client, self.channel).await?;
        if let (Some(name), Some(card)) = (&self.checked, &card) {
            script::check(name, commands, card)?;
        }
        let (channel, _token, mut guard) = drive(&client, self.channel, self.token).await?;
        let device = DeviceChannel::of(&client, channel);
        let mut commander = Commander::new(device, guard.fence());
        let zones = grab_zones(&client, self.zones).await?;
        output.remark(ink(
            format_args!("holding {} (fence {})", self.token, guard.fence()),
            Tone::Faint,
        ));
        let mut job = Job {
            progress: ProgressDisplay::new(output, commands.len()),
            keep_going: self.keep_going,
            card,
            shown: self.shown,
            output,
        };
        let ended = tokio::select! {
            biased;
            lost = guard.lost() => Ended::Lost(lost),
            () = interrupt.wait() => Ended::Interrupted,
            result = job.carry_out(&mut commander, commands) => Ended::ByItself(result),
        };
        job.progress.end();
        let result = end(ended, &mut commander, guard).await;
        // After the robot's, so that nobody enters one while the robot is still driven there.
        for (zone, path) in zones.into_iter().zip(self.zones) {
            zone.release().await.doing(format!("release {path}"))?;
        }
        client.close().await;
        result?.tell(commands.len(), &self, output)
    }
}

/// How the commands ended.
enum Ended {
    ByItself(Result<RunOutcome, Failure>),
    Interrupted,
    Lost(Lost),
}

/// Gives the token back, and hears that what runs has ended.
async fn end(ended: Ended, commander: &mut Commander, guard: TokenGuard) -> Result<RunOutcome, Failure> {
    let token = guard.path().clone();
    let result = match ended {
        Ended::Lost(lost) => {
            let end = commander.lost(&lost).await;
            let lost = || Failure::plain(lost_words(token.as_str(), &lost));
            return Err(end.map_or_else(lost, Failure::from));
        }
        Ended::ByItself(result) => result,
        Ended::Interrupted => Err(Failure::plain("interrupted; the token is given back")),
    };
    let release = async {
        guard.release().await.map_err(|error| VerbFailure::Hub {
            what: format!("release {token}"),
            error,
        })
    };
    match (result, commander.end(release).await) {
        (result, Ok(())) => result,
        (Ok(_), Err(failure)) => Err(failure.into()),
        (Err(first), Err(failure)) => Err(Failure::Failed {
            text: format!("{first}; {failure}"),
            hint: failure.hint().map(str::to_owned),
        }),
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

/// What keeps a robot from moving.
#[derive(Clone, Copy, Debug)]
enum Held {
    Stopped,
    Estop,
}

/// The outcome of the commands.
#[derive(Clone, Copy, Debug, Default)]
struct RunOutcome {
    done: usize,
    failed: usize,
    /// Why the robot refuses commands, if it was stopped: `stopped`, or `estop`.
    held: Option<Held>,
}

impl RunOutcome {
    fn tell(self, total: usize, errand: &Errand<'_>, output: Output) -> Result<(), Failure> {
        let RunOutcome { done, failed, held } = self;
        let commands = words::count(total as u64, "command");
        if output.is_json() || failed == 0 {
            output.tell(
                || json!({"done": done, "failed": failed, "of": total}),
                || ink(format_args!("{commands} done, token released"), Tone::Good),
            )?;
        }
        if let Some(held) = held {
            let why = match held {
                Held::Stopped => "is stopped; let it go with",
                Held::Estop => "has its emergency stop pressed; reset it there, then let it go with",
            };
            return Err(Failure::new(
                format!("{failed} of {commands} failed; token released"),
                format!("the {} {why}: mom unstop {}", errand.device, errand.channel),
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
    progress: ProgressDisplay,
    keep_going: bool,
    /// What the device says that it can do.
    card: Option<Card>,
    /// Where the hand is, if it is to be shown what a controller would be told.
    shown: Option<Pose>,
    output: Output,
}

impl Job {
    /// All of them, up to the first that fails, unless it is to go on.
    async fn carry_out(
        &mut self,
        commander: &mut Commander,
        commands: &[ScriptLine],
    ) -> Result<RunOutcome, Failure> {
        let mut outcome = RunOutcome::default();
        for (index, command) in commands.iter().enumerate() {
            let number = index + 1;
            self.show(commander, command);
            self.progress.begin(number, command)?;
            let end = self.one(commander, number, command).await?;
            match end.is_finished() {
                true => outcome.done += 1,
                false => {
                    outcome.failed += 1;
                    outcome.held = match end.name() {
                        "stopped" => Some(Held::Stopped),
                        "estop" => Some(Held::Estop),
                        _ => None,
                    };
                }
            }
            if outcome.failed > 0 && !self.keep_going {
                break;
            }
        }
        Ok(outcome)
    }

    /// One command, to its end by the device.
    async fn one(
        &mut self,
        commander: &mut Commander,
        number: usize,
        command: &ScriptLine,
    ) -> Result<CommandEnd, Failure> {
        let read = |card| mom_device::check_by_card(card, &command.text);
        let basis = match self.card.as_ref().map(read) {
            Some(Ok(script)) if script.relative => Basis::Newest,
            _ => Basis::Nothing,
        };
        commander.begin(Command::from(&*command.text).based_on(basis));
        loop {
            let end = match commander.next().await {
                Next::Progress(progress) => {
                    self.progress.change(number, command, &progress)?;
                    continue;
                }
                Next::End(end) => end,
            };
            return match end.how {
                How::Finished(_) | How::Failed(_) => {
                    self.progress.finish(number, command, &end)?;
                    Ok(end)
                }
                How::Refused(error) => Err(Failure::Refused {
                    what: format!("send line {} to {}", command.line, commander.channel().path()),
                    error,
                }),
                _ => Err(end.into()),
            };
        }
    }

    /// Shows what a controller of the real arm would be told, from where the arm was seen last.
    fn show(&mut self, commander: &mut Commander, command: &ScriptLine) {
        let Some(from) = &mut self.shown else { return };
        if let Some(state) = commander.newest_state()
            && let Ok(state) = from_value::<ArmState>(state)
        {
            *from = state.pose;
        }
        let Ok(script) = command.text.parse::<Script>() else {
            return;
        };
        match rapid::text(&script, from) {
            Ok(text) => self.output.remark(text.trim_end()),
            Err(error) => self
                .output
                .remark(format_args!("! {}: {error}", words::visible(&command.text))),
        }
    }
}
