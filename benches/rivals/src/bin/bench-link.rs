//! Measures what a stop takes through a link that a camera's frames begin to saturate: from the first frame on, after
//! each pause, and when the link becomes slower.

use std::fmt::{self, Display, Formatter};
use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use std::{env, io};

use anyhow::{Context as _, Result, bail};
use clap::{Parser, ValueEnum};
use mom_benches::{Delays, Hub, machine};
use mom_rivals::{Kind, Observed, Programs, SaturatedStop};
use mom_tests::network::{RelayedLink, Shape};

const EXAMPLES: &str = "Examples:
  bench-link                                all rates, delays and loads: four minutes
  bench-link --rate 20 --delay 5            one link
  bench-link --rate 20 --load start --runs 20
  bench-link --peer nats                    the same with another broker

A packet relay between two network namespaces makes the links; only root may make those.";

/// Measure stops through links that a camera begins to saturate.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Cli {
    /// Rates of the link, Mbit/s
    #[arg(long, value_delimiter = ',', default_value = "1,20,100")]
    rate: Vec<f64>,
    /// Delays of the link there and back together, ms
    #[arg(long, value_delimiter = ',', default_value = "5,100")]
    delay: Vec<u64>,
    /// What the camera and the link do
    #[arg(long, value_delimiter = ',', default_value = "start,pauses,slower")]
    load: Vec<LoadKind>,
    /// Runs of each load that starts anew
    #[arg(long, default_value_t = 5)]
    runs: usize,
    /// Up to so many ms more delay for each packet
    #[arg(long, default_value_t = 0)]
    jitter: u64,
    /// The share of packets that are lost
    #[arg(long, default_value_t = 0.0)]
    loss: f64,
    /// How TCP finds its rate: cubic, bbr
    #[arg(long, default_value = "cubic")]
    congestion: String,
    /// Which packets are lost
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The broker's kind
    #[arg(long, default_value = "MOM")]
    peer: String,
    /// The broker's program
    #[arg(long)]
    broker: Option<PathBuf>,
}

/// Bytes of a frame.
const FRAME: usize = 64 * 1024;
/// From one stop to the next.
const EVERY: Duration = Duration::from_millis(20);
/// The camera's time, and its pause; from then on the link's share counts.
const SECOND: Duration = Duration::from_secs(1);
const SLOWER_AT: Duration = Duration::from_secs(3);

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(io::stderr(), "bench-link: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(cli: &Cli) -> Result<()> {
    let kind = Kind::from_name(&cli.peer).with_context(|| format!("there is no broker {}", cli.peer))?;
    let own = env::current_exe().context("where this program lies is not known")?;
    let broker = cli
        .broker
        .clone()
        .unwrap_or_else(|| own.with_file_name("mom-broker"));
    if !broker.is_file() {
        bail!(
            "there is no {}; build it with: cargo build --release -p mom-broker",
            broker.display()
        );
    }
    let programs = Programs::find(broker, own.with_file_name("relay"), &own.with_file_name("peers"))?;
    let mut out = io::stdout();
    if let Some(load) = machine::load() {
        writeln!(out, "load of the machine before: {load:.2}\n")?;
    }
    writeln!(
        out,
        "Stops under a camera's frames, from write to read, in ms beyond the delay of the link:\n"
    )?;
    writeln!(
        out,
        "| link | load | stops | p50 | p99 | worst | share of the link after 1 s | packets dropped | longest queue |"
    )?;
    writeln!(out, "|---|---|---|---|---|---|---|---|---|")?;
    for rate in &cli.rate {
        for delay in &cli.delay {
            for load in &cli.load {
                let way = Duration::from_millis(*delay) / 2;
                let shape = Shape {
                    jitter: Duration::from_millis(cli.jitter),
                    loss: cli.loss,
                    ..Shape::mbit(*rate, way)
                };
                let row = Row::measure(cli, kind, &programs, *load, shape)?;
                let name = load.to_possible_value();
                let name = name.as_ref().map_or("", |name| name.get_name());
                writeln!(out, "| {rate} Mbit/s, {delay} ms | {name} | {row}")?;
            }
        }
    }
    Ok(())
}

