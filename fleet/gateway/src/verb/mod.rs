//! `mom fleet`: looks at the robots of a gateway, and drives them.

mod drive;
mod feed;
mod list;
mod steps;
mod units;

use std::future::Future;
use std::path::PathBuf;
use std::pin::pin;
use std::time::Duration;

use mom_client::{Client, Map, Value};
use mom_drive::{Tell, VerbFailure};

use steps::Steps;
use units::Known;

/// Look at the robots of a fleet, and drive them
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct VerbArgs {
    /// What to do
    #[command(subcommand)]
    pub task: FleetTask,
    /// The session of the fleet
    #[arg(long, value_name = "PATH", default_value = "/fleet", global = true)]
    pub fleet: String,
}

/// What to do with a fleet.
#[derive(Debug, clap::Subcommand)]
pub enum FleetTask {
    /// Show each robot: whether it is connected, its battery, round trip, owner, pose, and how old that is. One that moves
    /// is told of once a second, one that stands when something changes: what is old there is still so
    List,
    /// Grab the tokens of robots, have each carry out a script, and give the tokens back
    #[command(after_help = SEND)]
    Send {
        /// Which robots: numbers, ranges and groups such as 1,3-5,scouts, or all
        units: String,
        /// What each does: statements of a robot's script
        #[arg(required = true)]
        script: Vec<String>,
        /// Bytes that come with the script, such as a sound: by the file's name without its extension, or as said; may be given several
        /// times
        #[arg(long = "attach", value_name = "[NAME=]FILE", value_parser = attachment)]
        attachments: Vec<(String, PathBuf)>,
    },
    /// Run a file of lines such as `1-3: goto 1000 1000`: robots work side by side, and wait for each other at `---`
    #[command(after_help = RUN)]
    Run {
        /// The file; - is the standard input
        file: PathBuf,
    },
    /// Hand out the statements of a file to a robot that asks for its commands (mom-rover --pull), each good for a while
    #[command(after_help = FEED)]
    Feed {
        /// The file; - is the standard input
        file: PathBuf,
        /// The robot's session
        #[arg(long, value_name = "PATH")]
        robot: String,
        /// For how long each statement is good, in ms: later it is not begun, and handed out anew
        #[arg(long, value_name = "MS", default_value_t = 2000, value_parser = clap::value_parser!(u64).range(1..=3_600_000))]
        within: u64,
    },
}

const EXAMPLES: &str = "\
Examples:
  mom fleet list
  mom fleet list --json
  mom fleet send 7 'motor 200 200 1000'
  mom fleet send 1,3-5 'leds 255; goto 2000 2000'
  mom fleet send scouts 'motor 100 -100 2000'
  mom fleet run formation.txt
  mom fleet feed round.txt --robot /rover/a";

const SEND: &str = "\
Statements, separated by ; or a new line:
  motor LEFT RIGHT MS   set the motors, -1000 to 1000 each, for so long
  goto X Y              drive there, in mm
  via X Y X Y ...       drive to the last point by way of the others
  leds MASK             set the LEDs, 0 to 255
  wait MS               wait
  set, do, play …       of a robot that is mirrored by a model: set joints 30 -20 10; do gesture 3 (docs/simulacrum.md)
  follow PEER MM        drive where this peer drove, so far behind it, until another command comes; for robots that are peers themselves

Examples:
  mom fleet send 7 'motor 200 200 1000'
  mom fleet send 1,3-5 'via 2000 2000 3000 2000; leds 1'
  mom fleet send 1 'play speaker hello' --attach hello.wav";

const RUN: &str = "\
A file for ten robots that form a line, and then blink together:

  # Each goes to its place in its own time,
  1: goto 500 3000
  2: goto 1500 3000
  3: goto 2500 3000
  # and then all of them wait for the last one.
  ---
  1-3: leds 255; wait 500; leds 0

Examples:
  mom fleet run config/formation.txt";

const FEED: &str = "\
The robot asks when it has nothing to do, and gets one statement with its expiry. What reaches it later, or whose age it does not know, it
refuses, and asks again: behind a bad link nothing is carried out late, and nothing twice. When this ends, the robot stands.

Examples:
  mom fleet feed round.txt --robot /rover/a
  echo 'goto 1000 1000; leds 1' | mom fleet feed - --robot /fleet/12 --within 500";

/// Does it, until it is done or `interrupt` is.
///
/// # Errors
///
/// [`VerbFailure`]: a mistake in what was typed, a refusal of the hub or of a robot.
pub async fn run(
    args: &VerbArgs,
    client: &Client,
    interrupt: impl Future<Output = ()>,
    tell: Tell<'_>,
) -> Result<(), VerbFailure> {
    let mut attachments = Map::new();
    let steps = match &args.task {
        FleetTask::List => return list::run(&args.fleet, client, tell).await,
        FleetTask::Send {
            units,
            script,
            attachments: files,
        } => {
            for (name, file) in files {
                let bytes = std::fs::read(file)
                    .map_err(|error| VerbFailure::plain(format!("{}: {error}", file.display())))?;
                attachments.set(name, Value::Binary(bytes.into()));
            }
            Steps::one(units, &script.join("; "))?
        }
        FleetTask::Run { file } => Steps::read(file)?,
        FleetTask::Feed { file, robot, within } => {
            let feeding = feed::Feeding {
                robot,
                statements: feed::statements(file)?,
                within: Duration::from_millis(*within),
            };
            return feeding.run(client, interrupt, tell).await;
        }
    };
    let mut interrupt = pin!(interrupt);
    let known = match steps.has_groups() {
        true => list::groups(&args.fleet, client).await?,
        false => Known {
            units: list::units(&args.fleet, client).await?,
            ..Known::default()
        },
    };
    let steps = steps.of(&known)?;
    drive::Drivers {
        client,
        fleet: &args.fleet,
        attachments: &attachments,
    }
    .run(&steps, &mut interrupt, tell)
    .await
}

/// A file, and by which name a script knows it.
fn attachment(text: &str) -> Result<(String, PathBuf), String> {
    let (name, file) = match text.split_once('=') {
        Some((name, file)) => (Some(name.to_owned()), PathBuf::from(file)),
        None => {
            let file = PathBuf::from(text);
            let stem = file.file_stem().and_then(|stem| stem.to_str());
            (stem.map(str::to_owned), file)
        }
    };
    let is_word = |name: &String| !name.is_empty() && !name.contains([' ', ';', '#']);
    match name.filter(is_word) {
        Some(name) => Ok((name, file)),
        None => Err("a script names it by one word: hello.wav, or hello=some file.wav".to_owned()),
    }
}

/// The channel of a robot.
fn channel(fleet: &str, unit: u32) -> String {
    format!("{fleet}/{unit}/robot")
}

/// So long a robot that is there may take to say how it is.
const SAID: Duration = Duration::from_secs(2);
