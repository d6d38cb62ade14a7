//! The robot server of the fleet as a program of its own.
#![allow(clippy::print_stdout, reason = "it says where it listens")]

use std::ffi::OsString;
use std::fmt::Write as _;
use std::io::IsTerminal;
use std::net::{IpAddr, SocketAddr};
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::pin::pin;
use std::time::Duration;

use crate::{Access, Login, Options, Page, Robot, Rules, serve_observed, serve_page};
use anyhow::Context;
use clap::Parser;
use mom_brs::{Table, file};
use mom_pages::{Interrupt, duration_within};
use mom_trace::Trace;
use mom_wheels::{Chassis, Driver, Point, Pose, Simulated, Traced, Watchdog, WheelTime};
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::{JoinError, JoinSet};
use tracing_subscriber::EnvFilter;

const EXAMPLES: &str = "\
Examples:
  mom-linuxbot
  mom-linuxbot --listen 0.0.0.0:4000 --allow 192.168.1.5
  mom-linuxbot --robots 10 --listen 127.0.0.1:0 --write-fleet fleet.toml
  mom-linuxbot --robots 10 --only 9-10 --listen 127.0.0.1:0 --write-fleet last.toml --group scouts
  mom-linuxbot --watchdog 1s --battery 40
  mom-linuxbot --web 127.0.0.1:8080
  mom-linuxbot --listen 0.0.0.0:4000 --allow 192.168.1.5 --web 0.0.0.0:8080 --web-login page.secret
  mom-linuxbot --paper
  RUST_LOG=debug mom-linuxbot --table more-commands.toml

By hand, for those who can type: printf '06 00100 00100' | nc -q1 127.0.0.1 4000
The robot is a simulated one. The log goes to the standard error; RUST_LOG says how much of it. Ctrl-C and SIGTERM stop the motors and end the
program.";

/// A LinuxBot: a wheeled robot that one base station at a time drives over TCP.
#[derive(Debug, Parser)]
#[command(name = "mom-linuxbot", version, after_help = EXAMPLES)]
struct LinuxbotArgs {
    /// Where it listens; port 0 is any that is free. Of several robots each has the next port
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:4000")]
    listen: SocketAddr,
    /// Show the robot's own page, with what it sees, here by HTTP; ports as for --listen
    #[arg(long, value_name = "ADDRESS:PORT")]
    web: Option<SocketAddr>,
    /// The page asks for this user and password (HTTP Basic): the first line of the file is USER:PASSWORD. A page that
    /// is not on loopback needs it
    #[arg(long, value_name = "FILE", requires = "web")]
    web_login: Option<PathBuf>,
    /// A base station that may drive, and look at the page, by its address; again for another. Without it: those of this machine
    #[arg(long, value_name = "ADDRESS")]
    allow: Vec<IpAddr>,
    /// The motors stop when no command comes for so long: a time such as 500ms or 2s
    #[arg(long, value_name = "TIME", default_value = "500ms", value_parser = duration_within(Duration::from_millis(1)..=Duration::from_secs(86_400)), conflicts_with = "paper")]
    watchdog: Duration,
    /// As the paper has it: no watchdog, motors run on when the base station is lost, and a second one is just closed
    #[arg(long)]
    paper: bool,
    /// Commands that it knows beside the paper's four, as protocols/brs/commands.toml has them; without it: those
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    /// How many robots
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u16).range(1..=10_000))]
    robots: u16,
    /// Of those on this floor only some, as other programs are the others: a number or a range such as 9-10
    #[arg(long, value_name = "UNITS", value_parser = units)]
    only: Option<RangeInclusive<u16>>,
    /// What is in their batteries, in percent
    #[arg(long, value_name = "PERCENT", default_value = "100", value_parser = clap::value_parser!(u8).range(0..=100))]
    battery: u8,
    /// Each has a charger where it begins, which fills its battery while it stands there
    #[arg(long)]
    chargers: bool,
    /// Write the addresses into this file, as mom-base-station --fleet reads it
    #[arg(long, value_name = "FILE")]
    write_fleet: Option<PathBuf>,
    /// The group in which the robots are, in that file: robots of one group are driven together
    #[arg(long, value_name = "NAME", requires = "write_fleet")]
    group: Option<String>,
    /// Write where the first simulated body is, every 10 ms, into this file, for tests
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
}

