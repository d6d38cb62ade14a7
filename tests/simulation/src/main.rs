//! `cargo xtask simulate`: lives of worlds, one seed after the other, until the time is over or a promise is broken.

use std::io::Write;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use anyhow::Result;
use clap::Parser;
use mom_simulation::run::{Outcome, Plan, run};
use mom_simulation::world::Panics;

const EXAMPLES: &str = "Examples:
  cargo xtask simulate --minutes 10
  cargo xtask simulate --seed 7 --lives 1 --facts      what happened in one of them";

/// Simulates the hub with devices, operators and a bad network, in virtual time.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Cli {
    /// How long, in minutes of this machine
    #[arg(long, default_value_t = 1.0)]
    minutes: f64,
    /// The seed of the first life; the others have those that follow
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// How many lives at most
    #[arg(long)]
    lives: Option<u64>,
    /// How long each life has faults, in virtual seconds
    #[arg(long, default_value_t = 300)]
    seconds: u64,
    /// How many devices
    #[arg(long, default_value_t = 2)]
    devices: usize,
    /// How many operators
    #[arg(long, default_value_t = 3)]
    operators: usize,
    /// Virtual seconds between two faults, on average; 0 = none
    #[arg(long, default_value_t = 6)]
    fault_each: u64,
    /// Print what has happened
    #[arg(long)]
    facts: bool,
    /// Live each life twice, and say where the two are not alike
    #[arg(long)]
    twice: bool,
}

fn main() -> ExitCode {
    match simulate(&Cli::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "mom-simulation: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn simulate(cli: &Cli) -> Result<bool> {
    let panics = Panics::listen();
    // What a program makes once is made before, or the first life would have other random numbers than it has alone.
    let short = Plan {
        seed: 0,
        time: Duration::from_secs(2),
        devices: 1,
        operators: 1,
        fault_each: None,
    };
    run(short, &panics)?;
    let begin = Instant::now();
    let mut out = std::io::stdout();
    let mut simulated = Duration::ZERO;
    for life in 0..cli.lives.unwrap_or(u64::MAX) {
        if begin.elapsed().as_secs_f64() > cli.minutes * 60.0 {
            break;
        }
        let plan = Plan {
            seed: cli.seed + life,
            time: Duration::from_secs(cli.seconds),
            devices: cli.devices,
            operators: cli.operators,
            fault_each: (cli.fault_each > 0).then_some(Duration::from_secs(cli.fault_each)),
        };
        let outcome = run(plan, &panics)?;
        simulated += outcome.time;
        if cli.facts {
            for (at, fact) in &outcome.facts {
                writeln!(out, "{:10.3} {fact:?}", *at as f64 / 1e6)?;
            }
        }
        writeln!(
            out,
            "seed {}: {:016x} {:?}; {:.1} h in all, {:.0} × as fast",
            plan.seed,
            outcome.fingerprint,
            outcome.counts,
            simulated.as_secs_f64() / 3600.0,
            simulated.as_secs_f64() / begin.elapsed().as_secs_f64()
        )?;
        if cli.twice {
            let again = run(plan, &panics)?;
            if let Some(difference) = difference(&outcome, &again) {
                writeln!(
                    out,
                    "seed {}: the second life is not alike: {difference}",
                    plan.seed
                )?;
            }
        }
        if !outcome.broken.is_empty() {
            for words in &outcome.broken {
                writeln!(out, "BROKEN {words}")?;
            }
            writeln!(
                out,
                "again: cargo xtask simulate --seed {} --lives 1 --seconds {} --devices {} --operators {} --fault-each {} --facts",
                plan.seed, cli.seconds, cli.devices, cli.operators, cli.fault_each
            )?;
            return Ok(false);
        }
    }
    Ok(true)
}

/// Where two lives part.
fn difference(one: &Outcome, other: &Outcome) -> Option<String> {
    if one.fingerprint == other.fingerprint {
        return None;
    }
    let at = one
        .facts
        .iter()
        .zip(&other.facts)
        .position(|((at, fact), (also, other))| {
            at != also || std::mem::discriminant(fact) != std::mem::discriminant(other)
        });
    let at = at.unwrap_or_else(|| one.facts.len().min(other.facts.len()));
    Some(format!(
        "at fact {at}: {:?} and {:?}",
        one.facts.get(at),
        other.facts.get(at)
    ))
}
