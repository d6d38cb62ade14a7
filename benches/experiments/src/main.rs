//! Runs the papers' experiments again and writes what came of them.

use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use anyhow::{Context as _, Result, bail};
use clap::Parser;
use mom_benches::{machine, report};
use mom_experiments::{ALL, Experiment, Section, Settings, marks};

const EXAMPLES: &str = "Examples:
  cargo xtask experiments                      all, into docs/experiments.md: half an hour
  cargo xtask experiments --only reach         one of them, into its part of the page
  cargo xtask experiments --quick              less of each, not written, to see that all still works
  cargo xtask experiments --seed 7 --no-write

The links are made between network namespaces; only root may make those. The others run without.";

/// Run the papers' experiments again.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Cli {
    /// What draws the inputs
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Only experiments whose name contains one of these
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    /// Less of everything; not written
    #[arg(long)]
    quick: bool,
    /// Write nothing into docs/
    #[arg(long)]
    no_write: bool,
    /// The broker's program
    #[arg(long)]
    broker: Option<PathBuf>,
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            say(&format!("experiments: {error:#}"));
            ExitCode::FAILURE
        }
    }
}

fn run(cli: &Cli) -> Result<()> {
    let own = std::env::current_exe().context("where this program lies is not known")?;
    let broker = cli.broker.clone();
    let settings = Settings {
        seed: cli.seed,
        quick: cli.quick,
        broker: broker.unwrap_or_else(|| own.with_file_name("mom-broker")),
    };
    if !settings.broker.is_file() {
        bail!(
            "there is no {}; `cargo xtask experiments` builds it",
            settings.broker.display()
        );
    }
    let wanted = |experiment: &&Experiment| {
        cli.only.is_empty()
            || cli
                .only
                .iter()
                .any(|part| experiment.name.contains(part.as_str()))
    };
    let wanted: Vec<&Experiment> = ALL.iter().filter(wanted).collect();
    if wanted.is_empty() {
        let names = ALL.map(|experiment| experiment.name).join(", ");
        bail!("no experiment is called so; there are {names}");
    }
    let mut failed = Vec::new();
    for experiment in wanted {
        say(&format!("{} ...", experiment.name));
        let start = Instant::now();
        match (experiment.run)(&settings) {
            Ok(section) => {
                let took = start.elapsed().as_secs();
                let markdown = format!("{}{}", section.markdown, conditions(&settings, took));
                writeln!(io::stdout(), "{markdown}")?;
                if !cli.quick && !cli.no_write {
                    write(experiment, &Section { markdown, ..section })?;
                }
            }
            Err(error) => {
                say(&format!("{}: {error:#}", experiment.name));
                failed.push(experiment.name);
            }
        }
    }
    match failed.is_empty() {
        true => Ok(()),
        false => bail!("without a result: {}", failed.join(", ")),
    }
}

fn conditions(settings: &Settings, took: u64) -> String {
    let built = if cfg!(debug_assertions) {
        ", not optimised"
    } else {
        ""
    };
    format!(
        "\nSeed {}; measured on {}{built}, within {took} s.\n",
        settings.seed,
        machine::describe()
    )
}

/// Writes the plots, and the experiment's part of the page.
fn write(experiment: &Experiment, section: &Section) -> Result<()> {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
    let page = docs.join("experiments.md");
    let failed = || format!("{} cannot be changed", page.display());
    for (file, plot) in &section.plots {
        fs::write(docs.join("images").join(file), plot).with_context(failed)?;
    }
    let (begin, end) = marks(experiment.name);
    let before = fs::read_to_string(&page).with_context(failed)?;
    let after = report::insert_between(&before, &begin, &end, &section.markdown)
        .with_context(|| format!("it needs the lines {begin} and {end}"))
        .with_context(failed)?;
    fs::write(&page, after).with_context(failed)?;
    say(&format!("{} is written into {}", experiment.name, page.display()));
    Ok(())
}

fn say(what: &str) {
    // Standard error may be closed; nothing is lost then.
    let _ = writeln!(io::stderr(), "{what}");
}
