//! The model server of the lab as a program of its own.

use std::ffi::OsString;

use crate::{Kind, ModelOptions, peer};
use anyhow::Context;
use clap::Parser;
use mom_program::{HubArgs, begin, shutdown};

const EXAMPLES: &str = "\
Examples:
  MOM_PASSWORD=model mom-model
  mom-model --hub bin://lab.example.org --key model.key
  MOM_PASSWORD=model mom-model --camera /camera/top --object die:16:f1c428 --object red:40:c82828

It looks for blocks of these colours in the images of cameras that stand and tell their matrix (mom calibrate). The
password is that of MOM_PASSWORD, unless --password-file names a file. A key (mom keygen) is taken from anywhere, a
password over TLS (bins://, tcps://) or loopback. Where there is no hub yet it waits. The log goes to the standard error; RUST_LOG says how much of it. Ctrl-C and SIGTERM end the program.";

/// The model server of the demonstration lab: says where the objects are, by what the cameras see.
#[derive(Debug, Parser)]
#[command(name = "mom-model", version, after_help = EXAMPLES, mut_arg("user", |user| user.default_value("model")))]
struct ModelArgs {
    #[command(flatten)]
    hub: HubArgs,
    /// The channel in which it tells; the tokens beside it are those of single objects
    #[arg(long, value_name = "PATH", default_value = "/model/objects")]
    channel: String,
    /// The channel of a camera by which it sees; may be repeated, and stands for the lab's three
    #[arg(long, value_name = "PATH")]
    camera: Vec<String>,
    /// The channel of the robot, which says what it holds
    #[arg(long, value_name = "PATH", default_value = "/robot/arm")]
    robot: String,
    /// The token whose owner writes all objects
    #[arg(long, value_name = "PATH", default_value = "/robot/token")]
    token: String,
    /// A cube to look for: its name, its size in mm, its colour; may be repeated, and stands for the lab's three
    #[arg(long, value_name = "NAME:MM:RRGGBB", value_parser = kind)]
    object: Vec<Kind>,
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
    let Some(args) = begin::<ModelArgs>(args, "info")? else {
        return Ok(());
    };
    let mut shutdown = Box::pin(shutdown()?);
    let login = args.hub.login("mom-model", env!("CARGO_PKG_VERSION"))?;
    let Some(client) = args.hub.connect(login, &mut shutdown).await? else {
        return Ok(());
    };
    peer::run(client, options(args), shutdown)
        .await
        .context("the model ended")
}

fn options(args: ModelArgs) -> ModelOptions {
    let lab = ModelOptions::default();
    ModelOptions {
        channel: args.channel,
        cameras: if args.camera.is_empty() {
            lab.cameras
        } else {
            args.camera
        },
        robot: args.robot,
        token: args.token,
        kinds: if args.object.is_empty() {
            lab.kinds
        } else {
            args.object
        },
    }
}

/// `red:40:c82828`.
fn kind(text: &str) -> Result<Kind, String> {
    let wrong = || "an object is its name, its size in mm and its colour: red:40:c82828".to_owned();
    let parts: Vec<&str> = text.split(':').collect();
    let [name, size, digits] = parts[..] else {
        return Err(wrong());
    };
    let size: f64 = size.parse().map_err(|_| wrong())?;
    let plain = digits.len() == 6 && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    if name.is_empty() || !(5.0..=500.0).contains(&size) || !plain {
        return Err(wrong());
    }
    let byte = |i: usize| u8::from_str_radix(&digits[i..i + 2], 16).map_err(|_| wrong());
    Ok(Kind {
        name: name.to_owned(),
        size,
        colour: [byte(0)?, byte(2)?, byte(4)?],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_to_look_for() {
        let red = kind("red:40:c82828").unwrap();
        assert_eq!(
            (red.name.as_str(), red.size, red.colour),
            ("red", 40.0, [200, 40, 40])
        );
        for wrong in [
            "red",
            "red:40",
            "red:x:c82828",
            "red:4000:c82828",
            ":40:c82828",
            "red:40:ééé",
            "red:40:c8282",
        ] {
            assert!(kind(wrong).is_err(), "{wrong}");
        }
    }
}
