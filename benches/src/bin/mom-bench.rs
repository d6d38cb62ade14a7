//! Measures the hub, the codecs, and the broker beside the relay; writes the table.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::sync::Arc;
use std::time::Duration;
use std::{env, fs, io, thread};

use anyhow::{Context, Result, bail};
use clap::Parser;
use mom_benches::scenario::{self, Scenario};
use mom_benches::{Hub, Pace, USER, broker_folder, report, start_broker, start_relay};
use mom_proto::codec::Form;

const EXAMPLES: &str = "Examples:
  cargo run --release --manifest-path benches/Cargo.toml --bin mom-bench              all, into docs/benchmarks.md
  cargo run --release --manifest-path benches/Cargo.toml --bin mom-bench -- --quick   seconds, to see that all still works
  cargo run --release --manifest-path benches/Cargo.toml --bin mom-bench -- --only 'round trip' --runs 5";

/// Whatever happens, a run ends by then, and its children with it.
const LONGEST: Duration = Duration::from_secs(180);
const LONGEST_QUICK: Duration = Duration::from_secs(30);

/// Measure MOM beside a relay that only parses length prefixes.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Cli {
    /// Seconds instead of minutes; the figures mean little and are not written.
    #[arg(long)]
    quick: bool,
    /// Only the parts whose name contains one of these; not written then. The parts: hub, codec, control, and the
    /// scenarios of the table.
    #[arg(long)]
    only: Vec<String>,
    /// Runs of which the median counts.
    #[arg(long)]
    runs: Option<usize>,
    /// Do not write the document.
    #[arg(long)]
    no_write: bool,
    /// The document; docs/benchmarks.md of the checkout if none is named.
    #[arg(long)]
    document: Option<PathBuf>,
    /// The broker's program, instead of building it.
    #[arg(long)]
    broker: Option<PathBuf>,
    /// The relay's program, instead of building it.
    #[arg(long)]
    relay: Option<PathBuf>,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    end_by(if cli.quick { LONGEST_QUICK } else { LONGEST });
    match run(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            say(&format!("mom-bench: {error:#}"));
            ExitCode::FAILURE
        }
    }
}

fn run(cli: &Cli) -> Result<()> {
    let mut pace = if cli.quick { Pace::quick() } else { Pace::full() };
    pace.runs = cli.runs.unwrap_or(pace.runs).max(1);
    let wanted = |name: &str| cli.only.is_empty() || cli.only.iter().any(|part| name.contains(part.as_str()));
    let scenarios: Vec<Scenario> = scenario::ALL
        .into_iter()
        .filter(|scenario| wanted(scenario.name))
        .collect();
    if scenarios.is_empty() && !["hub", "codec", "control"].into_iter().any(&wanted) {
        let names = scenario::ALL.map(|scenario| scenario.name).join("\n  ");
        bail!("nothing is called so; there are\n  hub\n  codec\n  control\n  {names}");
    }
    let mut parts = vec![report::conditions(&pace)];
    if !scenarios.is_empty() {
        parts.push(end_to_end(cli, &scenarios, &pace)?);
    }
    if wanted("control") {
        say("control");
        let broker = program(cli.broker.as_deref(), "mom-broker", "mom-broker")?;
        let folder = broker_folder()?;
        let broker = start_broker(&broker, &folder)?;
        parts.push(report::control(broker.address(), USER, &pace)?);
    }
    if wanted("hub") {
        say("hub");
        parts.push(report::hub(&pace)?);
    }
    if wanted("codec") {
        say("codec");
        parts.push(report::codecs(&pace)?);
    }
    let table = parts.join("\n");
    writeln!(io::stdout(), "{table}")?;
    match cli.quick || cli.no_write || !cli.only.is_empty() {
        true => Ok(()),
        false => write(cli, &table),
    }
}

fn end_to_end(cli: &Cli, scenarios: &[Scenario], pace: &Pace) -> Result<String> {
    let broker = program(cli.broker.as_deref(), "mom-broker", "mom-broker")?;
    let relay = program(cli.relay.as_deref(), "mom-benches", "relay")?;
    let folder = broker_folder()?;
    let broker = Arc::new(start_broker(&broker, &folder)?);
    let relay = Arc::new(start_relay(&relay)?);
    let hub = |form| Hub::broker(broker.address(), form).map(|hub| hub.in_process(&broker));
    let hubs = [
        Hub::relay(relay.address()).in_process(&relay),
        hub(Form::Binary)?,
        hub(Form::Xml)?,
    ];
    let figures = scenario::run(scenarios, &hubs, pace, |run, scenario| {
        say(&format!("run {} of {}: {}", run + 1, pace.runs, scenario.name));
    });
    let figures = figures.map_err(|(name, error)| anyhow::Error::new(error).context(name))?;
    Ok(report::end_to_end(scenarios, &figures))
}

/// The program that was named, or a fresh build of it beside this one.
fn program(named: Option<&Path>, package: &str, name: &str) -> Result<PathBuf> {
    if let Some(named) = named {
        return Ok(named.to_owned());
    }
    let own = env::current_exe().context("where this program lies is not known")?;
    let beside = own.with_file_name(name);
    // Where cargo started this program, a build of yesterday must not be measured.
    if let Some(cargo) = env::var_os("CARGO") {
        // This program's own package is in another workspace than those that it measures.
        let workspace = if package == env!("CARGO_PKG_NAME") {
            env!("CARGO_MANIFEST_DIR").into()
        } else {
            root()
        };
        let mut build = Command::new(cargo);
        build
            .args(["build", "--quiet", "--package", package, "--bin", name])
            .current_dir(workspace);
        if !cfg!(debug_assertions) {
            build.arg("--release");
        }
        if let Some(target) = own.parent().and_then(Path::parent) {
            build.arg("--target-dir").arg(target);
        }
        say(&format!("build {name}"));
        if !build.status().context("cargo does not start")?.success() {
            bail!("{name} cannot be built");
        }
    }
    match beside.is_file() {
        true => Ok(beside),
        false => bail!(
            "there is no {}; build it, or say where it is: --broker, --relay",
            beside.display()
        ),
    }
}

fn write(cli: &Cli, table: &str) -> Result<()> {
    let default = root().join("docs/benchmarks.md");
    let document = cli.document.as_deref().unwrap_or(&default);
    let failed = || format!("{} cannot be changed", document.display());
    let text = fs::read_to_string(document).with_context(failed)?;
    let text = report::insert(&text, table)
        .with_context(|| format!("it needs the lines {} and {}", report::BEGIN, report::END))
        .with_context(failed)?;
    fs::write(document, text).with_context(failed)?;
    say(&format!("written into {}", document.display()));
    Ok(())
}

/// Ends this process after some time, and with it the children of its main thread.
fn end_by(time: Duration) {
    thread::spawn(move || {
        thread::sleep(time);
        say(&format!("mom-bench: not done after {} s", time.as_secs()));
        std::process::exit(1);
    });
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn say(what: &str) {
    // Standard error may be closed; nothing is lost then.
    let _ = writeln!(io::stderr(), "{what}");
}
