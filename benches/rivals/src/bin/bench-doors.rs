//! Measures each door of the hub beside those of nats-server and mosquitto, and beside a relay that only passes bytes on.

use std::env;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result};
use clap::Parser;
use mom_benches::scenario::{Size, interleaved};
use mom_benches::{Stream, Topic};
use mom_rivals::{DoorHub, Kind, Metric, Passage, Programs, idle};

const EXAMPLES: &str = "Examples:
  cargo xtask bench-doors                all doors: some 10 minutes
  cargo xtask bench-doors --quick        a minute, to see that all still works";

/// Every hub is spoken to through a gateway in a process of its own, which knows TLS and WebSocket: one load generator, and the same
/// cost outside the hub for all.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Cli {
    /// Short measurements; the figures mean little.
    #[arg(long)]
    quick: bool,
    /// Only these doors: tcp, tls, ws, wss.
    #[arg(long, value_delimiter = ',')]
    doors: Vec<String>,
    /// Only these hubs beside ours: nats, mosquitto, raw relay.
    #[arg(long, value_delimiter = ',')]
    hubs: Vec<String>,
    /// Runs of which the median counts.
    #[arg(long, default_value_t = 5)]
    runs: usize,
    /// Idle peers of which the memory is measured.
    #[arg(long, default_value_t = 9_000)]
    idle: usize,
    /// Where peers are kept that the system does not have.
    #[arg(long)]
    kept: PathBuf,
}

const KINDS: [Kind; 4] = [Kind::RawRelay, Kind::Mom, Kind::Nats, Kind::Mosquitto];
const SIZES: [(&str, usize); 2] = [("256 B", 256), ("16 KiB", 16 * 1024)];

/// What one hub came to at one door.
#[derive(Default)]
struct Figures {
    rates: Vec<Vec<f64>>,
    cpus: Vec<Vec<f64>>,
    p50: f64,
    p99: f64,
    memory: Option<f64>,
}

fn main() -> Result<()> {
    let mut cli = Cli::parse();
    if cli.quick {
        (cli.runs, cli.idle) = (1, 200);
    }
    mom_rivals::raise_files();
    let here = env::current_exe()?;
    let folder = here.parent().context("this program lies in a folder")?;
    let gateway = folder.join("gateway");
    let programs = Programs::find(folder.join("mom-broker"), folder.join("relay"), &cli.kept)?;
    let out = &mut std::io::stdout();
    writeln!(
        out,
        "| door | hub | 256 B/s | CPU s/M | 16 KiB/s | CPU s/M | p50 µs | p99 µs | KiB per idle peer |"
    )?;
    writeln!(out, "|---|---|---|---|---|---|---|---|---|")?;
    let named = |list: &[String], name: &str| list.is_empty() || list.iter().any(|one| one == name);
    for passage in Passage::ALL
        .into_iter()
        .filter(|passage| named(&cli.doors, passage.name()))
    {
        let kinds = KINDS.into_iter().filter(|kind| {
            (*kind == Kind::Mom || named(&cli.hubs, kind.name()))
                && programs.has(*kind)
                && (*kind != Kind::RawRelay || passage == Passage::Tcp)
        });
        let kinds: Vec<Kind> = kinds.collect();
        let all = measure(&cli, &programs, &gateway, passage, &kinds)?;
        for (kind, figures) in kinds.iter().zip(&all) {
            let [small, large] =
                [0, 1].map(|size| (median(&figures.rates[size]), median(&figures.cpus[size])));
            writeln!(
                out,
                "| {} | {} | {:.0} | {:.2} | {:.0} | {:.1} | {:.0} | {:.0} | {} |",
                passage.name(),
                kind.name(),
                small.0,
                small.1,
                large.0,
                large.1,
                figures.p50,
                figures.p99,
                figures.memory.map_or_else(String::new, |kib| format!("{kib:.1}")),
            )?;
        }
    }
    by_client(&cli, &programs, &gateway, out)
}

