//! The visual-servoing agent as a program of its own.

use std::future::Future;
use std::io::IsTerminal;
use std::path::PathBuf;
use std::pin::pin;
use std::time::Duration;

use anyhow::{Context, anyhow};
use clap::Parser;
use mom_client::{Client, Identity, Key, Proof};
use mom_servo::peer::{self, ServoOptions};
use tokio::signal::unix::{SignalKind, signal};
use tracing_subscriber::EnvFilter;

/// For how long the hub keeps its place when the connection is lost.
const GRACE: Duration = Duration::from_secs(30);

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
#[command(name = "mom-servo", version, after_help = EXAMPLES)]
struct ServoArgs {
    /// The hub, as bin://host:port (binary) or tcp://host:port (XML), bins:// or tcps:// with TLS, which may end in ?pin=FINGERPRINT
    #[arg(long, env = "MOM_HUB", default_value = "bin://127.0.0.1:7666")]
    hub: String,
    /// If the hub cannot be reached, report why to it by plain HTTP, which may get through; for mom logs
    #[arg(long, env = "MOM_REPORT", value_parser = clap::builder::FalseyValueParser::new())]
    report: bool,
    /// The user to log in as
    #[arg(long, default_value = "servo")]
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

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    if let Some(written) = mom_pages::asked::<ServoArgs>() {
        return Ok(written?);
    }
    let args = ServoArgs::parse();
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
        builder = builder.report_failures("mom-servo", env!("CARGO_PKG_VERSION"));
    }
    let connected = tokio::select! {
        connected = builder.connect() => connected,
        () = &mut shutdown => return Ok(()),
    };
    let client = connected.with_context(|| format!("{} cannot log in at {}", args.user, args.hub))?;
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

/// Authenticates by key if there is one.
fn proof(args: &ServoArgs) -> anyhow::Result<Proof> {
    match (&args.key, &args.certificate) {
        (Some(key), Some(certificate)) => Ok(Proof::Certificate(Identity {
            certificate: certificate.clone(),
            key: key.clone(),
        })),
        (Some(file), None) => Ok(Proof::Key(Key::from_file(file).context("--key")?)),
        (None, _) => password(args).map(Proof::Password),
    }
}

fn password(args: &ServoArgs) -> anyhow::Result<String> {
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
