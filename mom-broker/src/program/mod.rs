//! The command line: one file per command.

mod check;
mod descriptors;
mod explain;
mod niceness;
#[cfg(feature = "otlp")]
mod otlp;
mod passwd;
#[cfg(target_os = "linux")]
mod ready;
mod schema;
mod serve;
mod watch;
mod what_if;

use std::io::Write;
use std::process::ExitCode;

use anyhow::Result;
use clap::{Parser, Subcommand};

const EXAMPLES: &str = "Examples:
  mom-broker --config config/lab.toml        run the demonstration lab's broker
  mom-broker check config/lab.toml           say whether a configuration is right, and where not
  mom-broker explain --config config/lab.toml --user alice --context /robot/token
                                             say what alice may do there, and by which rules
  mom-broker passwd alice                    ask for a password, print its line for the users file
  mom-broker passwd alice --users users.toml change or add the user in the file
  mom-broker schema > mom.schema.json        the shape of the configuration, for editors
  mom-broker what-if new.toml --log control.jsonl
                                             say what would have been decided by new.toml";

/// The MOM broker: the hub to which robots, cameras, agents and people connect.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct BrokerCli {
    #[command(subcommand)]
    command: Option<BrokerCommand>,
    #[command(flatten)]
    serve: serve::ServeArgs,
}

#[derive(Subcommand)]
enum BrokerCommand {
    /// Check a configuration file: errors with their lines, its contexts, and likely mistakes.
    Check(check::CheckArgs),
    /// Explain what a user may do in a context, and by which rule of the configuration.
    Explain(explain::ExplainArgs),
    /// Hash a password, from MOM_PASSWORD, a prompt or standard input, for the users file.
    Passwd(passwd::PasswdArgs),
    /// Print the JSON schema of the configuration file, for completion and checks in editors.
    Schema(schema::SchemaArgs),
    /// Decide a recording again by a changed configuration, and list what differs.
    WhatIf(what_if::WhatIfArgs),
}

/// Runs the command.
pub(crate) fn main() -> ExitCode {
    let args: Vec<_> = std::env::args_os().collect();
    if let Some(written) = mom_pages::asked::<BrokerCli>(&args) {
        return report(written.map(|()| ExitCode::SUCCESS).map_err(Into::into));
    }
    let cli = BrokerCli::parse_from(args);
    let result = match &cli.command {
        Some(BrokerCommand::Check(args)) => return report(check::run(args)),
        Some(BrokerCommand::Explain(args)) => explain::run(args),
        Some(BrokerCommand::Passwd(args)) => passwd::run(args),
        Some(BrokerCommand::Schema(args)) => schema::run(args),
        Some(BrokerCommand::WhatIf(args)) => return report(what_if::run(args)),
        None => serve::run(&cli.serve),
    };
    report(result.map(|()| ExitCode::SUCCESS))
}

fn report(result: Result<ExitCode>) -> ExitCode {
    result.unwrap_or_else(|error| {
        // Standard error may be closed; the exit code still reports the failure.
        let _ = writeln!(std::io::stderr(), "mom-broker: {error:#}");
        ExitCode::FAILURE
    })
}

/// A wire value for people: text without quotes.
fn words(value: &mom_proto::Value) -> String {
    match value {
        mom_proto::Value::String(text) => text.clone(),
        other => serde_json::to_string(other).unwrap_or_default(),
    }
}
