//! The robot arm of the lab as a program of its own.

use std::future::Future;
use std::io::IsTerminal;
use std::path::PathBuf;
use std::pin::pin;
use std::time::Duration;

use anyhow::{Context, anyhow};
use clap::Parser;
use mom_arm::controller::LinkFault;
use mom_arm::{ArmOptions, Mount, peer};
use mom_client::{Client, Identity, Key, Proof};
use tokio::signal::unix::{SignalKind, signal};
use tracing_subscriber::EnvFilter;

/// For how long the hub keeps its place when the connection is lost.
const GRACE: Duration = Duration::from_secs(30);

const EXAMPLES: &str = "\
Examples:
  MOM_PASSWORD=arm mom-arm
  mom-arm --hub tcp://127.0.0.1:7666 --password-file arm.secret
  mom-arm --hub bin://lab.example.org --key arm.key
  mom-arm --key arm.key --max-age 500ms
  MOM_PASSWORD=arm mom-arm --link-fault 30s/2s
  MOM_PASSWORD=arm mom-arm --zones /zone --mount 500,0,180
  RUST_LOG=debug MOM_PASSWORD=arm mom-arm --channel /robot/arm

The password is that of MOM_PASSWORD, unless --password-file names a file. A key (mom keygen) is taken from
anywhere, a password over TLS (bins://, tcps://) or loopback. Where there is no hub yet it waits. The log goes to the standard error; RUST_LOG says how much of it. Ctrl-C and SIGTERM halt the arm and end the program.";

/// The robot arm of the demonstration lab: obeys the scripts of the token's owner and tells its state.
#[derive(Debug, Parser)]
#[command(name = "mom-arm", version, after_help = EXAMPLES)]
struct ArmArgs {
    /// The hub, as bin://host:port (binary) or tcp://host:port (XML), bins:// or tcps:// with TLS, which may end in ?pin=FINGERPRINT
    #[arg(long, env = "MOM_HUB", default_value = "bin://127.0.0.1:7666")]
    hub: String,
    /// If the hub cannot be reached, report why to it by plain HTTP, which may get through; for mom logs
    #[arg(long, env = "MOM_REPORT", value_parser = clap::builder::FalseyValueParser::new())]
    report: bool,
    /// The user to log in as
    #[arg(long, default_value = "arm")]
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
    /// The channel of commands and states
    #[arg(long, value_name = "PATH", default_value = "/robot/arm")]
    channel: String,
    /// Refuse commands that are older than this when they begin, whatever their senders say: a time such as 500ms or 2s
    #[arg(long, value_name = "TIME", value_parser = time)]
    max_age: Option<Duration>,
    /// Let the simulated link to the controller fail (M53): it stands for the first time, is down for the second, again and again, such as 30s/2s
    #[arg(long, value_name = "UP/DOWN", value_parser = link_fault)]
    link_fault: Option<LinkFault>,
    /// Keep out of the zones that the commander does not own (M40): the tokens of this session, which tell their boxes
    #[arg(long, value_name = "PATH")]
    zones: Option<String>,
    /// Where the arm's table stands in the frame of the zones: mm, mm and degrees
    #[arg(long, value_name = "X,Y,YAW", default_value = "0,0,0", allow_hyphen_values = true, value_parser = clap::value_parser!(Mount))]
    mount: Mount,
    /// Let the simulated arm's time pass so many times as fast as real time, to try much in little time; 100 at most
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u32).range(1..=100))]
    pace: u32,
}

/// `500ms` or `2s`.
fn time(text: &str) -> anyhow::Result<Duration> {
    let (number, unit) = match text.strip_suffix("ms") {
        Some(number) => (number, 1e-3),
        None => (text.strip_suffix('s').unwrap_or_default(), 1.0),
    };
    let number: f64 = number
        .parse()
        .ok()
        .context("it must be a time such as 500ms or 2s")?;
    let time = Duration::try_from_secs_f64(number * unit)?;
    anyhow::ensure!(time >= Duration::from_millis(1), "it must be at least 1ms");
    Ok(time)
}

/// `30s/2s`.
fn link_fault(text: &str) -> anyhow::Result<LinkFault> {
    let (after, lasting) = text
        .split_once('/')
        .context("it must be two times, such as 30s/2s")?;
    let micros = |text: &str| anyhow::Ok(i64::try_from(time(text)?.as_micros())?);
    Ok(LinkFault {
        after: micros(after)?,
        lasting: micros(lasting)?,
    })
}

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    if let Some(written) = mom_pages::asked::<ArmArgs>() {
        return Ok(written?);
    }
    let args = ArmArgs::parse();
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
        builder = builder.report_failures("mom-arm", env!("CARGO_PKG_VERSION"));
    }
    let connected = tokio::select! {
        connected = builder.connect() => connected,
        () = &mut shutdown => return Ok(()),
    };
    let client = connected.with_context(|| format!("{} cannot log in at {}", args.user, args.hub))?;
    let options = ArmOptions {
        channel: args.channel,
        max_age: args.max_age,
        link_fault: args.link_fault,
        zones: args.zones,
        mount: args.mount,
        pace: args.pace,
    };
    peer::run(client, options, shutdown)
        .await
        .context("the arm ended")
}

/// Authenticates by key if there is one.
fn proof(args: &ArmArgs) -> anyhow::Result<Proof> {
    match (&args.key, &args.certificate) {
        (Some(key), Some(certificate)) => Ok(Proof::Certificate(Identity {
            certificate: certificate.clone(),
            key: key.clone(),
        })),
        (Some(file), None) => Ok(Proof::Key(Key::from_file(file).context("--key")?)),
        (None, _) => password(args).map(Proof::Password),
    }
}

fn password(args: &ArmArgs) -> anyhow::Result<String> {
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
