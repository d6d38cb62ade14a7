//! Measures what the number of parcels on their way does to the rate of one sender.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;
use std::{env, io};

use anyhow::{Context as _, Result, bail};
use clap::{Parser, ValueEnum};
use mom_benches::{Hub, Stream, Topic, broker_folder, machine, start_broker, start_relay};
use mom_proto::codec::Form;

const EXAMPLES: &str = "Examples:
  cargo build --release -p mom-broker && cargo run --release --manifest-path benches/Cargo.toml --bin bench-window
  cargo run --release --manifest-path benches/Cargo.toml --bin bench-window -- --payload 16384 --window 16,256 --runs 5
  cargo run --release --manifest-path benches/Cargo.toml --bin bench-window -- --broker old/mom-broker --broker new/mom-broker --runs 10";

/// Deliveries per second of one sender, by payload and by parcels on their way.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Cli {
    /// Bytes of payload
    #[arg(long, value_delimiter = ',', default_value = "256,1024,16384")]
    payload: Vec<usize>,
    /// Parcels on their way
    #[arg(long, value_delimiter = ',', default_value = "16,64,256,1024")]
    window: Vec<u32>,
    /// The wire form of all peers
    #[arg(long, value_enum, default_value_t)]
    form: WireForm,
    /// Receivers, each of which gets all
    #[arg(long, default_value_t = 1)]
    receivers: usize,
    /// Runs of which the median counts, one of each in turn
    #[arg(long, default_value_t = 3)]
    runs: usize,
    /// The broker's program, several for a comparison; the one beside this program if none is named
    #[arg(long)]
    broker: Vec<PathBuf>,
    /// The relay's program, to see what the machine itself does at such windows
    #[arg(long)]
    relay: Option<PathBuf>,
}

/// A wire form by its name.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum WireForm {
    #[default]
    Binary,
    Xml,
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

/// One run: deliveries per second, and the broker's CPU seconds for a million of them.
type Run = (f64, f64);

fn run(cli: &Cli) -> Result<()> {
    let mut programs = cli.broker.clone();
    if programs.is_empty() {
        let own = env::current_exe().context("where this program lies is not known")?;
        programs.push(own.with_file_name("mom-broker"));
    }
    let form = match cli.form {
        WireForm::Binary => Form::Binary,
        WireForm::Xml => Form::Xml,
    };
    let folder = broker_folder()?;
    let mut hubs = Vec::new();
    for program in &programs {
        let process = Arc::new(start_broker(existing(program)?, &folder)?);
        hubs.push(Hub::broker(process.address(), form)?.in_process(&process));
    }
    if let Some(program) = &cli.relay {
        let process = Arc::new(start_relay(existing(program)?)?);
        hubs.push(Hub::relay(process.address()).in_process(&process));
        programs.push(program.clone());
    }
    let mut out = io::stdout();
    if let Some(load) = machine::load() {
        writeln!(out, "load of the machine before: {load:.2}\n")?;
    }
    writeln!(
        out,
        "| payload | on their way | broker | deliveries per second | slowest–fastest | CPU s per million | of its best |"
    )?;
    writeln!(out, "|---|---|---|---|---|---|---|")?;
    for payload in &cli.payload {
        let mut rows = vec![vec![Vec::new(); cli.window.len()]; hubs.len()];
        for _ in 0..cli.runs.max(1) {
            for (number, window) in cli.window.iter().enumerate() {
                for (hub, rows) in hubs.iter().zip(&mut rows) {
                    rows[number].push(measure(hub, *payload, *window, cli.receivers)?);
                }
            }
        }
        for (program, rows) in programs.iter().zip(rows) {
            tell(&mut out, program, *payload, &cli.window, rows)?;
        }
    }
    Ok(())
}

/// A program that is there.
fn existing(program: &Path) -> Result<&Path> {
    if !program.is_file() {
        bail!(
            "there is no {}; build it: cargo build --release -p mom-broker; the relay by --manifest-path benches/Cargo.toml",
            program.display()
        );
    }
    Ok(program)
}

fn measure(hub: &Hub, payload: usize, window: u32, receivers: usize) -> Result<Run> {
    let stream = Stream {
        payload,
        topic: Topic::Forth,
        receivers,
        window: Some(window),
        warm_up: Duration::from_millis(300),
        time: Duration::from_secs(1),
    };
    let streamed = stream.run(hub)?;
    let millions = streamed.deliveries.count as f64 / 1e6;
    let cpu = streamed.cpu.unwrap_or_default().as_secs_f64() / millions.max(1e-9);
    Ok((streamed.deliveries.per_second(), cpu))
}

/// Writes the lines of one broker and payload, one of each window.
fn tell(
    out: &mut impl io::Write,
    program: &Path,
    payload: usize,
    windows: &[u32],
    mut rows: Vec<Vec<Run>>,
) -> Result<()> {
    for row in &mut rows {
        row.sort_by(|one, other| one.0.total_cmp(&other.0));
    }
    let middle = |row: &[Run]| row.get(row.len() / 2).copied().unwrap_or_default();
    let best = rows.iter().map(|row| middle(row).0).fold(0.0, f64::max);
    for (row, window) in rows.iter().zip(windows) {
        let (rate, cpu) = middle(row);
        let slowest = row.first().map_or(0.0, |(rate, _)| *rate);
        let fastest = row.last().map_or(0.0, |(rate, _)| *rate);
        writeln!(
            out,
            "| {payload} B | {window} | {} | {rate:.0} | {slowest:.0}–{fastest:.0} | {cpu:.2} | {:.2} |",
            program.display(),
            rate / best
        )?;
    }
    Ok(())
}