/// What the camera and the link do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum LoadKind {
    /// The camera begins.
    Start,
    /// It pauses each second for a second.
    Pauses,
    /// The link becomes ten times slower after three seconds.
    Slower,
}

/// A line of the table.
#[derive(Default)]
struct Row {
    delays: Vec<Duration>,
    shares: Vec<f64>,
    dropped: u64,
    longest: Duration,
}

impl Row {
    fn measure(cli: &Cli, kind: Kind, programs: &Programs, load: LoadKind, shape: Shape) -> Result<Row> {
        let mut row = Row::default();
        let runs = u32::try_from(cli.runs)?;
        let (runs, time) = match load {
            LoadKind::Start => (runs, 2 * SECOND),
            LoadKind::Pauses => (1, 2 * SECOND * runs),
            LoadKind::Slower => (runs.min(2), 6 * SECOND),
        };
        for run in 0..runs {
            let back = Shape { rate: 1e9, ..shape };
            let seed = cli.seed.wrapping_add(2 * u64::from(run));
            let link = RelayedLink::new(shape, back, seed, &cli.congestion)
                .context("a link between two namespaces")?;
            let hub = programs.start(kind, &link.ends.hub, false)?;
            row.run(load, &hub, &link, (shape, time))?;
        }
        Ok(row)
    }

    fn run(
        &mut self,
        load: LoadKind,
        hub: &Hub,
        link: &RelayedLink,
        (shape, time): (Shape, Duration),
    ) -> Result<()> {
        let camera = SaturatedStop {
            frame: FRAME,
            load: 1.5 * shape.rate,
            warm_up: Duration::ZERO,
            pauses: (load == LoadKind::Pauses).then_some((SECOND, SECOND)),
            stops: u32::try_from(time.as_millis() / EVERY.as_millis())?,
            every: EVERY,
            late: Duration::from_secs(5),
        };
        let (mut passed, last) = (Vec::new(), EVERY * (camera.stops - 1));
        let observed = camera.run(hub, &link.ends, |number| match EVERY * number {
            SECOND => passed.push(link.relay.take_passed()),
            time if time == last => passed.push(link.relay.take_passed()),
            SLOWER_AT if load == LoadKind::Slower => link.relay.reshape(Shape {
                rate: shape.rate / 10.0,
                ..shape
            }),
            _ => {}
        })?;
        if load == LoadKind::Start {
            let bytes = passed.last().map_or(0, |passed| passed.bytes);
            let most = shape.rate * (last - SECOND).as_secs_f64();
            self.shares.push(bytes as f64 * 8.0 / most);
        }
        passed.push(link.relay.take_passed());
        for passed in passed {
            self.dropped += passed.dropped;
            self.longest = self.longest.max(passed.longest_wait);
        }
        self.note(observed, shape.delay)
    }

    fn note(&mut self, observed: Observed, delay: Duration) -> Result<()> {
        if let Some(failure) = observed.failure {
            bail!("the subscriber was cut off: {failure}");
        }
        let mut arrived = None;
        for (left, took) in observed.stops.into_iter().rev() {
            // A stop that waited when the next one came gave way to it.
            arrived = took.map(|took| left + took).or(arrived);
            let arrived = arrived.context("the last stop has not arrived")?;
            self.delays.push(arrived.saturating_sub(left + delay));
        }
        Ok(())
    }
}

impl Display for Row {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        let delays = Delays::of(self.delays.clone());
        write!(out, "{} |", delays.count())?;
        for part in [0.5, 0.99, 1.0] {
            write!(out, " {:.1} |", delays.quantile(part) / 1000.0)?;
        }
        match self.shares.iter().copied().reduce(f64::min) {
            Some(share) => write!(out, " {share:.3} |")?,
            None => write!(out, " |")?,
        }
        let longest = self.longest.as_secs_f64() * 1000.0;
        write!(out, " {} | {longest:.1} |", self.dropped)
    }
}
