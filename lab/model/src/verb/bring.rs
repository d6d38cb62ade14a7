//! `mom bring green to 100 50`.

use std::future::Future;

use mom_client::Client;
use mom_drive::{Tell, VerbFailure};

use super::{DriveArgs, carry, word};
use crate::plan::Goal;

/// Bring an object to a place on the table
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct VerbArgs {
    /// The object, by its name
    pub what: String,
    /// The word to
    #[arg(value_parser = word("to"))]
    pub to: String,
    /// Along the table's x axis, mm
    #[arg(allow_hyphen_values = true, value_parser = millimetres)]
    pub x: f64,
    /// Along the table's y axis, mm
    #[arg(allow_hyphen_values = true, value_parser = millimetres)]
    pub y: f64,
    /// How it is to be turned about the vertical, degrees; otherwise as it is
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true, value_parser = degrees)]
    pub yaw: Option<f64>,
    #[command(flatten)]
    drive: DriveArgs,
}

const EXAMPLES: &str = "\
It asks the model where the object is, plans the way, and refuses before anything moves if it is not there, is held, was not
seen for 2 s or has something on it, or if there is no room. Then it grabs the robot's token, drives, and waits until the
cameras see the object there.

Examples:
  mom bring green to 100 50
  mom bring red to -150 100 --yaw 45

Ctrl-C ends it: the hub halts the robot, and the last line says where the object is.";

/// Brings it there, or says where it is. The caller closes the client.
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
    let goal = Goal::At {
        x: args.x,
        y: args.y,
        yaw: args.yaw,
    };
    carry::run(&args.drive, &args.what, &goal, client, interrupt, tell).await
}

fn millimetres(text: &str) -> Result<f64, String> {
    bounded(text, 10_000.0).ok_or_else(|| "it is a number of mm".to_owned())
}

fn degrees(text: &str) -> Result<f64, String> {
    bounded(text, 360.0).ok_or_else(|| "it is a number of degrees, -360 to 360".to_owned())
}

fn bounded(text: &str, most: f64) -> Option<f64> {
    let number: f64 = text.parse().ok()?;
    (number.abs() <= most).then_some(number)
}
