//! The command line.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand};
use mom_client::{MessageRate, WireError};
use mom_pages::duration;

mod access;
mod camera;
mod contexts;
mod control;
mod drive;
mod look;
mod new;
mod parse;
mod stop;

use crate::devices::DeviceCommand;
pub(crate) use crate::global::GlobalArgs;

use self::access::{AUDIT, EXPLAIN, WHAT_IF};
use self::camera::{AIM, CAMERA};
use self::contexts::{CREATE, DELETE};
pub(crate) use self::parse::parse;

use self::control::{
    ACCEPT, BREAK, DECLINE, EXPEL, GIVE, GRAB, HIRE, INHIBIT, INVITE, MANAGE, REQUEST, TOKEN,
};
use self::drive::{CARD, JOG, RUN, TRACE};
pub(crate) use self::drive::{CardArgs, JogArgs, RunArgs, TraceArgs};
use self::look::{LOGS, TOP};
use self::new::NEW;
pub(crate) use self::new::{Language, NewCommand, NewDeviceArgs};
use self::stop::{STOP, UNSTOP};

/// Look at a hub, talk through it, and drive the devices connected to it.
#[derive(Debug, Parser)]
#[command(name = "mom", version, arg_required_else_help = true, after_help = EXAMPLES)]
pub(crate) struct Cli {
    /// Options of all commands.
    #[command(flatten)]
    pub(crate) global: GlobalArgs,
    /// The command.
    #[command(subcommand)]
    pub(crate) command: Command,
}

const EXAMPLES: &str = "\
Examples:
  mom lab                                  a hub, a robot arm and five cameras to try
  export MOM_USER=alice MOM_PASSWORD=alice
  mom tree                                 what there is, who is there, who drives what
  echo 'move 100 50 200 0 0; grip close' | mom run -
  mom watch /robot/arm                     what happens there
  mom stop                                 everything that you may stop
  mom doctor lab.example.org               what keeps you from that hub

The password comes from MOM_PASSWORD, or is asked for; it is never an argument. Devices use keys:
see mom keygen --help.
Exit codes: 0 done, 1 failed or refused, 2 a command line that makes no sense.";

/// The commands.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Stop devices now, and wait for each one's word
    #[command(after_help = STOP)]
    Stop(StopArgs),
    /// Let stopped devices move again
    #[command(after_help = UNSTOP)]
    Unstop(UnstopArgs),
    /// Run a hub with a robot arm and five cameras in one process, to try
    #[command(after_help = LAB)]
    Lab(LabArgs),
    /// Show the tree of contexts: kinds, members, owners
    #[command(after_help = TREE)]
    Tree(TreeArgs),
    /// Show statistics of channels: sent, delivered, dropped, ages
    #[command(after_help = STATS)]
    Stats(StatsArgs),
    /// Show who is connected, through which door, how well, and who owns what, as it changes
    #[command(after_help = TOP)]
    Top(TopArgs),
    /// Show who was granted or refused what, or lost it, by which rule
    #[command(after_help = AUDIT)]
    Audit(AuditArgs),
    /// Explain who may do what, by which line of the hub's configuration
    #[command(after_help = EXPLAIN)]
    Explain(ExplainArgs),
    /// Try another configuration on what the hub has recorded
    #[command(after_help = WHAT_IF)]
    WhatIf(WhatIfArgs),
    /// Show what programs have reported of their errors to the hub
    #[command(after_help = LOGS)]
    Logs(LogsArgs),
    /// Show what happens in contexts, one line per parcel, until Ctrl-C
    #[command(after_help = WATCH)]
    Watch(WatchArgs),
    /// Send one message
    #[command(after_help = SEND)]
    Send(SendArgs),
    /// Make a session, channel or token
    #[command(after_help = CREATE)]
    Create(CreateArgs),
    /// Delete a context with all below it
    #[command(after_help = DELETE)]
    Delete(DeleteArgs),
    /// Grab a token, waiting for it if need be, and hold it until Ctrl-C
    #[command(after_help = GRAB)]
    Grab(GrabArgs),
    /// Ask a token's owner to hand it over, and hold it until Ctrl-C
    #[command(after_help = REQUEST)]
    Request(RequestArgs),
    /// Grab a token and give it to another peer, for good or for a while
    #[command(after_help = GIVE)]
    Give(GiveArgs),
    /// Hire an agent for a task: lend it the token with a scope, follow it, and take the token back
    #[command(after_help = HIRE)]
    Hire(HireArgs),
    /// Accept a token that is offered to you, and hold it until Ctrl-C
    #[command(after_help = ACCEPT)]
    Accept(AcceptArgs),
    /// Decline a token that is offered to you
    #[command(after_help = DECLINE)]
    Decline(DeclineArgs),
    /// Take a token away from its owner; needs the right to it
    #[command(after_help = BREAK)]
    Break(BreakArgs),
    /// Keep everybody from a token until Ctrl-C
    #[command(after_help = INHIBIT)]
    Inhibit(InhibitArgs),
    /// Show a token: its owner, lease, queue, offers
    #[command(after_help = TOKEN)]
    Token(TokenArgs),
    /// Invite a peer to a context
    #[command(after_help = INVITE)]
    Invite(InviteArgs),
    /// Expel a peer from a context
    #[command(after_help = EXPEL)]
    Expel(ExpelArgs),
    /// Answer the hub's questions where you have the chair
    #[command(after_help = MANAGE)]
    Manage(ManageArgs),
    /// Show what a device can do, by its own card
    #[command(after_help = CARD)]
    Card(CardArgs),
    /// Drive a device by a script: grab its token, run the commands, release it
    #[command(after_help = RUN)]
    Run(RunArgs),
    /// Follow one command from here to the robot and back, with the time of each step
    #[command(after_help = TRACE)]
    Trace(TraceArgs),
    /// Drive the robot by keys, held: it moves while they are
    #[command(after_help = JOG)]
    Jog(JogArgs),
    /// Chat: sends input lines and shows the lines of others
    #[command(after_help = CHAT)]
    Chat(ChatArgs),
    /// Try every door of a hub, say what blocks, and measure what is open
    #[command(after_help = DOCTOR)]
    Doctor(DoctorArgs),
    /// Make a key pair, so that a device needs no password
    #[command(after_help = KEYGEN)]
    Keygen(KeygenArgs),
    /// Begin a device of your own, in Python, JavaScript or Rust
    #[command(subcommand, after_help = NEW)]
    New(NewCommand),
    /// Tell the settings of a camera, or change them
    #[command(after_help = CAMERA)]
    Camera(CameraArgs),
    /// Turn the camera that can be turned: grab its token, wait until it looks there, release it
    #[command(after_help = AIM)]
    Aim(AimArgs),
    /// Ask a camera for an image and save it
    #[command(after_help = SNAP)]
    Snap(SnapArgs),
    /// Check models of thin robots, and generate code and documents from them
    Rsp(mom_rsp_model::verb::VerbArgs),
    /// What devices bring along.
    #[command(flatten)]
    Device(DeviceCommand),
}

