//! Measures what the rules of a device cost: many devices of the kit in one process, each driven at 50 Hz, beside as many bare peers that
//! answer each command with one message and obey nothing.

use std::io::{BufRead as _, BufReader, Read as _, Write};
use std::path::PathBuf;
use std::process::{Command, ExitCode, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use std::{env, fs, io};

use anyhow::{Context, Result, bail};
use clap::{Parser, Subcommand, ValueEnum};
use mom_benches::{Delays, Process, machine};
use mom_client::{CardArg, CardVerb, Client, Event, Map};
use mom_device::{Call, Device, DeviceError, obey};
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, interval};

const EXAMPLES: &str = "Examples:
  cargo build --release -p mom-broker && cargo run --release --manifest-path benches/Cargo.toml --bin bench-devices
  target/release/bench-devices --devices 20 --seconds 5";

/// Between two commands to one device.
const PERIOD: Duration = Duration::from_millis(20);

/// Commands before those that count, while the clocks of the devices are measured.
const WARM: Duration = Duration::from_secs(2);

/// Devices of the kit in one process, each told a velocity at 50 Hz, beside bare peers.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    task: Option<Task>,
    /// How many devices.
    #[arg(long, default_value_t = 100)]
    devices: usize,
    /// How long each kind is measured.
    #[arg(long, default_value_t = 10)]
    seconds: u64,
    /// The broker's program; the one beside this program if none is named.
    #[arg(long)]
    broker: Option<PathBuf>,
}

#[derive(Subcommand)]
enum Task {
    /// The devices, as the measurement starts them.
    #[command(hide = true)]
    Devices { kind: Kind, count: usize, hub: String },
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Kind {
    /// By the rules of docs/device.md.
    Kit,
    /// A peer that answers.
    Bare,
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(io::stderr(), "bench-devices: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(cli: &Cli) -> Result<()> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    if let Some(Task::Devices { kind, count, hub }) = &cli.task {
        return runtime.block_on(devices(*kind, *count, hub));
    }
    let broker = match &cli.broker {
        Some(broker) => broker.clone(),
        None => env::current_exe()?.with_file_name("mom-broker"),
    };
    let folder = tempfile::tempdir()?;
    let config = folder.path().join("devices.toml");
    fs::write(&config, configured(cli.devices)?)?;
    let mut out = io::stdout();
    writeln!(
        out,
        "{}; {} devices at 50 Hz, {} s each",
        machine::describe(),
        cli.devices,
        cli.seconds
    )?;
    for kind in [Kind::Bare, Kind::Kit, Kind::Bare, Kind::Kit] {
        let mut command = Command::new(&broker);
        command.arg("--config").arg(&config).stderr(Stdio::null());
        let hub = Process::start(command)?;
        let address = format!("bin://{}", hub.address());
        let (cpu, delays) = runtime.block_on(measure(kind, cli, &address))?;
        writeln!(
            out,
            "{kind:?}: {} commands, from send to call p50 {:.2} / p99 {:.2} / worst {:.1} ms; {:.1} µs of the devices' processor each",
            delays.count(),
            ms(delays.quantile(0.5)),
            ms(delays.quantile(0.99)),
            ms(delays.quantile(1.0)),
            cpu.as_secs_f64() * 1e6 / delays.count().max(1) as f64,
        )?;
        hub.end();
    }
    Ok(())
}

fn ms(micros: f64) -> f64 {
    micros / 1e3
}

/// A hub with so many channels, each guarded by a token of its own.
fn configured(devices: usize) -> Result<String> {
    let users = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../config/lab-users.toml");
    let users = users.canonicalize().context("config/lab-users.toml")?;
    let mut text = format!(
        "listen = [\"127.0.0.1:0\"]\nusers = {users:?}\nroot = \"open\"\nconnections-per-user = 4000\nconnections-per-address = 4000\n"
    );
    for device in 0..devices {
        text += &format!("[[contexts]]\npath = \"/d{device}\"\nkind = \"session\"\nmanager = \"open\"\n");
        text += &format!("[[contexts]]\npath = \"/d{device}/token\"\nkind = \"token\"\nmanager = \"open\"\n");
        text += &format!(
            "[[contexts]]\npath = \"/d{device}/robot\"\nkind = \"channel\"\nguard = {{ token = \"/d{device}/token\", names = [\"command\"] }}\n"
        );
    }
    Ok(text)
}

/// Drives the devices in a process of their own; its processor time, and the delays that it saw.
async fn measure(kind: Kind, cli: &Cli, hub: &str) -> Result<(Duration, Delays)> {
    let kind = kind.to_possible_value().context("it is shown")?;
    let mut child = Command::new(env::current_exe()?)
        .args(["devices", kind.get_name(), &cli.devices.to_string(), hub])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()?;
    let mut said = BufReader::new(child.stdout.take().context("its output")?);
    let mut line = String::new();
    said.read_line(&mut line)?;
    if line.trim() != "ready" {
        bail!("the devices said {line:?}");
    }
    let mut drivers = JoinSet::new();
    let until = Instant::now() + WARM + Duration::from_secs(cli.seconds);
    for device in 0..cli.devices {
        drivers.spawn(drive(hub.to_owned(), device, until));
    }
    while let Some(driver) = drivers.join_next().await {
        driver??;
    }
    drop(child.stdin.take());
    let mut text = String::new();
    said.read_to_string(&mut text)?;
    child.wait()?;
    let mut lines = text.lines();
    let cpu: f64 = lines.next().context("its processor time")?.parse()?;
    let delays: Result<Vec<Duration>, _> = lines
        .map(|line| line.parse().map(Duration::from_micros))
        .collect();
    Ok((Duration::from_secs_f64(cpu), Delays::of(delays?)))
}

/// A client, as soon as the hub has time for its password.
async fn logged_in(hub: &str) -> Result<Client> {
    let mut tries = 0;
    loop {
        let builder = Client::builder(hub).user("carol").password("carol");
        match builder.no_reconnect().connect().await {
            Err(error) if tries < 100 && error.code() == Some(&mom_client::Code::TRY_LATER) => tries += 1,
            connected => return Ok(connected?),
        }
        tokio::time::sleep(PERIOD).await;
    }
}

/// Has one device move until then, a command each 20 ms.
async fn drive(hub: String, device: usize, until: Instant) -> Result<()> {
    let client = logged_in(&hub).await?;
    let channel = client.channel(&format!("/d{device}/robot")).await?;
    let token = client.token(&format!("/d{device}/token")).await?;
    let guard = token.grab().await?;
    let mut ticks = interval(PERIOD);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    while Instant::now() < until {
        ticks.tick().await;
        channel.send("command", format!("go {}", now())).await?;
    }
    guard.release().await?;
    client.close().await;
    Ok(())
}

/// µs of the day, as both processes tell them.
fn now() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_micros()).unwrap_or_default() % 86_400_000_000
}

