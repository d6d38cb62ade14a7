//! `mom hire`: asks an agent for a task, lends it the token for that, and takes the token back.

use std::time::Duration;

use mom_agent::Hire;
use mom_client::{Client, Map, Value, visible};
use mom_pages::Interrupt;

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::Failure;
use crate::output::Output;

pub(crate) async fn run(args: &cli::HireArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Driving).await?;
    let hired = hire(args, &client, output).await;
    client.close().await;
    hired
}

/// Works until the agent has ended, or Ctrl-C.
async fn hire(args: &cli::HireArgs, client: &Client, output: Output) -> Result<(), Failure> {
    let mut interrupt = Interrupt::install()?;
    let mut tell = |json, line| output.tell(|| json, || line);
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
    let hired = hire.carry_out(client, interrupt.wait(), &mut tell).await;
    hired.map_err(Failure::from)
}

/// Letters of what an agent says that are shown.
const TEXT: usize = 500;

/// How far the agent is, in its own words.
fn line(report: &Map) -> String {
    let text = report.get("text").and_then(Value::as_str);
    match text.filter(|text| !text.is_empty()) {
        Some(text) => format!(
            "working: {}",
            visible(&text.chars().take(TEXT).collect::<String>())
        ),
        None => "working".to_owned(),
    }
}
