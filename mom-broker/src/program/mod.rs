//! The command line: one file per command.

mod check;
mod explain;
mod passwd;
mod schema;
mod serve;
mod watch;

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
  mom-broker schema > mom.schema.json        the shape of the configuration, for editors";

/// The MOM broker: the hub to which robots, cameras, agents and people connect.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    serve: serve::Args,
}

#[derive(Subcommand)]
enum Command {
    /// Say whether a configuration file is right, and where not; show its contexts, and what looks like a mistake.
    Check(check::Args),
    /// Say what a user may do where, and by which rule of the configuration.
    Explain(explain::Args),
    /// Hash a password, from MOM_PASSWORD, a prompt or standard input, for the users file.
    Passwd(passwd::Args),
    /// Print the JSON schema of the configuration file, by which editors complete and check it.
    Schema(schema::Args),
}

/// Runs what the command line says.
pub(crate) fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = match &cli.command {
        Some(Command::Check(args)) => return report(check::run(args)),
        Some(Command::Explain(args)) => explain::run(args),
        Some(Command::Passwd(args)) => passwd::run(args),
        Some(Command::Schema(args)) => schema::run(args),
        None => serve::run(&cli.serve),
    };
    report(result.map(|()| ExitCode::SUCCESS))
}

fn report(result: Result<ExitCode>) -> ExitCode {
    result.unwrap_or_else(|error| {
        // Standard error may be closed; the exit code says it all the same.
        let _ = writeln!(std::io::stderr(), "mom-broker: {error:#}");
        ExitCode::FAILURE
    })
}

/// What people would read of a value of the wire: text without quotes.
fn words(value: &mom_proto::Value) -> String {
    match value {
        mom_proto::Value::String(text) => text.clone(),
        other => serde_json::to_string(other).unwrap_or_default(),
    }
}