/// MOM's own doors with its own client at both ends, the tunnel too.
fn by_client(cli: &Cli, programs: &Programs, gateway: &Path, out: &mut impl std::io::Write) -> Result<()> {
    writeln!(
        out,
        "\n| address | 256 B/s | 16 KiB/s | p50 µs | p99 µs | KiB per idle peer |"
    )?;
    writeln!(out, "|---|---|---|---|---|---|")?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let time = Duration::from_millis(if cli.quick { 300 } else { 3000 });
    // The client's ends are in this process, and a tunnel has four of them.
    let idle = cli.idle.min(1000);
    for scheme in ["bin", "bins", "ws", "wss", "http", "https", "https-polled"] {
        let door = programs.start_door(Kind::Mom, Passage::Tcp, gateway)?;
        let hub = door
            .hub
            .process
            .as_deref()
            .context("a hub in a process of its own")?;
        let (scheme, polled) = match scheme.strip_suffix("-polled") {
            Some(scheme) => (scheme, true),
            None => (scheme, false),
        };
        let mut query = Vec::new();
        if polled {
            query.push("poll=1".to_owned());
        }
        if scheme.ends_with('s') && scheme != "ws" {
            query.push(format!("pin={}", programs.pin()?));
        }
        let address = format!("{scheme}://{}?{}", door.address, query.join("&"));
        let figures = runtime.block_on(mom_benches::doors::by_client(
            &address,
            hub,
            &SIZES.map(|(_, size)| size),
            time,
            idle,
        ));
        let figures = figures.with_context(|| address.clone())?;
        writeln!(
            out,
            "| {scheme}://{} | {:.0} | {:.0} | {:.0} | {:.0} | {} |",
            if polled { ", polled" } else { "" },
            figures.rates[0],
            figures.rates[1],
            figures.trips.quantile(0.5),
            figures.trips.quantile(0.99),
            figures.memory.map_or_else(String::new, |kib| format!("{kib:.1}")),
        )?;
    }
    Ok(())
}

/// All hubs run at once and take turns.
fn measure(
    cli: &Cli,
    programs: &Programs,
    gateway: &Path,
    passage: Passage,
    kinds: &[Kind],
) -> Result<Vec<Figures>> {
    let start = |kind: &Kind| programs.start_door(*kind, passage, gateway);
    let hubs: Vec<DoorHub> = kinds.iter().map(start).collect::<Result<_, _>>()?;
    let mut all: Vec<Figures> = hubs
        .iter()
        .map(|_| Figures {
            rates: vec![Vec::new(); SIZES.len()],
            cpus: vec![Vec::new(); SIZES.len()],
            ..Figures::default()
        })
        .collect();
    for _ in 0..cli.runs {
        for (size, (name, payload)) in SIZES.into_iter().enumerate() {
            for (door, figures) in hubs.iter().zip(&mut all) {
                let stream = Stream {
                    payload,
                    topic: Topic::Forth,
                    receivers: 1,
                    window: None,
                    warm_up: Duration::from_millis(300),
                    time: Duration::from_millis(if cli.quick { 300 } else { 1500 }),
                };
                let streamed = stream.run(&door.hub);
                let streamed = streamed.with_context(|| format!("{}, {name}", door.hub.name))?;
                figures.rates[size].push(streamed.deliveries.per_second());
                if let Some(cpu) = streamed.cpu {
                    let millions = streamed.deliveries.count as f64 / 1e6;
                    figures.cpus[size].push(cpu.as_secs_f64() / millions);
                }
            }
        }
    }
    let rounds = if cli.quick { 200 } else { 4000 };
    let measured: Vec<_> = hubs.iter().map(|door| &door.hub).collect();
    let trips = interleaved(&measured, Size::Payload(256), rounds, 4, 100);
    let trips = trips.map_err(|(_, error)| error).context("round trips")?;
    for ((delays, _), figures) in trips.iter().zip(&mut all) {
        (figures.p50, figures.p99) = (delays.quantile(0.5), delays.quantile(0.99));
    }
    drop(hubs);
    for (kind, figures) in kinds
        .iter()
        .zip(&mut all)
        .filter(|(kind, _)| **kind != Kind::RawRelay)
    {
        let door = programs.start_door(*kind, passage, gateway)?;
        let sample = idle(&door.hub, cli.idle).with_context(|| format!("{} idle", door.hub.name))?;
        figures.memory = sample.get(&Metric::Memory).copied();
    }
    Ok(all)
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or_default()
}
