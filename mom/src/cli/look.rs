//! Arguments of the commands that look at the whole hub.

use clap::Args;

/// `mom top`
#[derive(Args, Debug)]
pub(crate) struct TopArgs {
    /// Where to look for tokens, their owners, and stops
    #[arg(default_value = "/", value_name = "PATH")]
    pub(crate) paths: Vec<String>,
    /// Print the table once, for scripts
    #[arg(long)]
    pub(crate) once: bool,
    /// Ask the hub every so many seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=3600))]
    pub(crate) every: u64,
}

pub(super) const TOP: &str = "\
It needs the right to ask for the statistics of /, and shows the addresses of all peers. Silent is the time since
anything was heard of a peer, round trip that of the hub's last ping, queue what waits for it, drops what was lost on
the way to it. The door `http` is that of who has logged in to the hub's HTTP API, such as a page of the console. Above the
table stands what is stopped, and by whom, and how many bytes of messages wait in the hub or are kept there, of the
most that `memory` of its configuration permits.

Keys: 1-9 or the arrows sort by a column, r reverses, q ends.

Examples:
  mom top
  mom top /robot                           of tokens and stops only those of the robot
  mom top --once
  mom top --once --json | jq '.peers[] | {peer, door, queued}'";

/// `mom logs`
#[derive(Args, Debug)]
pub(crate) struct LogsArgs {
    /// The channel of the reports: `log` of the hub's configuration
    #[arg(default_value = "/log")]
    pub(crate) path: String,
    /// Show also those that come, until Ctrl-C
    #[arg(long, short)]
    pub(crate) follow: bool,
}

pub(super) const LOGS: &str = "\
Peers that may join the channel may read it. Reports come from anyone who reaches the hub over HTTP, without a login:
what they say of themselves is not checked, but the address is.

Examples:
  mom logs
  mom logs --follow
  mom logs --json | jq 'select(.level == \"error\")'";
