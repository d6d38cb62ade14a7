//! The command line.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context as _, Result, ensure};
use clap::{Parser, Subcommand};

const EXAMPLES: &str = "\
Examples:
  mom-base-station --fleet fleet.toml
  mom-base-station --fleet fleet.toml list
  mom-base-station --fleet fleet.toml send 1,3-5 leds 255
  mom-base-station --fleet fleet.toml send 1 motor 100 100     # drives until Ctrl-C
  mom-base-station --fleet fleet.toml send 1 motor 50 -50 --repeat 500ms --times 10
  mom-base-station --fleet fleet.toml send 3 to 1000 500 via 200 300 --stay 20s
  mom-base-station --fleet fleet.toml --log today.jsonl run script.txt

The file of a fleet has a table for each robot:
  [[robot]]
  unit = 1
  address = \"127.0.0.1:4001\"

Statements and scripts:
  1 motor 100 100              # UNIT COMMAND VALUES
  1,3-5 leds 255; all motor 0 0
  wait 500                     # ms
  repeat 10; 1 motor 50 -50; wait 200; end
  3 to 1000 500 via 200 300    # drive to a place by another
  2 status; on 2 reply status  # wait for the reply, 3 s at most

Whenever the program ends, by Ctrl-C and SIGTERM too, the robots that it has set in motion are stopped.";

/// The base station of a fleet of mobile robots: connects to each, sends commands by hand or from a script, and shows what they reply.
#[derive(Debug, Parser)]
#[command(name = "mom-base-station", version, after_help = EXAMPLES)]
pub(super) struct Args {
    /// The file of the fleet
    #[arg(long, value_name = "FILE", env = "MOM_FLEET")]
    pub(super) fleet: PathBuf,
    /// A file of further commands, beside NULL, STATUS, MOTOR and LEDS; without it those of our own robots: goto, via, pose
    #[arg(long, value_name = "FILE")]
    pub(super) table: Option<PathBuf>,
    /// Append all that is sent and received to a file, as JSON lines
    #[arg(long, value_name = "FILE")]
    pub(super) log: Option<PathBuf>,
    /// For how long the commands below try to connect, before they go on without the robots that are missing
    #[arg(long, value_name = "TIME", default_value = "3s", value_parser = time)]
    pub(super) timeout: Duration,
    #[command(subcommand)]
    pub(super) work: Option<Work>,
}

/// What to do; without any, show the fleet: drawn in a terminal, otherwise as lines, with statements from the standard input
#[derive(Debug, Subcommand)]
pub(super) enum Work {
    /// Send one statement
    Send(SendArgs),
    /// Carry out a script
    Run(RunArgs),
    /// Try all robots and tell their states, round trips and status bits
    List,
}

#[derive(Debug, clap::Args)]
pub(super) struct SendArgs {
    /// The statement, such as 1 motor 100 100
    #[arg(required = true, allow_negative_numbers = true, value_name = "STATEMENT")]
    pub(super) statement: Vec<String>,
    /// Send it again and again, after a time such as 500ms or 2s
    #[arg(long, value_name = "TIME", value_parser = time)]
    pub(super) repeat: Option<Duration>,
    /// So many times in all; without it until Ctrl-C
    #[arg(long, value_name = "N", requires = "repeat", value_parser = clap::value_parser!(u64).range(1..))]
    pub(super) times: Option<u64>,
    /// Stay so long afterwards before the robots are stopped; without it, until Ctrl-C where a statement that is sent once has set one in motion
    #[arg(long, value_name = "TIME", value_parser = time)]
    pub(super) stay: Option<Duration>,
}

#[derive(Debug, clap::Args)]
pub(super) struct RunArgs {
    /// The script
    #[arg(value_name = "FILE")]
    pub(super) script: PathBuf,
    /// Stay so long afterwards before the robots are stopped
    #[arg(long, value_name = "TIME", value_parser = time, default_value = "0ms")]
    pub(super) stay: Duration,
}

/// `500ms` or `2s`, up to a day.
pub(super) fn time(text: &str) -> Result<Duration> {
    let (number, unit) = match text.strip_suffix("ms") {
        Some(number) => (number, 1),
        None => (text.strip_suffix('s').unwrap_or_default(), 1000),
    };
    let number: u64 = number
        .parse()
        .ok()
        .context("it must be a time such as 500ms or 2s")?;
    let millis = number.saturating_mul(unit);
    ensure!(millis <= 24 * 3600 * 1000, "it must be at most a day");
    Ok(Duration::from_millis(millis))
}