/// `9` or `9-10`.
fn units(text: &str) -> anyhow::Result<RangeInclusive<u16>> {
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    let (first, last): (u16, u16) = (first.parse()?, last.parse()?);
    anyhow::ensure!(
        1 <= first && first <= last,
        "it must be a number or a range such as 9-10"
    );
    Ok(first..=last)
}

/// Runs the program with these arguments, of which the first is its name, until it is done or told to end.
///
/// # Errors
///
/// What the program ends by; wrong arguments end the process.
#[tokio::main]
pub async fn run(args: Vec<OsString>) -> anyhow::Result<()> {
    if let Some(written) = mom_pages::asked::<LinuxbotArgs>(&args) {
        return Ok(written?);
    }
    let args = LinuxbotArgs::parse_from(args);
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        // A terminal that is gone takes no complaint either, and to insist would panic.
        .log_internal_errors(false)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    let mut interrupt = Interrupt::install()?;
    let mut shutdown = pin!(interrupt.wait());
    let options = options(&args)?;
    let rules = rules(&args)?;
    let login = login(&args)?;
    let units = chosen(&args)?;
    let listeners = listen(args.listen, units.len() as u16).await?;
    let addresses = listeners
        .iter()
        .map(TcpListener::local_addr)
        .collect::<Result<Vec<_>, _>>()?;
    announce(&args, &addresses, &units)?;
    let mut pages = match args.web {
        Some(web) => listen(web, units.len() as u16).await?.into_iter(),
        None => Vec::new().into_iter(),
    };
    let (stop, stopping) = watch::channel(false);
    // The pages end with this function.
    let (mut serving, mut showing) = (JoinSet::new(), JoinSet::new());
    let mut trace = args.trace.as_deref().map(open).transpose()?;
    let drivers = Simulated::fleet(args.robots)
        .into_iter()
        .skip(usize::from(units.start() - 1));
    for ((listener, driver), unit) in listeners.into_iter().zip(drivers).zip(units) {
        let driver = prepared(driver, &args);
        let mut seen = None;
        if let Some(page) = pages.next() {
            println!("robot {unit} has its page at http://{}/", page.local_addr()?);
            let (shown, observed) = Page::of(u32::from(unit), options.access.clone(), driver.floor());
            seen = Some(observed);
            showing.spawn(serve_page(page, shown.with_login(login.clone())));
        }
        let robot = Robot::new(traced(driver, trace.take()), Chassis::LINUXBOT, rules);
        let mut stopping = stopping.clone();
        serving.spawn(serve_observed(
            listener,
            robot,
            options.clone(),
            seen,
            async move {
                // An error is a program that ends, which is as good a reason.
                let _ = stopping.wait_for(|stop| *stop).await;
            },
        ));
    }
    let mut result = Ok(());
    // One whose listener is broken stands, and leaves the others alone.
    loop {
        tokio::select! {
            () = &mut shutdown => break,
            ended = serving.join_next() => match ended {
                Some(ended) => keep(&mut result, ended),
                None => break,
            },
        }
    }
    let _ = stop.send(true);
    while let Some(ended) = serving.join_next().await {
        keep(&mut result, ended);
    }
    result
}

/// Who may look at the page. Over a network nobody may without a password.
fn login(args: &LinuxbotArgs) -> anyhow::Result<Option<Login>> {
    let Some(file) = &args.web_login else {
        let is_far = args.web.is_some_and(|web| !web.ip().to_canonical().is_loopback());
        anyhow::ensure!(
            !is_far,
            "a page that is not on loopback needs --web-login FILE, whose first line is USER:PASSWORD"
        );
        return Ok(None);
    };
    let shown = file.display();
    let text = std::fs::read_to_string(file).with_context(|| format!("{shown} cannot be read"))?;
    let read = Login::parse(&text).map_err(|error| anyhow::anyhow!("{shown}: {error}"))?;
    Ok(Some(read))
}

/// Which robots of its floor it is.
fn chosen(args: &LinuxbotArgs) -> anyhow::Result<RangeInclusive<u16>> {
    let units = args.only.clone().unwrap_or(1..=args.robots);
    anyhow::ensure!(
        *units.end() <= args.robots,
        "there is no unit {} among {} robots: --robots says how many there are on the floor",
        units.end(),
        args.robots
    );
    Ok(units)
}

