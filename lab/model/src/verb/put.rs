//! `mom put red on blue`.

use std::future::Future;

use mom_client::Client;
use mom_drive::{Tell, VerbFailure};

use super::{DriveArgs, carry, word};
use crate::plan::Goal;

/// Put an object on another one: the arm takes it from above, carries it there, and lets it go
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct VerbArgs {
    /// The object, by its name
    pub what: String,
    /// The word on
    #[arg(value_parser = word("on"))]
    pub on: String,
    /// The object that it is to lie on
    pub target: String,
    #[command(flatten)]
    drive: DriveArgs,
}

const EXAMPLES: &str = "\
It asks the model where the objects are, plans the way, and refuses before anything moves if an object is not there, is
held, was not seen for 2 s or has something on it, or if the open jaws have no room. Then it grabs the robot's token, drives,
and waits until the cameras see the object there.

Examples:
  mom put red on blue
  mom put green on red --wait 300          when it is your turn
  mom put red on blue --json | jq .off

Ctrl-C ends it: the hub halts the robot, and the last line says where the object is.";

/// Puts it there, or says where it is. The caller closes the client.
///
/// # Errors
///
/// [`VerbFailure`]; whatever happened, the token is released, unless it was lost.
pub async fn run(
    args: &VerbArgs,
    client: &Client,
    interrupt: impl Future<Output = ()>,
    tell: Tell<'_>,
) -> Result<(), VerbFailure> {
    let goal = Goal::On(args.target.clone());
    carry::run(&args.drive, &args.what, &goal, client, interrupt, tell).await
}
