//! `mom servo`: gives the agent the robot's token for one task, and takes it back.

use std::future::Future;
use std::time::Duration;

use mom_agent::Hire;
use mom_client::{Client, Map, from_value};
use mom_drive::{Tell, VerbFailure};
use mom_pages::duration_within;

use crate::peer::report::Report;
use crate::task::{Side, Task};

/// Have the visual-servoing agent put one block beside another: give it the robot's token with a scope, and take it back
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct VerbArgs {
    /// The block that is moved, by its colour: red, green, blue, ...
    pub first: String,
    /// The block beside which it is put
    pub second: String,
    /// On which side of the second: right, left, front or back
    #[arg(long, default_value = "right")]
    pub side: Side,
    /// mm between their faces, 5 to 200
    #[arg(long, value_name = "MM", default_value = "20")]
    pub gap: f64,
    /// How long the agent may drive: 30s, 2m; at most 1h
    #[arg(long = "for", value_name = "TIME", default_value = "2m", value_parser = duration_within(Duration::from_millis(1)..=Duration::from_secs(3600)))]
    pub time: Duration,
    /// How many commands it may send
    #[arg(long, value_name = "N", default_value_t = 120, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    pub commands: u64,
    /// The agent's channel
    #[arg(long, value_name = "PATH", default_value = "/servo")]
    pub agent: String,
    /// The token that guards the robot
    #[arg(long, value_name = "PATH", default_value = "/robot/token")]
    pub token: String,
    /// The robot's channel: it is stopped where the agent does not answer to Ctrl-C
    #[arg(long, value_name = "PATH", default_value = "/robot/arm")]
    pub robot: String,
    /// Wait in the token's queue for at most so many seconds
    #[arg(long, value_name = "SECONDS")]
    pub wait: Option<u64>,
}

const EXAMPLES: &str = "\
The agent works from the images of the cameras that stand: it takes the first block, puts it beside the second, looks, and
does so again until it is within 3 mm of its place. The side is that of the second block's face that looks most that way.
Its progress: what it does, the error as the images tell it, how old they are, and the time from a command to its effect.

Examples:
  mom servo red green
  mom servo red green --side left --gap 30
  mom servo blue red --for 1m --commands 40     it loses the token after a minute, or 40 commands
  mom servo red green --json | jq .mm

Ctrl-C takes the token back at once; the hub halts the robot, and the last line says where the block is. Where the agent does not answer
to it within a second, the robot is stopped, until a user lets it go (mom unstop), and 5 s after Ctrl-C this ends: the agent has the
token still, until the hub misses it or its scope is over.";

/// Works until the blocks are aligned, or `interrupt` is. The caller closes the client.
///
/// # Errors
///
/// [`VerbFailure`]; whatever happened, the token is released, unless another peer has it.
pub async fn run(
    args: &VerbArgs,
    client: &Client,
    interrupt: impl Future<Output = ()>,
    tell: Tell<'_>,
) -> Result<(), VerbFailure> {
    let task = Task::new(&args.first, &args.second, args.side, args.gap).map_err(VerbFailure::plain)?;
    let hire = Hire {
        channel: &args.agent,
        user: Some("servo"),
        absent: "start it: MOM_PASSWORD=servo mom-servo; mom lab has one of its own",
        verb: "align",
        task: task.to_map(),
        words: format!("put {} beside {}", args.first, args.second),
        token: &args.token,
        wait: args.wait.map(Duration::from_secs),
        time: args.time,
        commands: Some(args.commands),
        robot: &args.robot,
        untouched: format!("{} was not touched", args.first),
        line,
    };
    hire.carry_out(client, interrupt, tell).await
}

/// How far the agent is.
fn line(report: &Map) -> String {
    let report = from_value::<Report>(report.clone().into());
    report.map_or_else(|_| "working".to_owned(), |report| report.line())
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;

    #[derive(Debug, clap::Parser)]
    struct Line {
        #[command(flatten)]
        args: VerbArgs,
    }

    #[test]
    fn defaults_and_limits() {
        let args = Line::try_parse_from(["servo", "red", "green"]).unwrap().args;
        assert_eq!(
            (args.side, args.gap, args.time, args.commands),
            (Side::Right, 20.0, Duration::from_secs(120), 120)
        );
        for (option, value, words) in [
            ("--side", "above", "is not a side: right, left, front or back"),
            ("--for", "2d", "a time must be a number with ms, s, m or h"),
            ("--for", "0s", "it must be a time from 1ms to 1h"),
            ("--commands", "0", "0 is not in 1..=10000"),
        ] {
            let error = Line::try_parse_from(["servo", "red", "green", option, value]).unwrap_err();
            assert!(error.to_string().contains(words), "{error}");
        }
    }
}
