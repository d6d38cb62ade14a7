//! The gateway of thin robots as a program of its own.

use std::ffi::OsString;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use crate::{RobotLine, Simulacrum, SimulacrumOptions, chassis, serve};
use anyhow::{Context, anyhow};
use clap::Parser;
use mom_program::{HubArgs, begin, shutdown};
use mom_rsp::middle::Settings;
use mom_rsp::{Key, PERIODS};
use mom_rsp_model::Model;
use mom_wheels::Chassis;
use tokio::net::UdpSocket;
use tokio::sync::watch;
use tokio::task::JoinSet;

const EXAMPLES: &str = "\
Examples:
  MOM_PASSWORD=gateway mom-simulacrum --model config/cubo.toml --robot /cubo=192.168.1.20:7700 --robot-key cubo.key
  mom-simulacrum --model config/cubo.toml --robot /fleet/12=127.0.0.1:7700 --user gateway --key gateway.key
  MOM_PASSWORD=gateway mom-simulacrum --model config/cubo.toml --robot /cubo=127.0.0.1:7700 --period 20-40 --paper

A robot is the session that --robot names, with the channels robot and simulacrum and the token token, which are made where they are missing.
The owner of the token drives it with set, do, activate and, if it has wheels, as the robots of a fleet (mom run --help). A robot's key is 32
bytes as 64 hexadecimal digits, the first line of its file; mom-cubo --write-key makes one. Without a key packets travel in the open, which
is for loopback and trials. The password is that of MOM_PASSWORD, unless --password-file names a file. Where there is no hub yet it waits.
The log goes to the standard error; RUST_LOG says how much of it. Ctrl-C and SIGTERM have the robots take their safe values and end the program.";

/// The computer that thinks for thin robots: mirrors them over RSP, and makes them devices of a hub.
#[derive(Debug, Parser)]
#[command(name = "mom-simulacrum", version, after_help = EXAMPLES, mut_arg("user", |user| user.default_value("gateway")))]
struct SimulacrumArgs {
    /// The model of the robots
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    /// A robot: its session at the hub, and where it listens; may be given several times
    #[arg(long = "robot", value_name = "PATH=ADDRESS:PORT", required = true, value_parser = place)]
    robots: Vec<(String, SocketAddr)>,
    /// A file with the key that these robots share with this program
    #[arg(long, value_name = "FILE")]
    robot_key: Option<PathBuf>,
    /// Time between two packets, ms; that of the model without it. Of two, 20-40, the middle chooses by the loss and
    /// the delay that it measures
    #[arg(long, value_name = "MS[-MS]", value_parser = periods)]
    period: Option<RangeInclusive<u16>>,
    /// ms without a packet after which a robot is lost
    #[arg(long, value_name = "MS", default_value = "500", value_parser = clap::value_parser!(u16).range(50..=10_000))]
    silence: u16,
    /// mm between the wheels of these robots, by which the middle plans turns
    #[arg(long, value_name = "MM", default_value_t = Chassis::CUBO.wheel_base)]
    wheel_base: f64,
    /// To the letter of the paper, without a watchdog and without a key
    #[arg(long, conflicts_with = "robot_key")]
    paper: bool,
    /// The manager of the robots' tokens, by its name in the hub's configuration; without it: that of the session
    #[arg(long, value_name = "NAME")]
    manager: Option<String>,
    #[command(flatten)]
    hub: HubArgs,
}

/// One period, or the shortest and the longest.
fn periods(text: &str) -> anyhow::Result<RangeInclusive<u16>> {
    let (least, most) = text.split_once('-').unwrap_or((text, text));
    let ms = |word: &str| word.trim().parse::<u16>().ok().filter(|ms| PERIODS.contains(ms));
    match (ms(least), ms(most)) {
        (Some(least), Some(most)) if least <= most => Ok(least..=most),
        _ => anyhow::bail!(
            "a period is from 1 to 200 ms, such as 40, or two of them, the shorter first, such as 20-40"
        ),
    }
}

