//! Measures what attackers cost an operator and its robot.

use std::io::Write;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use std::{env, io};

use anyhow::{Context, Result, bail};
use clap::{Parser, Subcommand};
use mom_benches::isolation::{self, Figures, Song};
use mom_benches::{Delays, machine};
use mom_tests::attacks::Attack;

const EXAMPLES: &str = "Examples:
  cargo build --release -p mom-broker && cargo run --release --manifest-path benches/Cargo.toml --bin bench-isolation
  cargo run --release --manifest-path benches/Cargo.toml --bin bench-isolation -- --only nils --only crowd --seconds 20";

/// Stops, commands and renewals at 50/s beside each attack, and beside the same attack on another broker.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    task: Option<Task>,
    /// Only these attacks, one after the other; all of them, and then all together, if none is named.
    #[arg(long)]
    only: Vec<String>,
    /// The named attacks at the same time; all of them if none is named
    #[arg(long)]
    together: bool,
    /// How long each is measured.
    #[arg(long, default_value_t = 5)]
    seconds: u64,
    /// The broker's program; the one beside this program if none is named.
    #[arg(long)]
    broker: Option<PathBuf>,
    /// The niceness of the brokers; below 0 as a service may have it, which takes the right to do so
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    nice: i32,
}

#[derive(Subcommand)]
enum Task {
    /// The attackers, as the measurement starts them.
    #[command(hide = true)]
    Attack { word: String, address: SocketAddr },
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(io::stderr(), "bench-isolation: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(cli: &Cli) -> Result<()> {
    if let Some(Task::Attack { word, address }) = &cli.task {
        return Ok(isolation::attack(named(word)?, *address)?);
    }
    let broker = match &cli.broker {
        Some(broker) => broker.clone(),
        None => env::current_exe()
            .context("where this program lies")?
            .with_file_name("mom-broker"),
    };
    if !broker.is_file() {
        bail!(
            "there is no {}; build it: cargo build --release -p mom-broker",
            broker.display()
        );
    }
    let time = Duration::from_secs(cli.seconds);
    let only: Result<Vec<Attack>> = cli.only.iter().map(|word| named(word)).collect();
    let only = only?;
    let all = only.is_empty();
    let only = if all { Attack::ALL.to_vec() } else { only };
    let mut attacks: Vec<Vec<Attack>> = Vec::new();
    if !cli.together {
        attacks.extend(only.iter().map(|attack| vec![*attack]));
    }
    if all || cli.together {
        attacks.push(only);
    }
    let mut out = io::stdout();
    writeln!(
        out,
        "{}; {} s each; p50 / p99 / worst in ms\n",
        machine::describe(),
        cli.seconds
    )?;
    writeln!(
        out,
        "| attack | stop, elsewhere | stop, under it | command, elsewhere | command, under it | renewal, elsewhere | renewal, under it | lost | most memory | attackers hear |"
    )?;
    writeln!(out, "|---|---|---|---|---|---|---|---:|---:|---|")?;
    for attacks in attacks {
        let figures = isolation::measure(&broker, cli.nice, &attacks, time)?;
        writeln!(out, "{}", row(&attacks, &figures))?;
    }
    Ok(())
}

fn named(word: &str) -> Result<Attack> {
    let words = || Attack::ALL.map(Attack::word).join(", ");
    Attack::named(word).with_context(|| format!("no attack is called {word}; there are {}", words()))
}

fn row(attacks: &[Attack], figures: &Figures) -> String {
    let what = match attacks {
        [attack] => attack.describe(),
        _ => "all of them together",
    };
    let [idle, under] = &figures.songs;
    let kinds: [fn(&Song) -> &Delays; 3] = [|song| &song.stops, |song| &song.commands, |song| &song.renewals];
    let times: Vec<String> = kinds
        .iter()
        .flat_map(|kind| [idle, under].map(|song| quantiles(kind(song))))
        .collect();
    let memory = figures
        .memory
        .map_or_else(String::new, |bytes| format!("{} MiB", bytes >> 20));
    let lost = idle.missing + under.missing;
    format!(
        "| {what} | {} | {lost} | {memory} | {} |",
        times.join(" | "),
        figures.heard.join(", ")
    )
}

fn quantiles(delays: &Delays) -> String {
    let [middle, high, worst] = [0.5, 0.99, 1.0].map(|part| delays.quantile(part) / 1000.0);
    format!("{middle:.2} / {high:.2} / {worst:.1}")
}
