//! The model server of the lab as a program of its own.

use std::future::Future;
use std::io::IsTerminal;
use std::path::PathBuf;
use std::pin::pin;
use std::time::Duration;

use anyhow::{Context, anyhow};
use clap::Parser;
use mom_client::{Client, Identity, Key, Proof};
use mom_model::{Kind, ModelOptions, peer};
use tokio::signal::unix::{SignalKind, signal};
use tracing_subscriber::EnvFilter;

/// For how long the hub keeps its place when the connection is lost.
const GRACE: Duration = Duration::from_secs(30);

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
#[command(name = "mom-model", version, after_help = EXAMPLES)]
struct ModelArgs {
    /// The hub, as bin://host:port (binary) or tcp://host:port (XML), bins:// or tcps:// with TLS, which may end in ?pin=FINGERPRINT
    #[arg(long, env = "MOM_HUB", default_value = "bin://127.0.0.1:7666")]
    hub: String,
    /// If the hub cannot be reached, report why to it by plain HTTP, which may get through; for mom logs
    #[arg(long, env = "MOM_REPORT", value_parser = clap::builder::FalseyValueParser::new())]
    report: bool,
    /// The user to log in as
    #[arg(long, default_value = "model")]
    user: String,
    /// A file whose first line is the password
    #[arg(long, value_name = "FILE", conflicts_with = "key")]
    password_file: Option<PathBuf>,
    /// A file with the private key of the user, as mom keygen makes it; it needs no password
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// A certificate of the user (PEM), whose private key --key names, for a hub over TLS
    #[arg(long, value_name = "FILE", requires = "key")]
    certificate: Option<PathBuf>,
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

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    if let Some(written) = mom_pages::asked::<ModelArgs>() {
        return Ok(written?);
    }
    let args = ModelArgs::parse();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    let mut shutdown = pin!(shutdown()?);
    let mut builder = Client::builder(&args.hub)
        .user(&args.user)
        .proof(proof(&args)?)
        .link(GRACE)
        .wait_for_hub();
    if args.report {
        builder = builder.report_failures("mom-model", env!("CARGO_PKG_VERSION"));
    }
    let connected = tokio::select! {
        connected = builder.connect() => connected,
        () = &mut shutdown => return Ok(()),
    };
    let client = connected.with_context(|| format!("{} cannot log in at {}", args.user, args.hub))?;
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

/// Authenticates by key if there is one.
fn proof(args: &ModelArgs) -> anyhow::Result<Proof> {
    match (&args.key, &args.certificate) {
        (Some(key), Some(certificate)) => Ok(Proof::Certificate(Identity {
            certificate: certificate.clone(),
            key: key.clone(),
        })),
        (Some(file), None) => Ok(Proof::Key(Key::from_file(file).context("--key")?)),
        (None, _) => password(args).map(Proof::Password),
    }
}

fn password(args: &ModelArgs) -> anyhow::Result<String> {
    let Some(file) = &args.password_file else {
        return std::env::var("MOM_PASSWORD")
            .map_err(|_| anyhow!("set MOM_PASSWORD, or name a file with --password-file or --key"));
    };
    let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    Ok(text.lines().next().unwrap_or_default().to_owned())
}

/// Done at Ctrl-C or SIGTERM.
fn shutdown() -> anyhow::Result<impl Future<Output = ()>> {
    let mut interrupt = signal(SignalKind::interrupt()).context("cannot listen for Ctrl-C")?;
    let mut terminate = signal(SignalKind::terminate()).context("cannot listen for SIGTERM")?;
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
        tracing::info!("ending");
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
