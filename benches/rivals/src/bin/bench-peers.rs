//! Measures MOM beside other brokers and writes the tables, the plots and the raw figures.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::SystemTime;
use std::{env, fs, io};

use anyhow::{Context, Result, bail};
use clap::Parser;
use mom_benches::{machine, report};
use mom_rivals::plan::{Effort, Load, ROWS, Row};
use mom_rivals::{Kind, Metric, Outcome, Programs, table};

const EXAMPLES: &str = "Examples:
  cargo xtask bench-peers                               all, into docs/: some 25 minutes
  cargo xtask bench-peers --quick                       a minute or two, to see that all still works
  cargo xtask bench-peers --only 1→1 --only ping-pong   some scenarios, not written
  cargo xtask bench-peers --peers nats,redis --runs 1   beside some peers only";

/// Measure MOM beside nats, redis, mosquitto, zenoh and prosody, and beside two relays.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Cli {
    /// A minute or two; the figures mean little and are not written.
    #[arg(long)]
    quick: bool,
    /// Only the scenarios whose name contains one of these; not written then.
    #[arg(long)]
    only: Vec<String>,
    /// Only these peers, besides ours and the relays; not written then.
    #[arg(long, value_delimiter = ',')]
    peers: Vec<String>,
    /// Runs of which the median counts.
    #[arg(long)]
    runs: Option<usize>,
    /// Write nothing into docs/.
    #[arg(long)]
    no_write: bool,
    /// Raw figures of an earlier run, to be compared with; docs/benchmarks.json holds those of the tables.
    #[arg(long)]
    against: Option<PathBuf>,
    /// Where the raw figures go; docs/benchmarks.json where all is measured and written.
    #[arg(long)]
    raw: Option<PathBuf>,
    /// Measure nothing: write the tables and plots again from raw figures, those of --against if given.
    #[arg(long)]
    again: bool,
    /// Where peers are kept that the system does not have.
    #[arg(long)]
    kept: PathBuf,
    /// The broker's program.
    #[arg(long)]
    broker: Option<PathBuf>,
    /// The relay's program.
    #[arg(long)]
    relay: Option<PathBuf>,
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            say(&format!("bench-peers: {error:#}"));
            ExitCode::FAILURE
        }
    }
}

fn run(cli: &Cli) -> Result<()> {
    let rows = rows(cli)?;
    let only = cli
        .peers
        .iter()
        .map(|name| {
            Kind::from_name(name)
                .filter(|kind| kind.is_peer())
                .with_context(|| unknown(name))
        })
        .collect::<Result<Vec<_>>>()?;
    let wanted = |kind: Kind| !kind.is_peer() || only.is_empty() || only.contains(&kind);
    let mut effort = if cli.quick {
        Effort::quick()
    } else {
        Effort::full()
    };
    effort.runs = cli.runs.unwrap_or(effort.runs).max(1);
    let earlier = cli.against.as_deref().map(read).transpose()?;
    mom_rivals::raise_files();
    let programs = Programs::find(
        program(cli.broker.as_deref(), "mom-broker")?,
        program(cli.relay.as_deref(), "relay")?,
        &cli.kept,
    )?;
    if cli.again {
        return again(&programs, cli);
    }
    for kind in Kind::ALL {
        match programs.has(kind) {
            false => say(&format!("{} is left out: it is not installed", kind.name())),
            true if kind.is_peer() => say(&format!("{} {}", kind.name(), programs.version(kind))),
            true => {}
        }
    }
    let (rows, began, load) = (without_namespaces(rows), now(), machine::load());
    let outcomes = mom_rivals::run(&rows, &programs, wanted, &effort, say);
    let markdown = table::markdown(&outcomes, &programs, effort.runs, load);
    writeln!(io::stdout(), "{markdown}")?;
    if let Some(earlier) = &earlier {
        writeln!(io::stdout(), "{}", table::beside(&outcomes, earlier))?;
    }
    let raw = table::raw(&outcomes, &programs, &began, load);
    let all = !cli.quick && cli.only.is_empty() && cli.peers.is_empty() && !cli.no_write;
    let docs = root().join("docs");
    let raw_file = cli
        .raw
        .clone()
        .or_else(|| all.then(|| docs.join("benchmarks.json")));
    if let Some(file) = raw_file {
        let text = serde_json::to_string_pretty(&raw)? + "\n";
        fs::write(&file, text).with_context(|| format!("{} cannot be written", file.display()))?;
        say(&format!("raw figures in {}", file.display()));
    }
    match all {
        true => write(&docs, &markdown, &outcomes),
        false => Ok(()),
    }
}