/// What was heard in all, in µs, from this moment on.
type Heard = Arc<Mutex<(Option<Instant>, Vec<u64>)>>;

fn note(heard: &Heard, sent: u64) {
    let delay = now().saturating_sub(sent);
    if let Ok(mut heard) = heard.lock() {
        let begin = *heard.0.get_or_insert_with(Instant::now);
        if begin.elapsed() > WARM {
            heard.1.push(delay);
        }
    }
}

/// Something on wheels that has none.
struct Wheels(Heard);

impl Device for Wheels {
    const NAME: &str = "the wheels";

    fn verbs() -> Vec<CardVerb> {
        let sent = CardArg::number("sent", "us");
        vec![CardVerb::motion("go", "Goes on").velocity().args([sent])]
    }

    fn begin(&mut self, call: &Call) -> Result<(), DeviceError> {
        note(&self.0, call.number("sent")? as u64);
        Ok(())
    }

    fn is_done(&mut self) -> Result<bool, DeviceError> {
        Ok(false)
    }

    fn halt(&mut self) {}

    fn position(&self) -> Map {
        Map::new().with("x", 0.0)
    }
}

/// The devices until the standard input ends; then it says what they cost, and each delay.
async fn devices(kind: Kind, count: usize, hub: &str) -> Result<()> {
    let heard = Heard::default();
    let mut all = JoinSet::new();
    for device in 0..count {
        let client = logged_in(hub).await?;
        let (heard, path) = (Arc::clone(&heard), format!("/d{device}/robot"));
        let channel = match kind {
            Kind::Bare => Some(client.channel(&path).await?),
            Kind::Kit => None,
        };
        all.spawn(async move {
            match channel {
                None => obey(&client, &path, Wheels(heard), std::future::pending()).await,
                Some(channel) => {
                    let mut events = channel.events();
                    while let Some(event) = events.next().await {
                        let Event::Message(command) = event else { continue };
                        if command.name() != "command" {
                            continue;
                        }
                        let said = command.value();
                        let sent = said
                            .as_str()
                            .and_then(|text| text.strip_prefix("go ")?.parse().ok());
                        note(&heard, sent.unwrap_or_default());
                        let state = Map::new().with("state", "executing");
                        channel.send("status", state).await?;
                    }
                    Ok(())
                }
            }
        });
    }
    let mut out = io::stdout();
    writeln!(out, "ready")?;
    out.flush()?;
    tokio::task::spawn_blocking(|| io::stdin().read_to_end(&mut Vec::new())).await??;
    writeln!(out, "{}", processor_time()?)?;
    let heard = heard.lock().map_err(|_| anyhow::anyhow!("a device has failed"))?;
    for delay in &heard.1 {
        writeln!(out, "{delay}")?;
    }
    out.flush()?;
    // The devices need not end: nobody drives them.
    std::process::exit(0)
}

/// s of this process.
fn processor_time() -> Result<f64> {
    let stat = fs::read_to_string("/proc/self/stat")?;
    let fields = stat.rsplit_once(')').context("/proc/self/stat")?.1;
    let ticks: u64 = fields
        .split_whitespace()
        .skip(11)
        .take(2)
        .filter_map(|word| word.parse::<u64>().ok())
        .sum();
    Ok(ticks as f64 / 100.0)
}
