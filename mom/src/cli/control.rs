//! Arguments of the commands for tokens and access.

use std::time::Duration;

use clap::Args;

use mom_client::{Map, Value};
use mom_pages::{duration, duration_within};

/// How long to hold a token.
#[derive(Args, Debug)]
pub(crate) struct HoldArgs {
    /// Release it after this time instead of at Ctrl-C: 30s, 5m
    #[arg(long = "for", value_name = "TIME", value_parser = duration)]
    pub(crate) time: Option<Duration>,
    /// Answer peers that ask for it: y and Enter hands it over, n and Enter does not
    #[arg(long, short)]
    pub(crate) answer: bool,
}

/// `mom grab`
#[derive(Args, Debug)]
pub(crate) struct GrabArgs {
    /// The token
    pub(crate) path: String,
    /// Wait in the queue for at most this time: 30s, 5m, or forever
    #[arg(long, value_name = "TIME", value_parser = wait)]
    pub(crate) wait: Option<WaitArg>,
    #[command(flatten)]
    pub(crate) hold: HoldArgs,
}

pub(super) const GRAB: &str = "\
Examples:
  mom grab /robot/token
  mom grab --wait 5m /robot/token          waits for your turn, and shows your place
  mom grab --for 30s /robot/token
  mom grab --answer /robot/token           who asks for it is answered with y or n

Ctrl-C releases it, or leaves the queue.";

/// How long to wait for a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum WaitArg {
    /// At most this long.
    For(Duration),
    /// As long as it takes.
    Forever,
}

fn wait(text: &str) -> Result<WaitArg, String> {
    match text {
        "forever" => Ok(WaitArg::Forever),
        text => duration(text).map(WaitArg::For),
    }
}

/// `mom request`
#[derive(Args, Debug)]
pub(crate) struct RequestArgs {
    /// The token
    pub(crate) path: String,
    /// The reason, shown to the owner
    #[arg(long, value_name = "WORDS")]
    pub(crate) text: Option<String>,
    /// How long its owner may take to answer; 30s if absent
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub(crate) within: Option<Duration>,
    #[command(flatten)]
    pub(crate) hold: HoldArgs,
}

pub(super) const REQUEST: &str = "\
Examples:
  mom request /robot/token
  mom request --text 'only to take the cup away' --within 1m /robot/token

A free token is yours at once. Its owner answers with y or n in: mom grab --answer /robot/token";

/// `mom give`
#[derive(Args, Debug)]
pub(crate) struct GiveArgs {
    /// The peer, by its name at the hub
    pub(crate) peer: String,
    /// The token
    pub(crate) path: String,
    /// Only for this time; then it returns and is released: 30s, 2m
    #[arg(long = "for", value_name = "TIME", value_parser = duration)]
    pub(crate) time: Option<Duration>,
    /// Only for so many commands; then it returns and is released
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) commands: Option<u64>,
    /// How long the peer may take to accept; 10s if absent
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub(crate) within: Option<Duration>,
    /// First wait in the queue for at most this time: 30s, 5m, or forever
    #[arg(long, value_name = "TIME", value_parser = wait)]
    pub(crate) wait: Option<WaitArg>,
}

pub(super) const GIVE: &str = "\
Examples:
  mom give bob /robot/token                for good
  mom give servo /robot/token --for 2m --commands 5
  mom give bob /robot/token --within 1m --wait 5m

The other peer takes it with: mom accept /robot/token";

/// `mom accept`
#[derive(Args, Debug)]
pub(crate) struct AcceptArgs {
    /// The token
    pub(crate) path: String,
    /// Only if this peer offers it
    #[arg(long, value_name = "PEER")]
    pub(crate) peer: Option<String>,
    /// Wait so long for an offer: 1m; until Ctrl-C if absent
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub(crate) within: Option<Duration>,
    #[command(flatten)]
    pub(crate) hold: HoldArgs,
}

pub(super) const ACCEPT: &str = "\
Examples:
  mom accept /robot/token                  waits for an offer and takes it
  mom accept --peer alice --within 1m /robot/token";

/// `mom decline`
#[derive(Args, Debug)]
pub(crate) struct DeclineArgs {
    /// The token
    pub(crate) path: String,
    /// Only if this peer offers it
    #[arg(long, value_name = "PEER")]
    pub(crate) peer: Option<String>,
    /// Wait so long for an offer: 1m; until Ctrl-C if absent
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub(crate) within: Option<Duration>,
}

pub(super) const DECLINE: &str = "\
Examples:
  mom decline /robot/token                 waits for an offer and says no
  mom decline --peer alice --within 1m /robot/token";

/// `mom break`
#[derive(Args, Debug)]
pub(crate) struct BreakArgs {
    /// The token
    pub(crate) path: String,
}

pub(super) const BREAK: &str = "\
Examples:
  mom break /robot/token                   its owner loses it, and the robot halts";