/// `mom lab`
#[derive(Args, Debug)]
pub(crate) struct LabArgs {
    /// Where to listen; without TLS passwords are accepted on loopback only. Port 0 takes a free one
    #[arg(long, value_name = "ADDRESS")]
    pub(crate) listen: Option<SocketAddr>,
    /// Two arms that face each other over one table, without cameras: who works where is said by zones
    #[arg(long)]
    pub(crate) two_arms: bool,
    /// A fleet of so many wheeled robots with their base station instead of the arm
    #[arg(long, value_name = "ROBOTS", conflicts_with = "two_arms", value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub(crate) fleet: Option<u16>,
    /// All robots of the fleet under one token, /fleet/token
    #[arg(long, requires = "fleet")]
    pub(crate) together: bool,
    /// CUBO, a thin robot that is mirrored over RSP, instead of the arm
    #[arg(long, conflicts_with_all = ["two_arms", "fleet"])]
    pub(crate) cubo: bool,
    /// What to log to standard error: error, warn, info, debug, trace, or per module
    #[arg(long, value_name = "FILTER", env = "MOM_LOG", default_value = "warn")]
    pub(crate) log: String,
}

const LAB: &str = "\
Examples:
  mom lab
  mom lab --listen 127.0.0.1:0             on any free port; it is printed
  mom lab --two-arms                       two arms whose workspaces overlap
  mom lab --fleet 10                       ten wheeled robots and their base station
  mom lab --fleet 10 --together            the same, driven together under one token
  mom lab --cubo                           a thin robot, mirrored over RSP
  mom lab --log info";

/// `mom tree`
#[derive(Args, Debug)]
pub(crate) struct TreeArgs {
    /// Where to begin
    #[arg(default_value = "/")]
    pub(crate) path: String,
    /// The number of levels to show
    #[arg(long, short = 'L', value_name = "LEVELS")]
    pub(crate) depth: Option<usize>,
}

const TREE: &str = "\
Examples:
  mom tree
  mom tree /robot
  mom tree --json | jq '.children[].path'";

/// `mom stats`
#[derive(Args, Debug)]
pub(crate) struct StatsArgs {
    /// A channel, for the statistics of each member, or a session, for its channels
    #[arg(default_value = "/")]
    pub(crate) path: String,
    /// Repeat every so many seconds, until Ctrl-C
    #[arg(long, short, value_name = "SECONDS", num_args = 0..=1, default_missing_value = "2", value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) watch: Option<u64>,
}

