//! The gateway of a fleet as a program of its own.

use std::ffi::OsString;
use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};

use crate::{Changes, FleetFile, GatewayOptions, Taking, connections, lines, settings};
use anyhow::{Context, anyhow};
use clap::Parser;
use mom_base_station::fleet::Fleet;
use mom_base_station::station::Station;
use mom_brs::file;
use mom_program::{HubArgs, begin, shutdown_but_hangup};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::{mpsc, watch};

const EXAMPLES: &str = "\
Examples:
  MOM_PASSWORD=gateway mom-gateway --fleet fleet.toml --manager robot-token
  mom-gateway --fleet fleet.toml --hub bin://lab.example.org --key gateway.key
  MOM_PASSWORD=gateway mom-gateway --fleet fleet.toml --together /fleet/token

The file of the fleet is that of mom-base-station, and mom-linuxbot --write-fleet writes one. The password is that of MOM_PASSWORD, unless
--password-file names a file. A key (mom keygen) is taken from anywhere, a password over TLS (bins://, tcps://) or loopback. Where there is no
hub yet it waits. The log goes to the standard error; RUST_LOG says how much of it. SIGHUP has the file of
the fleet read again. Ctrl-C and SIGTERM halt the robots and end the program.";

/// The gateway of a fleet: makes robots that a base station drives devices of a hub, each with a channel and a token.
#[derive(Debug, Parser)]
#[command(name = "mom-gateway", version, after_help = EXAMPLES, mut_arg("user", |user| user.default_value("gateway")))]
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
    #[command(flatten)]
    hub: HubArgs,
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
    let Some(args) = begin::<GatewayArgs>(args, "info")? else {
        return Ok(());
    };
    let shutdown = shutdown_but_hangup()?;
    // Before the hub is reached, too, which may take long.
    let hangup = signal(SignalKind::hangup()).context("cannot listen for SIGHUP")?;
    // With a mistake in a file nothing is started.
    let fleet =
        Fleet::parse(&read(&args.fleet)?).map_err(|error| anyhow!("{}:{error}", args.fleet.display()))?;
    let options = options(&args)?;
    let (taken, fleets) = mpsc::channel(1);
    let (path, follower) = (args.fleet.clone(), taken.clone());
    let mut ends = Box::pin(async move {
        tokio::select! {
            () = shutdown => {}
            () = follow(&path, hangup, follower) => {}
        }
    });
    let mut clients = Vec::new();
    for _ in 0..connections(fleet.robots().len()) {
        let login = args.hub.login("mom-gateway", env!("CARGO_PKG_VERSION"))?;
        let Some(client) = args.hub.connect(login, &mut ends).await? else {
            return Ok(());
        };
        clients.push(client);
    }
    let station = Station::new(&fleet, options.table, settings());
    let lines = lines(&station);
    station.connect_all();
    let changes = Changes {
        station: station.clone(),
        fleets,
        present: watch::channel(fleet).0,
        file: Some(FleetFile {
            path: args.fleet,
            taken,
        }),
    };
    let ended = crate::run(clients, lines, options, Some(changes), ends).await;
    let left = station.halt().await;
    station.close().await;
    if !left.is_empty() {
        tracing::error!(units = ?left, "these robots may be moving: they have not confirmed their stop");
    }
    ended.context("the gateway ended")
}

/// Reads the fleet's file again at each SIGHUP; done when that came as the program's terminal is gone.
async fn follow(path: &Path, mut hangup: Signal, taken: mpsc::Sender<Taking>) {
    let had_terminal = std::io::stderr().is_terminal();
    while hangup.recv().await.is_some() {
        if had_terminal && !std::io::stderr().is_terminal() {
            return;
        }
        tracing::info!("SIGHUP: reading the fleet's file again");
        let fleet = read(path)
            .and_then(|text| Fleet::parse(&text).map_err(|error| anyhow!("{}:{error}", path.display())));
        match fleet {
            Ok(fleet) => {
                // It is gone when the program ends.
                let _ = taken.send(Taking { fleet, told: None }).await;
            }
            Err(error) => tracing::error!("{error:#}; the fleet stays as it was"),
        }
    }
    std::future::pending::<()>().await;
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

fn read(path: &Path) -> anyhow::Result<String> {
    mom_base_station::edit::read(path).with_context(|| format!("cannot read {}", path.display()))
}