/// This robot with its battery, and its charger where it stands.
fn prepared(driver: Simulated, args: &LinuxbotArgs) -> Simulated {
    let mut driver = driver.with_battery(args.battery);
    if !args.chargers {
        return driver;
    }
    let Pose { x, y, .. } = driver.pose(0);
    driver.with_charger(Point::new(x, y))
}

/// This driver, whose way is written where that is asked for.
fn traced(driver: Simulated, trace: Option<Trace>) -> Box<dyn Driver> {
    match trace {
        Some(trace) => Box::new(Traced::new(driver, trace)),
        None => Box::new(driver),
    }
}

fn open(file: &std::path::Path) -> anyhow::Result<Trace> {
    Trace::open(file).with_context(|| format!("{} cannot be written", file.display()))
}

/// Says how a robot ended, and keeps the first error for the end of the program.
fn keep(result: &mut anyhow::Result<()>, ended: Result<std::io::Result<()>, JoinError>) {
    let ended = ended
        .map_err(anyhow::Error::from)
        .and_then(|ended| Ok(ended?))
        .context("a robot ended");
    if let Err(error) = ended {
        tracing::error!("{error:#}");
        if result.is_ok() {
            *result = Err(error);
        }
    }
}

/// Says where robots listen, also in the file of a fleet.
fn announce(
    args: &LinuxbotArgs,
    addresses: &[SocketAddr],
    units: &RangeInclusive<u16>,
) -> anyhow::Result<()> {
    if let Some(path) = &args.write_fleet {
        let written = fleet(addresses, units, args.group.as_deref());
        std::fs::write(path, written).with_context(|| format!("{} cannot be written", path.display()))?;
    }
    if let (Some(first), Some(last)) = (addresses.first(), addresses.last()) {
        match addresses.len() {
            1 => println!("a robot listens at {first}"),
            robots => println!("{robots} robots listen at {first} … {last}"),
        }
    }
    Ok(())
}

fn options(args: &LinuxbotArgs) -> anyhow::Result<Options> {
    let access = match &args.allow[..] {
        [] => Access::default(),
        listed => Access::only(listed.iter().copied()),
    };
    let options = match args.paper {
        true => Options::paper(access),
        false => Options {
            access,
            ..Options::default()
        },
    };
    let table: &'static Table = match &args.table {
        None => options.table,
        Some(path) => {
            let shown = path.display();
            let text = std::fs::read_to_string(path).with_context(|| format!("{shown} cannot be read"))?;
            file::table(&text).with_context(|| format!("{shown} is not a table of commands"))?
        }
    };
    Ok(Options { table, ..options })
}

fn rules(args: &LinuxbotArgs) -> anyhow::Result<Rules> {
    if args.paper {
        return Ok(Rules::PAPER);
    }
    Ok(Rules {
        watchdog: Watchdog::after(WheelTime::try_from(args.watchdog.as_micros())?),
        ..Rules::default()
    })
}

/// A listener for each robot: at port 0 all have one that is free, else each the next.
async fn listen(first: SocketAddr, robots: u16) -> anyhow::Result<Vec<TcpListener>> {
    let mut listeners = Vec::new();
    for robot in 0..robots {
        let mut address = first;
        if first.port() != 0 {
            let port = first.port().checked_add(robot);
            address.set_port(
                port.with_context(|| {
                    format!("there are fewer than {robots} ports from {} on", first.port())
                })?,
            );
        }
        let listener = TcpListener::bind(address).await;
        listeners.push(listener.with_context(|| format!("it cannot listen at {address}"))?);
    }
    Ok(listeners)
}

/// The file of addresses of a base station (W14).
fn fleet(addresses: &[SocketAddr], units: &RangeInclusive<u16>, group: Option<&str>) -> String {
    let mut text = String::from("# Which unit listens where, as mom-linuxbot has written it.\n");
    for (address, unit) in addresses.iter().zip(units.clone()) {
        // Writing to a string does not fail.
        let _ = write!(text, "\n[[robot]]\nunit = {unit}\naddress = \"{address}\"\n");
        if let Some(group) = group {
            let _ = writeln!(text, "group = {group:?}");
        }
    }
    text
}
