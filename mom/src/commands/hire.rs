//! `mom hire`: asks an agent for a task, lends it the token for that, and takes the token back.

use std::future::Future;
use std::time::Duration;

use mom_agent::Hire;
use mom_client::{Client, Map, Value, visible};
use mom_drive::{Tell, VerbFailure};
use mom_pages::duration_within;

/// Hire an agent for a task: lend it the token with a scope, follow it, and take the token back
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct VerbArgs {
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

const EXAMPLES: &str = "\
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

/// Works until the agent has ended, or `interrupt` is done. The caller closes the client.
pub(crate) async fn run(
    args: &VerbArgs,
    client: &Client,
    interrupt: impl Future<Output = ()>,
    tell: Tell<'_>,
) -> Result<(), VerbFailure> {
    let hire = Hire {
        channel: &args.agent,
        user: None,
        absent: "start the agent first",
        verb: &args.verb,
        task: args.task.clone(),
        words: args.verb.clone(),
        token: &args.token,
        wait: args.wait.map(Duration::from_secs),
        time: args.time,
        commands: args.commands,
        robot: &args.robot,
        untouched: "it has said nothing of its work".to_owned(),
        line,
    };
    hire.carry_out(client, interrupt, tell).await
}

/// How far the agent is, in its own words.
fn line(report: &Map) -> String {
    let text = report.get("text").and_then(Value::as_str);
    match text.filter(|text| !text.is_empty()) {
        Some(text) => format!("working: {}", visible(text)),
        None => "working".to_owned(),
    }
}
