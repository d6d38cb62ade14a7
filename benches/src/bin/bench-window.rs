//! Measures what the number of parcels on their way does to the rate of one sender and one receiver.

use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;
use std::{env, io};

use anyhow::{Context as _, Result, bail};
use clap::Parser;
use mom_benches::{Hub, Stream, Topic, broker_folder, machine, start_broker};
use mom_proto::codec::Form;

const EXAMPLES: &str = "Examples:
  cargo build --release -p mom-broker && cargo run --release -p mom-benches --bin bench-window
  cargo run --release -p mom-benches --bin bench-window -- --payload 16384 --window 16,256 --runs 5";

/// Deliveries per second of one sender to one receiver, by payload and by parcels on their way.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Cli {
    /// Bytes of payload
    #[arg(long, value_delimiter = ',', default_value = "256,1024,16384")]
    payload: Vec<usize>,
    /// Parcels on their way
    #[arg(long, value_delimiter = ',', default_value = "16,64,256,1024")]
    window: Vec<u32>,
    /// Runs of which the median counts, one of each in turn
    #[arg(long, default_value_t = 3)]
    runs: usize,
    /// The broker's program; the one beside this program if none is named
    #[arg(long)]
    broker: Option<PathBuf>,
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(io::stderr(), "bench-window: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(cli: &Cli) -> Result<()> {
    let own = env::current_exe().context("where this program lies is not known")?;
    let broker = cli
        .broker
        .clone()
        .unwrap_or_else(|| own.with_file_name("mom-broker"));
    if !broker.is_file() {
        bail!(
            "there is no {}; build it: cargo build --release -p mom-broker",
            broker.display()
        );
    }
    let folder = broker_folder()?;
    let process = Arc::new(start_broker(&broker, &folder)?);
    let hub = Hub::broker(process.address(), Form::Binary)?.in_process(&process);
    let mut out = io::stdout();
    if let Some(load) = machine::load() {
        writeln!(out, "load of the machine before: {load:.2}\n")?;
    }
    writeln!(
        out,
        "| payload | on their way | deliveries per second | CPU s per million | of the best |"
    )?;
    writeln!(out, "|---|---|---|---|---|")?;
    for payload in &cli.payload {
        let mut rows = vec![Vec::new(); cli.window.len()];
        for _ in 0..cli.runs.max(1) {
            for (row, window) in rows.iter_mut().zip(&cli.window) {
                let stream = Stream {
                    payload: *payload,
                    topic: Topic::Forth,
                    receivers: 1,
                    window: Some(*window),
                    warm_up: Duration::from_millis(300),
                    time: Duration::from_secs(1),
                };
                let streamed = stream.run(&hub)?;
                let millions = streamed.deliveries.count as f64 / 1e6;
                let cpu = streamed.cpu.unwrap_or_default().as_secs_f64() / millions.max(1e-9);
                row.push((streamed.deliveries.per_second(), cpu));
            }
        }
        let middles: Vec<(f64, f64)> = rows.into_iter().map(middle).collect();
        let best = middles.iter().map(|(rate, _)| *rate).fold(0.0, f64::max);
        for ((rate, cpu), window) in middles.into_iter().zip(&cli.window) {
            writeln!(
                out,
                "| {payload} B | {window} | {rate:.0} | {cpu:.2} | {:.2} |",
                rate / best
            )?;
        }
    }
    Ok(())
}

/// The run in the middle by its rate.
fn middle(mut runs: Vec<(f64, f64)>) -> (f64, f64) {
    runs.sort_by(|one, other| one.0.total_cmp(&other.0));
    runs.get(runs.len() / 2).copied().unwrap_or_default()
}
