//! The gateway of a fleet as a program of its own.

use std::future::Future;
use std::io::IsTerminal;
use std::path::PathBuf;
use std::pin::pin;
use std::time::Duration;

use anyhow::{Context, anyhow};
use clap::Parser;
use mom_base_station::fleet::Fleet;
use mom_base_station::station::Station;
use mom_brs::file;
use mom_client::{Builder, Client, Identity, Key, Proof};
use mom_gateway::{GatewayOptions, connections, lines, run, settings};
use tokio::signal::unix::{SignalKind, signal};
use tracing_subscriber::EnvFilter;

/// For how long the hub keeps its place when the connection is lost.
const GRACE: Duration = Duration::from_secs(30);

const EXAMPLES: &str = "\
Examples:
  MOM_PASSWORD=gateway mom-gateway --fleet fleet.toml --manager robot-token
  mom-gateway --fleet fleet.toml --hub bin://lab.example.org --key gateway.key
  MOM_PASSWORD=gateway mom-gateway --fleet fleet.toml --together /fleet/token

The file of the fleet is that of mom-base-station, and mom-linuxbot --write-fleet writes one. The password is that of MOM_PASSWORD, unless
--password-file names a file. A key (mom keygen) is taken from anywhere, a password over TLS (bins://, tcps://) or loopback. Where there is no
hub yet it waits. The log goes to the standard error; RUST_LOG says how much of it. Ctrl-C and SIGTERM halt the robots and end the program.";

/// The gateway of a fleet: makes robots that a base station drives devices of a hub, each with a channel and a token.
#[derive(Debug, Parser)]
#[command(name = "mom-gateway", version, after_help = EXAMPLES)]
struct GatewayArgs {
    /// Which robots listen where: [[robot]] with unit = 1 and address = "192.168.1.11:4000"
    #[arg(long, value_name = "FILE")]
    fleet: PathBuf,
    /// Commands that the robots know beside the paper's four; without it: those of mom-linuxbot
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    /// The session of the fleet: robot 7 is there in 7/robot, and its token 7/token
    #[arg(long, value_name = "PATH", default_value = "/fleet")]
    session: String,
    /// The manager of the robots' tokens, by its name in the hub's configuration; without it: that of the session
    #[arg(long, value_name = "NAME")]
    manager: Option<String>,
    /// One token for all robots, which are driven together; without it each group of the file has its own, as has each robot of none
    #[arg(long, value_name = "PATH")]
    together: Option<String>,
    /// The hub, as bin://host:port (binary) or tcp://host:port (XML), bins:// or tcps:// with TLS, which may end in ?pin=FINGERPRINT
    #[arg(long, env = "MOM_HUB", default_value = "bin://127.0.0.1:7666")]
    hub: String,
    /// If the hub cannot be reached, report why to it by plain HTTP, which may get through; for mom logs
    #[arg(long, env = "MOM_REPORT", value_parser = clap::builder::FalseyValueParser::new())]
    report: bool,
    /// The user to log in as
    #[arg(long, default_value = "gateway")]
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
}

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    if let Some(written) = mom_pages::asked::<GatewayArgs>() {
        return Ok(written?);
    }
    let args = GatewayArgs::parse();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    let mut shutdown = pin!(shutdown()?);
    // With a mistake in a file nothing is started.
    let fleet =
        Fleet::parse(&read(&args.fleet)?).map_err(|error| anyhow!("{}:{error}", args.fleet.display()))?;
    let options = options(&args)?;
    let mut clients = Vec::new();
    for _ in 0..connections(fleet.robots().len()) {
        let connected = tokio::select! {
            connected = builder(&args)?.connect() => connected,
            () = &mut shutdown => return Ok(()),
        };
        clients.push(connected.with_context(|| format!("{} cannot log in at {}", args.user, args.hub))?);
    }
    let station = Station::new(&fleet, options.table, settings());
    let lines = lines(&station);
    station.connect_all();
    let ended = run(clients, lines, options, shutdown).await;
    let left = station.halt().await;
    station.close().await;
    if !left.is_empty() {
        tracing::error!(units = ?left, "these robots may be moving: they were not told to stand in time");
    }
    ended.context("the gateway ended")
}

fn builder(args: &GatewayArgs) -> anyhow::Result<Builder> {
    let builder = Client::builder(&args.hub)
        .user(&args.user)
        .proof(proof(args)?)
        .link(GRACE)
        .wait_for_hub();
    Ok(match args.report {
        true => builder.report_failures("mom-gateway", env!("CARGO_PKG_VERSION")),
        false => builder,
    })
}

fn options(args: &GatewayArgs) -> anyhow::Result<GatewayOptions> {
    let mut options = GatewayOptions {
        session: args.session.clone(),
        together: args.together.clone(),
        manager: args.manager.clone(),
        ..GatewayOptions::default()
    };
    if let Some(path) = &args.table {
        options.table = file::table(&read(path)?).map_err(|error| anyhow!("{}:{error}", path.display()))?;
    }
    Ok(options)
}

fn read(path: &std::path::Path) -> anyhow::Result<String> {
    std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

/// Authenticates by key if there is one.
fn proof(args: &GatewayArgs) -> anyhow::Result<Proof> {
    match (&args.key, &args.certificate) {
        (Some(key), Some(certificate)) => Ok(Proof::Certificate(Identity {
            certificate: certificate.clone(),
            key: key.clone(),
        })),
        (Some(file), None) => Ok(Proof::Key(Key::from_file(file).context("--key")?)),
        (None, _) => password(args).map(Proof::Password),
    }
}

fn password(args: &GatewayArgs) -> anyhow::Result<String> {
    let Some(file) = &args.password_file else {
        return std::env::var("MOM_PASSWORD")
            .map_err(|_| anyhow!("set MOM_PASSWORD, or name a file with --password-file or --key"));
    };
    Ok(read(file)?.lines().next().unwrap_or_default().to_owned())
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