const STATS: &str = "\
Dropped messages are told by reason and class; ages are those at which the hub took messages in, where it knows the
sender's clock.

Examples:
  mom stats
  mom stats /robot/arm --watch
  mom stats --json | jq '.channels[] | {path, sent}'";

/// `mom watch`
#[derive(Args, Debug)]
pub(crate) struct WatchArgs {
    /// Sessions, channels and tokens
    #[arg(required = true, value_name = "PATH")]
    pub(crate) paths: Vec<String>,
    /// Stop after so many lines
    #[arg(long, short = 'n', value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) count: Option<u64>,
    /// Also all contexts below that exist now
    #[arg(long, short)]
    pub(crate) recursive: bool,
    /// Only messages, no events
    #[arg(long, short)]
    pub(crate) messages: bool,
    /// Only the newest of each sender and name, if messages come faster than the link takes them
    #[arg(long)]
    pub(crate) newest: bool,
    /// The most messages of each sender and name: 5/s, 12/min. The hub drops the others and tells how many
    #[arg(long, value_name = "RATE", value_parser = rate)]
    pub(crate) rate: Option<MessageRate>,
}

const WATCH: &str = "\
Examples:
  mom watch /chat /robot/arm
  mom watch --recursive /robot             who drives, what the robot is told and what it tells
  mom watch --json --count 1 /robot/arm    the next parcel with all its slots
  mom watch --rate 1/s /robot/arm          its newest state once a second

--newest and --rate leave out no command, stop or event. Times are UTC.";

/// `mom send`
#[derive(Args, Debug)]
pub(crate) struct SendArgs {
    /// The channel
    pub(crate) path: String,
    /// The message's name
    pub(crate) name: String,
    /// The content, a string; - reads it from standard input
    #[arg(allow_hyphen_values = true)]
    pub(crate) content: Option<String>,
    /// The content as JSON
    #[arg(long, value_name = "JSON", conflicts_with = "content")]
    pub(crate) content_json: Option<String>,
    /// Only to these members
    #[arg(long, value_name = "PEER", value_delimiter = ',')]
    pub(crate) to: Vec<String>,
    /// Higher is more urgent
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub(crate) priority: Option<i32>,
    /// Worthless after this time: 250ms, 5s, 2m
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub(crate) expires: Option<Duration>,
    /// How it is delivered when a receiver is slow; the channel decides if absent
    #[arg(long, value_name = "CLASS", value_parser = ["reliable", "latest", "fleeting"])]
    pub(crate) delivery: Option<String>,
    /// Wait until every receiver's queue has taken or dropped it, and tell how many did
    #[arg(long, short)]
    pub(crate) acknowledge: bool,
}

const SEND: &str = "\
Examples:
  mom send /chat chat 'good morning'
  mom send /chat chat --to bob --acknowledge 'only you'
  mom send /chat note --content-json '{\"x\": 1.5, \"names\": [\"red\", \"blue\"]}'
  uptime | mom send /chat chat -";

pub(crate) use access::{AuditArgs, ExplainArgs, WhatIfArgs};
pub(crate) use camera::{AimArgs, CameraArgs};
pub(crate) use contexts::{CreateArgs, DeleteArgs};
pub(crate) use control::{
    AcceptArgs, BreakArgs, DeclineArgs, ExpelArgs, GiveArgs, GrabArgs, HireArgs, HoldArgs, InhibitArgs,
    InviteArgs, ManageArgs, RequestArgs, TokenArgs, WaitArg,
};
pub(crate) use look::{LogsArgs, TopArgs};
pub(crate) use stop::{StopArgs, UnstopArgs};

/// `mom chat`
#[derive(Args, Debug)]
pub(crate) struct ChatArgs {
    /// The channel
    #[arg(default_value = "/chat")]
    pub(crate) path: String,
}

const CHAT: &str = "\
Examples:
  mom chat
  echo 'good morning' | mom chat           sends, and ends with its input";

/// `mom snap`
#[derive(Args, Debug)]
pub(crate) struct SnapArgs {
    /// The camera, by its channel's name
    #[arg(default_value = "x")]
    pub(crate) view: String,
    /// The file to write; - is standard output. Made of camera and time if absent
    #[arg(long, short, value_name = "FILE")]
    pub(crate) output: Option<PathBuf>,
    /// The session of the cameras
    #[arg(long, value_name = "PATH", default_value = "/camera")]
    pub(crate) session: String,
    /// How long to wait for the image: 5s
    #[arg(long, value_name = "TIME", value_parser = duration, default_value = "10s")]
    pub(crate) timeout: Duration,
    /// Fail where no camera answers, instead of taking the newest picture that the channel has
    #[arg(long)]
    pub(crate) fresh: bool,
}