fn place(text: &str) -> anyhow::Result<(String, SocketAddr)> {
    let (path, address) = text
        .split_once('=')
        .context("a robot is its session and its address: /cubo=127.0.0.1:7700")?;
    mom_client::Path::parse(path)
        .with_context(|| format!("{path:?} is not a path of a context; one is such as /cubo"))?;
    let address = address
        .parse()
        .with_context(|| format!("{address:?} is not an address with a port, such as 127.0.0.1:7700"))?;
    Ok((path.to_owned(), address))
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
    let Some(args) = begin::<SimulacrumArgs>(args, "info")? else {
        return Ok(());
    };
    let mut shutdown = Box::pin(shutdown()?);
    let login = args.hub.login("mom-simulacrum", env!("CARGO_PKG_VERSION"))?;
    let (lines, sockets) = robots(&args).await?;
    let Some(client) = args.hub.connect(login, &mut shutdown).await? else {
        return Ok(());
    };
    let (stop, stopping) = watch::channel(false);
    let mut links = JoinSet::new();
    for (line, socket) in lines.iter().zip(sockets) {
        let (robot, mut stopping) = (line.robot.clone(), stopping.clone());
        links.spawn(async move {
            serve(robot, socket, async move {
                let _ = stopping.wait_for(|stop| *stop).await;
            })
            .await
        });
    }
    let options = SimulacrumOptions {
        manager: args.manager,
    };
    let ended = tokio::select! {
        ended = crate::run(client, lines, options, shutdown) => ended,
        // Without its socket a robot is out of reach, and the supervisor may restart this program.
        Some(link) = links.join_next() => {
            link?.context("a robot's socket failed")?;
            anyhow::bail!("a robot's link has ended");
        }
    };
    let _ = stop.send(true);
    while let Some(link) = links.join_next().await {
        link?.context("a robot's socket failed")?;
    }
    ended.context("the gateway ended")
}

/// The mirrors of all robots, and a socket for each.
async fn robots(args: &SimulacrumArgs) -> anyhow::Result<(Vec<RobotLine>, Vec<UdpSocket>)> {
    // With a mistake in a file nothing is started.
    let model =
        Model::read(&read(&args.model)?).map_err(|error| anyhow!("{}: {error}", args.model.display()))?;
    let chassis = chassis(&model, args.wheel_base).context("--wheel-base and the model's wheels")?;
    let settings = Settings {
        key: args.robot_key.as_deref().map(key).transpose()?,
        period: args
            .period
            .as_ref()
            .map_or(model.period(), |range| *range.start()),
        paper: args.paper,
        silence: args.silence,
        ..Settings::default()
    };
    let (mut lines, mut sockets) = (Vec::new(), Vec::new());
    for (path, address) in &args.robots {
        let any = match address {
            SocketAddr::V4(_) => SocketAddr::from((Ipv4Addr::UNSPECIFIED, 0)),
            SocketAddr::V6(_) => SocketAddr::from((Ipv6Addr::UNSPECIFIED, 0)),
        };
        let socket = UdpSocket::bind(any).await?;
        // What comes from elsewhere is dropped by the system.
        socket
            .connect(address)
            .await
            .with_context(|| format!("no route to {address}"))?;
        sockets.push(socket);
        let robot = Simulacrum::new(path, model.clone(), settings.clone())?;
        if let Some(range) = args.period.clone().filter(|range| range.start() < range.end()) {
            robot.choose_period(range);
        }
        lines.push(RobotLine {
            robot,
            path: path.clone(),
            chassis,
        });
    }
    Ok((lines, sockets))
}

/// 64 hexadecimal digits, the first line of the file.
fn key(file: &Path) -> anyhow::Result<Key> {
    let text = read(file)?;
    mom_rsp::key(text.lines().next().unwrap_or_default().trim())
        .with_context(|| format!("{}: a key is 64 hexadecimal digits", file.display()))
}

fn read(path: &Path) -> anyhow::Result<String> {
    std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}