/// The document anew from figures that are there.
fn again(programs: &Programs, cli: &Cli) -> Result<()> {
    let docs = root().join("docs");
    let figures = docs.join("benchmarks.json");
    let raw = read(cli.against.as_deref().unwrap_or(&figures))?;
    let outcomes = table::from_raw(&raw);
    let counts = outcomes
        .iter()
        .flat_map(|outcome| outcome.samples.values().map(Vec::len));
    let runs = counts.max().unwrap_or_default();
    let load = raw.get("load-before").and_then(serde_json::Value::as_f64);
    write(
        &docs,
        &table::markdown(&outcomes, programs, runs, load),
        &outcomes,
    )
}

fn rows(cli: &Cli) -> Result<Vec<Row>> {
    let wanted =
        |row: &Row| cli.only.is_empty() || cli.only.iter().any(|part| row.name.contains(part.as_str()));
    let rows: Vec<Row> = ROWS.into_iter().filter(wanted).collect();
    if rows.is_empty() {
        let names = ROWS.map(|row| row.name).join("\n  ");
        bail!("no scenario is called so; there are\n  {names}");
    }
    Ok(rows)
}

fn unknown(name: &str) -> String {
    let peers = Kind::ALL.into_iter().filter(|kind| kind.is_peer());
    let names: Vec<_> = peers.map(Kind::name).collect();
    format!("there is no peer {name}; there are {}", names.join(", "))
}

/// Leaves out what needs network namespaces where they cannot be made, and says so.
fn without_namespaces(mut rows: Vec<Row>) -> Vec<Row> {
    if rows.iter().any(|row| row.load == Load::Stop)
        && let Err(error) = mom_rivals::SlowLink::new()
    {
        say(&format!(
            "the saturated stop is left out: no network namespaces here: {error}"
        ));
        rows.retain(|row| row.load != Load::Stop);
    }
    rows
}

fn write(docs: &Path, markdown: &str, outcomes: &[Outcome]) -> Result<()> {
    let document = docs.join("benchmarks.md");
    let failed = || format!("{} cannot be changed", document.display());
    let images = docs.join("images");
    fs::create_dir_all(&images).with_context(failed)?;
    let of = |takes: &dyn Fn(Load) -> bool| -> Vec<&Outcome> {
        outcomes
            .iter()
            .filter(|outcome| takes(outcome.row.load))
            .collect()
    };
    let streams = of(&|load| matches!(load, Load::Stream(_)));
    let trips = of(&|load| load == Load::PingPong);
    let stop = of(&|load| load == Load::Stop);
    let plots = [
        ("rates", "Deliveries per second", &streams, Metric::Rate),
        (
            "cpu",
            "CPU seconds of the hub per million deliveries",
            &streams,
            Metric::Cpu,
        ),
        ("ping-pong", "Round trip, p50 in µs", &trips, Metric::P50),
        (
            "stop",
            "A stop on a saturated link, p99 in µs",
            &stop,
            Metric::P99,
        ),
    ];
    let mut text = markdown.to_owned();
    for (name, title, outcomes, metric) in plots {
        if let Some(plot) = mom_rivals::bars(title, outcomes, metric) {
            let file = format!("bench-{name}.svg");
            fs::write(images.join(&file), plot).with_context(failed)?;
            text += &format!("\n![{title}](images/{file})\n");
        }
    }
    let before = fs::read_to_string(&document).with_context(failed)?;
    let after = report::insert_between(&before, table::BEGIN, table::END, &text)
        .with_context(|| format!("it needs the lines {} and {}", table::BEGIN, table::END))
        .with_context(failed)?;
    fs::write(&document, after).with_context(failed)?;
    say(&format!("written into {}", document.display()));
    Ok(())
}

fn read(file: &Path) -> Result<serde_json::Value> {
    let text = fs::read_to_string(file).with_context(|| format!("{} cannot be read", file.display()))?;
    serde_json::from_str(&text).with_context(|| format!("{} holds no figures", file.display()))
}

fn program(named: Option<&Path>, name: &str) -> Result<PathBuf> {
    let own = env::current_exe().context("where this program lies is not known")?;
    let path = named.map_or_else(|| own.with_file_name(name), Path::to_owned);
    match path.is_file() {
        true => Ok(path),
        false => bail!(
            "there is no {}; `cargo xtask bench-peers` builds it",
            path.display()
        ),
    }
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Now, in UTC, as every clock of this project writes it.
fn now() -> String {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    let seconds = since.map_or(0, |since| i64::try_from(since.as_secs()).unwrap_or_default());
    let mut text = Vec::new();
    if let Some(time) = mom_proto::Time::from_micros(seconds.saturating_mul(1_000_000)) {
        time.write(&mut text);
    }
    String::from_utf8(text).unwrap_or_default()
}

fn say(what: &str) {
    // Standard error may be closed; nothing is lost then.
    let _ = writeln!(io::stderr(), "{what}");
}