/// `mom inhibit`
#[derive(Args, Debug)]
pub(crate) struct InhibitArgs {
    /// The token
    pub(crate) path: String,
    /// End it after this time instead of at Ctrl-C: 30s, 5m
    #[arg(long = "for", value_name = "TIME", value_parser = duration)]
    pub(crate) time: Option<Duration>,
}

pub(super) const INHIBIT: &str = "\
Examples:
  mom inhibit /robot/token                 nobody drives while you are at the table
  mom inhibit --for 10m /robot/token

Several may do so at a time; the token can be grabbed again when the last of them ends it.";

/// `mom token`
#[derive(Args, Debug)]
pub(crate) struct TokenArgs {
    /// The token
    pub(crate) path: String,
}

pub(super) const TOKEN: &str = "\
Examples:
  mom token /robot/token
  mom token --json /robot/token | jq .owner";

/// `mom invite`
#[derive(Args, Debug)]
pub(crate) struct InviteArgs {
    /// The peer, by its name at the hub
    pub(crate) peer: String,
    /// The context
    pub(crate) path: String,
}

pub(super) const INVITE: &str = "\
Examples:
  mom invite bob /robot

Whether the peer may join is for the context's manager to say; some let in who was invited.";

/// `mom expel`
#[derive(Args, Debug)]
pub(crate) struct ExpelArgs {
    /// The peer, by its name at the hub
    pub(crate) peer: String,
    /// The context; / is the whole hub
    pub(crate) path: String,
    /// The reason, shown to the peer and the members
    #[arg(long, value_name = "WORDS")]
    pub(crate) text: Option<String>,
    /// How long the peer is kept out; 1m if absent
    #[arg(long = "for", value_name = "TIME", value_parser = duration)]
    pub(crate) time: Option<Duration>,
}

pub(super) const EXPEL: &str = "\
Examples:
  mom expel bob /robot
  mom expel bob /robot --text 'the robot is being repaired' --for 1h";

/// `mom manage`
#[derive(Args, Debug)]
pub(crate) struct ManageArgs {
    /// The contexts where you have the chair; the hub asks only who is in them
    #[arg(required = true, value_name = "PATH")]
    pub(crate) paths: Vec<String>,
    /// Say yes to everything
    #[arg(long)]
    pub(crate) allow_all: bool,
}

pub(super) const MANAGE: &str = "\
Examples:
  mom manage /robot                        each question is answered with y, n or a
  mom manage --allow-all /robot
  yes | mom manage --json /robot           questions and answers as JSON

Answers: y yes, a yes from now on, n no, or n and why. Without an answer in time the hub says no.";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn how_long_to_wait() {
        assert_eq!(wait("forever"), Ok(WaitArg::Forever));
        assert_eq!(wait("5s"), Ok(WaitArg::For(Duration::from_secs(5))));
        assert!(wait("5").is_err());
    }
}

/// `mom hire`
#[derive(Args, Debug)]
pub(crate) struct HireArgs {
    /// The agent's channel
    pub(crate) agent: String,
    /// The message by which it is asked: what it can be hired for
    pub(crate) verb: String,
    /// The task, as JSON: what is said beside the verb
    #[arg(value_name = "JSON", value_parser = task, default_value = "{}", hide_default_value = true)]
    pub(crate) task: Map,
    /// How long the agent may drive: 30s, 2m; at most 1h
    #[arg(long = "for", value_name = "TIME", default_value = "2m", value_parser = duration_within(Duration::from_millis(1)..=Duration::from_secs(3600)))]
    pub(crate) time: Duration,
    /// How many commands it may send; as many as it likes unless said
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=10_000))]
    pub(crate) commands: Option<u64>,
    /// The token that guards the robot
    #[arg(long, value_name = "PATH", default_value = "/robot/token")]
    pub(crate) token: String,
    /// The robot's channel: it is stopped where the agent does not answer to Ctrl-C
    #[arg(long, value_name = "PATH", default_value = "/robot/arm")]
    pub(crate) robot: String,
    /// Wait in the token's queue for at most so many seconds
    #[arg(long, value_name = "SECONDS")]
    pub(crate) wait: Option<u64>,
}

pub(super) const HIRE: &str = "\
What an agent can be hired for, its author says. It tells how far it is, and gives the token back when it has ended.

Examples:
  mom hire /waving wave
  mom hire /waving wave --for 1m --commands 10      it loses the token after a minute, or 10 commands
  mom hire /calibrate calibrate '{\"camera\": \"x\", \"poses\": 20}' --for 5m
  mom hire /waving wave --token /newbot/token --robot /newbot/robot

Ctrl-C takes the token back at once; the hub halts the robot. Where the agent does not answer to it within a second, the robot is stopped,
until a user lets it go (mom unstop).";

fn task(text: &str) -> Result<Map, String> {
    let wrong = |error: &dyn std::fmt::Display| {
        format!("a task is a map in JSON, quoted for the shell, such as '{{\"times\": 3}}': {error}")
    };
    match serde_json::from_str::<Value>(text) {
        Ok(Value::Map(map)) => Ok(map),
        Ok(_) => Err(wrong(&"this is not a map")),
        Err(error) => Err(wrong(&error)),
    }
}