const SNAP: &str = "\
Examples:
  mom snap                                 camera x
  mom snap wrist --output table.jpg
  mom snap --output - | feh -";

/// `mom doctor`
#[derive(Args, Debug)]
pub(crate) struct DoctorArgs {
    /// The hub: HOST, HOST:PORT, either with ?pin=FINGERPRINT, or an address; that of --hub if absent
    pub(crate) host: Option<String>,
    /// Write plots of connect times and round trips (SVG) into this folder
    #[arg(long, value_name = "DIR")]
    pub(crate) save: Option<PathBuf>,
    /// Measure less and wait less: some seconds instead of up to a minute
    #[arg(long, short)]
    pub(crate) quick: bool,
}

const DOCTOR: &str = "\
It logs nobody in: pings are answered before. Times are medians: TCP of a connection, open of one on which one can
speak (with TLS if the door has it), answer of the hub's first words. A ping has so many bytes of padding, and its pong
is short, so the round trips tell what a size costs on the way to the hub.

Examples:
  mom doctor                               the hub of --hub or MOM_HUB
  mom doctor lab.example.org --quick
  mom doctor 'lab.example.org:7666?pin=sha256:...' --save plots
  mom doctor --json lab | jq '.doors[] | {address, blocked}'

Exit codes: 0 a door that takes a password works, 1 none does.";

/// `mom keygen`
#[derive(Args, Debug)]
pub(crate) struct KeygenArgs {
    /// The file for the private key
    #[arg(long, short, value_name = "FILE", default_value = "mom.key")]
    pub(crate) out: PathBuf,
    /// Replace the file if it exists
    #[arg(long)]
    pub(crate) force: bool,
}

const KEYGEN: &str = "\
Examples:
  mom keygen                               the private key in mom.key, the public one printed
  mom keygen --user arm --out arm.key
  mom keygen --json --out arm.key | jq -r .public

The public key goes into the hub's users file: keys = [\"ed25519 ...\"]. With the private one the device
logs in from anywhere: mom --user arm --key arm.key tree";

/// `5/s`, `12/min`.
fn rate(text: &str) -> Result<MessageRate, String> {
    text.parse().map_err(|error: WireError| error.text)
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    #[test]
    fn the_definition_is_sound_and_every_command_has_examples() {
        let command = Cli::command();
        command.clone().debug_assert();
        for command in command.get_subcommands() {
            let help = command
                .get_after_help()
                .map(ToString::to_string)
                .unwrap_or_default();
            assert!(help.contains("Examples:"), "{}", command.get_name());
            assert!(
                help.contains(&format!("mom {}", command.get_name())),
                "{}",
                command.get_name()
            );
        }
    }

    /// An option of all commands must not have the name of an option of one command.
    #[test]
    fn every_way_to_log_in_goes_with_every_command() {
        let login: [&[&str]; 4] = [&[], &["--key", "f"], &["--jwt", "f"], &["--guest"]];
        for login in login {
            for command in [
                &["tree"][..],
                &["watch", "/a"],
                &["send", "/a", "b"],
                &["grab", "/token"],
                &["request", "/token", "--text", "please"],
                &["give", "bob", "/token", "--for", "1m"],
                &["accept", "/token", "--peer", "bob"],
                &["decline", "/token"],
                &["break", "/token"],
                &["inhibit", "/token"],
                &["token", "/token"],
                &["audit", "/token", "--about", "bob", "--follow"],
                &["explain", "/token", "grab", "--about", "bob"],
                &["what-if", "f"],
                &["invite", "bob", "/a"],
                &["expel", "bob", "/a", "--text", "out"],
                &["manage", "/a", "--allow-all"],
                &["run", "f", "--token", "/token"],
                &["chat"],
                &["snap"],
                &["camera", "x", "--size", "640x480", "--overlay", "on"],
                &["keygen"],
                &["doctor", "lab", "--save", "f", "--quick"],
            ] {
                let line = [&["mom"], command, login].concat();
                let cli = Cli::try_parse_from(&line).unwrap_or_else(|error| panic!("{line:?}: {error}"));
                if let Command::Grab(GrabArgs { path: token, .. }) | Command::Run(RunArgs { token, .. }) =
                    cli.command
                {
                    assert_eq!(token, "/token");
                }
            }
        }
        assert!(Cli::try_parse_from(["mom", "tree", "--key", "f", "--guest"]).is_err());
        assert!(Cli::try_parse_from(["mom", "tree", "--key", "f", "--jwt", "f"]).is_err());
    }

    #[test]
    fn a_password_is_no_argument() {
        assert!(Cli::try_parse_from(["mom", "tree", "--password", "x"]).is_err());
    }
}
