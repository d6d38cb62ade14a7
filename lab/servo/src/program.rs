//! The visual-servoing agent as a program of its own.

use std::ffi::OsString;

use crate::peer::{self, ServoOptions};
use anyhow::Context;
use clap::Parser;
use mom_program::{HubArgs, begin, shutdown};

const EXAMPLES: &str = "\
Examples:
  MOM_PASSWORD=servo mom-servo
  mom-servo --hub bins://lab.example.org --key servo.key
  MOM_PASSWORD=servo mom-servo --camera /camera/x --camera /camera/top

It waits in its channel for a task (mom servo red green), drives the robot only with the token that the task's user gives it, and
returns it. It needs two cameras that stand and tell their matrices. The password is that of MOM_PASSWORD, unless --password-file
names a file. A key (mom keygen) is taken from anywhere, a password over TLS (bins://, tcps://) or loopback. Where there is no hub
yet it waits. The log goes to the standard error; RUST_LOG says how much of it. Ctrl-C and SIGTERM end the program.";

/// The visual-servoing agent: puts one block beside another by camera images, with a token that a user gives it.
#[derive(Debug, Parser)]
#[command(name = "mom-servo", version, after_help = EXAMPLES, mut_arg("user", |user| user.default_value("servo")))]
struct ServoArgs {
    #[command(flatten)]
    hub: HubArgs,
    /// The agent's own channel
    #[arg(long, value_name = "PATH", default_value = "/servo")]
    channel: String,
    /// The robot's channel
    #[arg(long, value_name = "PATH", default_value = "/robot/arm")]
    robot: String,
    /// The token that guards the robot
    #[arg(long, value_name = "PATH", default_value = "/robot/token")]
    token: String,
    /// The channel of a camera that stands; may be given several times; /camera/x, /camera/y and /camera/top if none is
    #[arg(long, value_name = "PATH")]
    camera: Vec<String>,
}

/// Runs the program with these arguments, of which the first is its name, until it is done or told to end.
///
/// # Errors
///
/// What the program ends by; wrong arguments end the process.
pub fn run(args: Vec<OsString>) -> anyhow::Result<()> {
    mom_program::block_on(Box::pin(work(args)))
}

async fn work(args: Vec<OsString>) -> anyhow::Result<()> {
    let Some(args) = begin::<ServoArgs>(args, "info")? else {
        return Ok(());
    };
    let mut shutdown = Box::pin(shutdown()?);
    let login = args.hub.login("mom-servo", env!("CARGO_PKG_VERSION"))?;
    let Some(client) = args.hub.connect(login, &mut shutdown).await? else {
        return Ok(());
    };
    peer::run(client, options(&args), shutdown)
        .await
        .context("the agent ended")
}

fn options(args: &ServoArgs) -> ServoOptions {
    let lab = ServoOptions::default();
    ServoOptions {
        channel: args.channel.clone(),
        robot: args.robot.clone(),
        token: args.token.clone(),
        cameras: match args.camera.is_empty() {
            true => lab.cameras,
            false => args.camera.clone(),
        },
    }
}
