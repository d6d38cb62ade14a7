//! Arguments of the commands that stop devices and let them go.

use clap::Args;

/// `mom stop` and `mom unstop`
#[derive(Args, Debug)]
pub(crate) struct StopArgs {
    /// A channel, or a session with all that is below it
    #[arg(default_value = "/")]
    pub(crate) path: String,
}

pub(crate) const STOP: &str = "\
Needs no token, and overtakes everything. A device stays stopped, whoever owns it, until somebody lets it go. Exit code 0
says that every device there stands; those that say nothing within a second are named.

Examples:
  mom stop                                 all that you may stop
  mom stop /robot/arm                      one robot
  mom stop /robot                          all of a session
  mom unstop /robot/arm                    lets it move again";

pub(crate) const UNSTOP: &str = "\
Nothing moves by itself: old commands are gone. Exit code 0 says that every device there is free to move; those that say
nothing within a second are named.

Examples:
  mom unstop /robot/arm
  mom unstop                               all that you may let go";
