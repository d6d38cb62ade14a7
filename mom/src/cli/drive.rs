//! Driving the robot.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use mom_pages::duration;

/// `mom card`
#[derive(Args, Debug)]
pub(crate) struct CardArgs {
    /// The device's channel
    #[arg(default_value = "/robot/arm")]
    pub(crate) channel: String,
}

pub(super) const CARD: &str = "\
A device says at its join what its statements are, which of them move it, and what its state tells. It is the
same as mom help CHANNEL.

Examples:
  mom card
  mom card /camera/pan
  mom card --json | jq .verbs";

/// `mom run`
#[derive(Args, Debug)]
pub(crate) struct RunArgs {
    /// The file; - is standard input. Each line is one command of one or more statements
    pub(crate) script: PathBuf,
    /// The robot's channel
    #[arg(long, value_name = "PATH", default_value = "/robot/arm")]
    pub(crate) channel: String,
    /// The token that guards it
    #[arg(long, value_name = "PATH", default_value = "/robot/token")]
    pub(crate) token: String,
    /// Grab this zone as well, for as long as the robot is driven; may be repeated
    #[arg(long = "zone", value_name = "PATH")]
    pub(crate) zones: Vec<String>,
    /// Go on with the next command after one that failed
    #[arg(long, short)]
    pub(crate) keep_going: bool,
    /// Send the lines without checking them first by the device's card
    #[arg(long)]
    pub(crate) no_check: bool,
    /// Print what a controller of the real arm would be told for each command
    #[arg(long, value_name = "LANGUAGE", conflicts_with = "no_check")]
    pub(crate) show: Option<Shown>,
}

/// A language of robots.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Shown {
    /// That of ABB's controllers
    Rapid,
}

pub(super) const RUN: &str = "\
Statements are separated by ; on a line. Which there are, the device says: mom card CHANNEL. Every device has
  wait MS

Examples:
  mom run pick.script
  echo 'move 100 50 200 0 0; grip close' | mom run -
  mom run --json pick.script | jq .state
  mom run --show rapid pick.script
  mom run --zone /zone/left --zone /zone/middle pick.script
  mom run --channel /camera/pan --token /camera/pan-token look.script

Ctrl-C releases the token; the hub then halts the robot.";

/// `mom trace`
#[derive(Args, Debug)]
pub(crate) struct TraceArgs {
    /// What the robot is told
    #[arg(default_value = "wait 10")]
    pub(crate) script: String,
    /// The robot's channel
    #[arg(long, value_name = "PATH", default_value = "/robot/arm")]
    pub(crate) channel: String,
    /// The token that guards it
    #[arg(long, value_name = "PATH", default_value = "/robot/token")]
    pub(crate) token: String,
}

pub(super) const TRACE: &str = "\
Times are by the hub's clock: it measures those of its peers, and says how well it knows them.

Examples:
  mom trace
  mom trace 'move 20 0 290 0 0'
  mom trace --json | jq .after";

/// `mom jog`
#[derive(Args, Debug)]
pub(crate) struct JogArgs {
    /// Without keys: the velocity, VX VY VZ in mm/s, VSPIN VTILT in degrees/s
    #[arg(num_args = 5, value_names = ["VX", "VY", "VZ", "VSPIN", "VTILT"], allow_negative_numbers = true)]
    pub(crate) velocity: Vec<f64>,
    /// For how long the velocity holds
    #[arg(long = "for", value_name = "TIME", value_parser = duration, default_value = "200ms", requires = "velocity")]
    pub(crate) time: Duration,
    /// The robot's channel
    #[arg(long, value_name = "PATH", default_value = "/robot/arm")]
    pub(crate) channel: String,
    /// The token that guards it
    #[arg(long, value_name = "PATH", default_value = "/robot/token")]
    pub(crate) token: String,
}

pub(super) const JOG: &str = "\
Keys: hold the arrows for left, right, away and near, r and f for up and down, q and e to spin, t and g to
tilt; o and c open and close the jaws, h goes home, + and - change the speed, Esc ends.

Examples:
  mom jog
  mom jog --for 1s 50 0 0 0 0              50 mm/s to the right for a second
  mom jog 0 0 -20 0 0                      20 mm/s downward for 200 ms

The hand slows down before the workspace's edge, and comes to rest when nothing is held or the link is lost.";
