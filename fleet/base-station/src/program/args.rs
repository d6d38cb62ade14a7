//! The command line.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Parser, Subcommand};
use mom_pages::duration_within;

use crate::edit::{Change, Edit};
use crate::fleet::{Address, Robot, Unit};

/// The longest time that an option takes.
const DAY: Duration = Duration::from_secs(86_400);

const EXAMPLES: &str = "\
Examples:
  mom-base-station --fleet fleet.toml
  mom-base-station --fleet fleet.toml list
  mom-base-station --fleet fleet.toml send 1,3-5 leds 255
  mom-base-station --fleet fleet.toml send 1 motor 100 100     # drives until Ctrl-C
  mom-base-station --fleet fleet.toml send 1 motor 50 -50 --repeat 500ms --times 10
  mom-base-station --fleet fleet.toml send 3 to 1000 500 via 200 300 --stay 20s
  mom-base-station --fleet fleet.toml --log today.jsonl run script.txt
  mom-base-station --fleet fleet.toml add 4 192.168.1.14:4000 --group scouts
  mom-base-station --fleet fleet.toml change 4 --address 192.168.1.24:4000 --no-group
  mom-base-station --fleet fleet.toml remove 4

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
    #[arg(long, value_name = "TIME", default_value = "3s", value_parser = duration_within(Duration::ZERO..=DAY))]
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
    /// Add a robot to the file of the fleet, which is made if it is not there; no robot is spoken to
    Add(AddArgs),
    /// Change a robot in the file of the fleet; comments and order stay
    Change(ChangeArgs),
    /// Remove robots from the file of the fleet
    Remove(RemoveArgs),
}

#[derive(Debug, clap::Args)]
pub(super) struct AddArgs {
    /// Its unit number
    pub(super) unit: Unit,
    /// Where it listens, HOST:PORT
    #[arg(value_parser = Address::parse)]
    pub(super) address: Address,
    /// What people call it
    #[arg(long, value_name = "NAME")]
    pub(super) name: Option<String>,
    /// The group in which it is: robots of one group are driven together
    #[arg(long, value_name = "NAME")]
    pub(super) group: Option<String>,
}

#[derive(Debug, clap::Args)]
pub(super) struct ChangeArgs {
    /// The unit number that it has
    pub(super) unit: Unit,
    /// Another unit number
    #[arg(long = "unit", id = "renumber", value_name = "UNIT")]
    pub(super) renumber: Option<Unit>,
    /// Where it listens from now on, HOST:PORT
    #[arg(long, value_name = "ADDRESS", value_parser = Address::parse)]
    pub(super) address: Option<Address>,
    /// Another name
    #[arg(long, value_name = "NAME", conflicts_with = "no_name")]
    pub(super) name: Option<String>,
    /// No name
    #[arg(long)]
    pub(super) no_name: bool,
    /// Another group
    #[arg(long, value_name = "NAME", conflicts_with = "no_group")]
    pub(super) group: Option<String>,
    /// No group
    #[arg(long)]
    pub(super) no_group: bool,
}

#[derive(Debug, clap::Args)]
pub(super) struct RemoveArgs {
    /// Their unit numbers
    #[arg(required = true, value_name = "UNIT")]
    pub(super) units: Vec<Unit>,
}

impl Work {
    /// The change of the file that this is, if it is one, and what it has done in words.
    pub(super) fn edit(&self) -> Option<(Edit, String)> {
        match self {
            Self::Send(_) | Self::Run(_) | Self::List => None,
            Self::Add(add) => {
                let robot = Robot {
                    unit: add.unit,
                    address: add.address.clone(),
                    name: add.name.clone(),
                    group: add.group.clone(),
                };
                Some((Edit::Add(robot), format!("added unit {}", add.unit)))
            }
            Self::Change(change) => {
                let word = |word: &Option<String>, no: bool| match no {
                    true => Some(None),
                    false => word.clone().map(Some),
                };
                let edit = Change {
                    unit: change.renumber,
                    address: change.address.clone(),
                    name: word(&change.name, change.no_name),
                    group: word(&change.group, change.no_group),
                };
                let done = format!("changed unit {}", change.unit);
                Some((Edit::Change(change.unit, edit), done))
            }
            Self::Remove(remove) => {
                let units: Vec<String> = remove.units.iter().map(Unit::to_string).collect();
                let done = format!("removed unit {}", units.join(", "));
                Some((Edit::Remove(remove.units.clone()), done))
            }
        }
    }
}

#[derive(Debug, clap::Args)]
pub(super) struct SendArgs {
    /// The statement, such as 1 motor 100 100
    #[arg(required = true, allow_negative_numbers = true, value_name = "STATEMENT")]
    pub(super) statement: Vec<String>,
    /// Send it again and again, after a time such as 500ms or 2s
    #[arg(long, value_name = "TIME", value_parser = duration_within(Duration::ZERO..=DAY))]
    pub(super) repeat: Option<Duration>,
    /// So many times in all; without it until Ctrl-C
    #[arg(long, value_name = "N", requires = "repeat", value_parser = clap::value_parser!(u64).range(1..))]
    pub(super) times: Option<u64>,
    /// Stay so long afterwards before the robots are stopped; without it, until Ctrl-C where a statement that is sent
    /// once has set one in motion
    #[arg(long, value_name = "TIME", value_parser = duration_within(Duration::ZERO..=DAY))]
    pub(super) stay: Option<Duration>,
}

#[derive(Debug, clap::Args)]
pub(super) struct RunArgs {
    /// The script
    #[arg(value_name = "FILE")]
    pub(super) script: PathBuf,
    /// Stay so long afterwards before the robots are stopped
    #[arg(long, value_name = "TIME", value_parser = duration_within(Duration::ZERO..=DAY), default_value = "0ms")]
    pub(super) stay: Duration,
}
