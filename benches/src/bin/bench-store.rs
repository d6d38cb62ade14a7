//! Measures durable grants of the store: how many per second, and how long each waits, by the number of tokens that
//! change hands at once.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use std::{env, io};

use anyhow::{Context, Result};
use clap::Parser;
use mom_benches::grants::{self, DurableGrants, GrantLoad, SUBJECTS, TOKENS};
use mom_benches::{Delays, machine};
use tempfile::TempDir;

const EXAMPLES: &str = "Examples:
  cargo run --release --manifest-path benches/Cargo.toml --bin bench-store
  cargo run --release --manifest-path benches/Cargo.toml --bin bench-store -- --rounds 9 --seconds 1 --tokens 1,64
  cargo run --release --manifest-path benches/Cargo.toml --bin bench-store -- --pause 20 --directory /mnt/disk
  chrt -r 10 target/release/bench-store     as root: what other programs take of the processors does not count";

/// Measure how fast the store makes grants durable, beside a file that is only written and synced twice.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Cli {
    /// Rounds in which all take turns; medians of them count.
    #[arg(long, default_value_t = 5)]
    rounds: usize,
    /// The measured time of one turn.
    #[arg(long, default_value_t = 2.0)]
    seconds: f64,
    /// Tokens that change hands at once.
    #[arg(long, value_delimiter = ',', default_values_t = TOKENS)]
    tokens: Vec<usize>,
    /// Milliseconds from an answer to the next put of the same token, on average; 0 = it follows at once.
    #[arg(long, default_value_t = 0.0)]
    pause: f64,
    /// Where the files are made, on the disk that counts; beside this program if not said. They are removed.
    #[arg(long)]
    directory: Option<PathBuf>,
}

/// What came of one subject and number of tokens, a value for each round.
#[derive(Default)]
struct Series {
    per_second: Vec<f64>,
    p50: Vec<f64>,
    p99: Vec<f64>,
    all: Vec<Delays>,
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            say(&format!("bench-store: {error:#}"));
            ExitCode::FAILURE
        }
    }
}

fn run(cli: &Cli) -> Result<()> {
    let base = match &cli.directory {
        Some(directory) => directory.clone(),
        None => {
            let own = env::current_exe().context("where this program lies is not known")?;
            own.parent().context("this program lies nowhere")?.to_owned()
        }
    };
    let folder = TempDir::with_prefix_in("bench-store-", &base)
        .with_context(|| format!("{} cannot be used", base.display()))?;
    let time = Duration::try_from_secs_f64(cli.seconds).context("--seconds")?;
    let pause = Duration::try_from_secs_f64(cli.pause / 1000.0).context("--pause")?;
    let rounds = cli.rounds.max(1);
    let mut out = io::stdout();
    writeln!(
        out,
        "{}; {rounds} rounds of {} s, load {:.1}",
        machine::describe(),
        cli.seconds,
        machine::load().unwrap_or_default()
    )?;
    writeln!(
        out,
        "\n| tokens at once | | grants per second | p50 in ms | p99 in ms | ratios to the last: grants | p50 | p99 |\n\
         |---:|---|---:|---:|---:|---:|---:|---:|"
    )?;
    for tokens in cli.tokens.iter().copied().filter(|tokens| *tokens > 0) {
        let mut all: Vec<Series> = SUBJECTS.iter().map(|_| Series::default()).collect();
        for round in 0..rounds {
            // Each begins as often as the others: what a turn leaves to the disk falls on the next.
            for turn in 0..SUBJECTS.len() {
                let at = (turn + round) % SUBJECTS.len();
                let subject = &SUBJECTS[at];
                let directory = folder.path().join(format!("{tokens}-{round}-{at}"));
                let load = GrantLoad { tokens, time, pause };
                let granted = grants::grant(subject, &directory, &load).context(subject.name)?;
                all[at].add(granted);
            }
        }
        let last = all.last().context("nothing is measured")?;
        for (subject, series) in SUBJECTS.iter().zip(&all) {
            writeln!(out, "| {tokens} | {} | {} |", subject.name, series.row(last))?;
        }
    }
    Ok(())
}

impl Series {
    fn add(&mut self, granted: DurableGrants) {
        self.per_second.push(granted.per_second);
        self.p50.push(granted.delays.quantile(0.5) / 1000.0);
        self.p99.push(granted.delays.quantile(0.99) / 1000.0);
        self.all.push(granted.delays);
    }

    /// Medians of the rounds; of the p99 also that of all rounds together, in brackets.
    fn row(&self, last: &Series) -> String {
        format!(
            "{:.0} | {:.2} | {:.2} ({:.2}) | {} | {} | {}",
            median(self.per_second.clone()),
            median(self.p50.clone()),
            median(self.p99.clone()),
            Delays::together(&self.all).quantile(0.99) / 1000.0,
            ratio(&self.per_second, &last.per_second),
            ratio(&self.p50, &last.p50),
            ratio(&self.p99, &last.p99),
        )
    }
}

/// The median of the ratios of each round, and the least and the greatest.
fn ratio(values: &[f64], to: &[f64]) -> String {
    let mut ratios: Vec<f64> = values.iter().zip(to).map(|(value, to)| value / to).collect();
    ratios.sort_by(f64::total_cmp);
    match ratios.as_slice() {
        [] => String::new(),
        [only] => format!("{only:.2}"),
        [least, .., greatest] => format!("{:.2} ({least:.2}–{greatest:.2})", median(ratios.clone())),
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

fn say(what: &str) {
    // Standard error may be closed; nothing is lost then.
    let _ = writeln!(io::stderr(), "{what}");
}
