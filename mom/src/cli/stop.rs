//! Arguments of the commands that stop devices and let them go.

use clap::Args;

/// `mom stop`
#[derive(Args, Debug)]
pub(crate) struct StopArgs {
    /// A channel, or a session with all that is below it
    #[arg(default_value = "/")]
    pub(crate) path: String,
    /// Why, for anyone who finds the devices stopped
    #[arg(long, short, value_name = "TEXT")]
    pub(crate) reason: Option<String>,
    /// Demand that each device has measured that it rests: exit code 1 for those that do not measure
    #[arg(long)]
    pub(crate) measured: bool,
    /// Connect now, and stop at each key press, until Ctrl-C
    #[arg(long)]
    pub(crate) ready: bool,
}

/// `mom unstop`
#[derive(Args, Debug)]
pub(crate) struct UnstopArgs {
    /// A channel, or a session with all that is below it
    #[arg(default_value = "/")]
    pub(crate) path: String,
}

pub(crate) const STOP: &str = "\
Needs no token, and overtakes everything. What is stopped stays so, even if its owner changes, also over a restart of the hub, until
a peer lets it go; a device that is away gets the stop when it comes. Exit code 0 says that every device there obeys and none
still moves after 3 seconds, that there is one, that each channel with a token has one, and that you may stop them all; the
others are named. \"Stands\" is said of what has measured it, or has no way to and waited for the time in which it stops.

Examples:
  mom stop                                 all that you may stop
  mom stop /robot/arm --reason 'smoke'     one robot, and why
  mom stop /robot                          all of a session
  mom stop --measured                      fails for devices that do not measure whether they rest
  mom stop --ready                         logs in now; the next key press stops at once
  mom unstop /robot/arm                    lets it move again";

pub(crate) const UNSTOP: &str = "\
Lifts the stops that hold now, and none that is sent meanwhile: such a one is named, and the device stays stopped.
Nothing moves by itself: old commands are gone. Exit code 0 says that every device there is free to move; those that say
nothing within a second are named.

Examples:
  mom unstop /robot/arm
  mom unstop                               all that you may let go";
