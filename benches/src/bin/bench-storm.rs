//! Measures what a storm of lost connections costs: many peers with a link lose theirs at once and come back at once, beside an
//! operator who stops and drives a robot.

use std::io::{BufRead as _, BufReader, Write};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::{Child, Command, ExitCode, Stdio};
use std::time::{Duration, Instant};
use std::{env, fs, io};

use anyhow::{Context, Result, bail};
use clap::{Parser, Subcommand};
use mom_benches::isolation::{Canary, Song};
use mom_benches::{Process, control, machine};
use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel};
use mom_tests::attacks::configuration;
use mom_tests::linked::{Link, Linked};
use mom_tests::raw::{Raw, at};
use tokio::task::JoinSet;

const EXAMPLES: &str = "Examples:
  cargo build --release -p mom-broker && cargo run --release --manifest-path benches/Cargo.toml --bin bench-storm
  target/release/bench-storm --peers 2000";

/// Peers that come back at a time.
const AT_ONCE: usize = 256;

/// Peers with a link that lose their connections at once and come back at once, beside a canary.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    task: Option<Task>,
    /// How many peers.
    #[arg(long, default_value_t = 9_900)]
    peers: usize,
    /// The niceness of the broker; below 0 as a service may have it, which takes the right to do so
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    nice: i32,
    /// The broker's program; the one beside this program if none is named.
    #[arg(long)]
    broker: Option<PathBuf>,
}

#[derive(Subcommand)]
enum Task {
    /// The peers, as the measurement starts them.
    #[command(hide = true)]
    Peers {
        count: usize,
        address: SocketAddr,
        /// They ask for no link.
        #[arg(long)]
        plain: bool,
    },
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(io::stderr(), "bench-storm: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(cli: &Cli) -> Result<()> {
    if let Some(Task::Peers {
        count,
        address,
        plain,
    }) = cli.task
    {
        return peers(count, address, plain);
    }
    let broker = match &cli.broker {
        Some(broker) => broker.clone(),
        None => env::current_exe()?.with_file_name("mom-broker"),
    };
    let folder = tempfile::tempdir()?;
    let config = folder.path().join("storm.toml");
    fs::write(&config, configured()?)?;
    let start = || {
        let mut command = Command::new(&broker);
        command.arg("--config").arg(&config);
        command.env("MOM_NICENESS", cli.nice.to_string());
        Process::start(command)
    };
    let mut out = io::stdout();
    writeln!(out, "{}; {} peers", machine::describe(), cli.peers)?;
    let hub = start()?;
    let (crowd, each) = Crowd::start(cli.peers, &hub, true)?;
    writeln!(
        out,
        "memory of the hub: {each:.1} KiB for each idle peer without a link"
    )?;
    crowd.end();
    hub.end();
    let hub = start()?;
    let (mut crowd, each) = Crowd::start(cli.peers, &hub, false)?;
    writeln!(
        out,
        "memory of the hub: {each:.1} KiB for each idle peer with one"
    )?;
    let address = hub.address().to_owned();
    let (idle, under, report) = control::run(async {
        let mut canary = Canary::start(&address).await?;
        let idle = canary.sing(Duration::from_secs(5)).await?;
        crowd.storm();
        let under = canary.sing(Duration::from_secs(10)).await?;
        Ok((idle, under, crowd.report()))
    })?;
    writeln!(out, "{}", report?)?;
    writeln!(
        out,
        "stops, p50 / p99 / worst in ms: {} before, {} in the storm",
        quantiles(&idle),
        quantiles(&under)
    )?;
    writeln!(
        out,
        "the hub used {:.1} s of its processor in all",
        hub.cpu().unwrap_or_default().as_secs_f64()
    )?;
    if let Some(most) = hub.most_memory() {
        writeln!(out, "most memory of the hub: {} MiB", most >> 20)?;
    }
    crowd.end();
    hub.end();
    Ok(())
}

/// The configuration of the broker that is attacked, with room for a crowd of guests.
fn configured() -> Result<String> {
    let text = fs::read_to_string(configuration()).context("tests/attacked.toml")?;
    let users = configuration().with_file_name("../config/lab-users.toml");
    let users = format!("users = {:?}", users.canonicalize()?);
    let room = "connections = 20000\nconnections-before-login = 20000\nconnections-per-address = 20000\nconnections-per-user = 20000";
    let text = text.replace(
        "users = \"../config/lab-users.toml\"",
        &format!("{users}\n{room}"),
    );
    Ok(format!(
        "{text}\n[login]\nguests = true\n\n[[contexts]]\npath = \"/crowded\"\nkind = \"channel\"\npresence = \"none\"\n"
    ))
}

fn quantiles(song: &Song) -> String {
    let [middle, high, worst] = [0.5, 0.99, 1.0].map(|part| song.stops.quantile(part) / 1000.0);
    format!("{middle:.2} / {high:.2} / {worst:.1}")
}

/// The peers, in a process of their own.
struct Crowd {
    child: Child,
    heard: BufReader<std::process::ChildStdout>,
}

impl Crowd {
    /// Has them log in, with a link or without; gives by how many KiB the hub has grown for each.
    fn start(count: usize, hub: &Process, plain: bool) -> Result<(Crowd, f64)> {
        let before = hub.memory().unwrap_or_default();
        let mut command = Command::new(env::current_exe()?);
        command.args(["peers", &count.to_string(), hub.address()]);
        command.args(plain.then_some("--plain"));
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
        let heard = BufReader::new(child.stdout.take().context("its output")?);
        let mut crowd = Crowd { child, heard };
        if crowd.report()? != "ready" {
            bail!("the peers cannot log in");
        }
        let grown = hub.memory().unwrap_or_default().saturating_sub(before);
        Ok((crowd, grown as f64 / count as f64 / 1024.0))
    }

    /// Tells them to lose their connections and to come back.
    fn storm(&mut self) {
        if let Some(input) = &mut self.child.stdin {
            let _ = input.write_all(b"lose\n").and_then(|()| input.flush());
        }
    }

    /// What they say next.
    fn report(&mut self) -> Result<String> {
        let mut line = String::new();
        self.heard.read_line(&mut line)?;
        match line.trim_end() {
            "" => bail!("the peers have ended"),
            line => Ok(line.to_owned()),
        }
    }

    fn end(mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Logs peers in, says so, and lets them lose their connections and come back when told.
fn peers(count: usize, address: SocketAddr, plain: bool) -> Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    runtime.block_on(async {
        if plain {
            let peers = in_turns(1, 0..count, |_| async move {
                let mut raw = Raw::connect(address, Form::Binary).await;
                let guest = Map::new().with("guest", true);
                let login = Parcel::new(Family::Login, "login").content(guest);
                raw.ask(login).await.expect("guests are let in");
                let join = Parcel::new(Family::Context, "join").context(at("/crowded"));
                raw.ask(join).await.expect("everybody may join");
                raw
            })
            .await;
            writeln!(io::stdout(), "ready")?;
            io::stdin().read_line(&mut String::new())?;
            drop(peers);
            return Ok(());
        }
        // One after the other, as where all other idle peers are measured: a crowd at once leaves gaps in the hub's memory.
        let mut linked = in_turns(1, 0..count, |_| async move {
            let content = Map::new().with("guest", true);
            let mut linked = Linked::log_in(address, Form::Binary, content, 120_000).await;
            linked.about(Family::Context, "join", "/crowded").await;
            // As any client does sooner or later.
            linked.acknowledge().await;
            linked
        })
        .await;
        writeln!(io::stdout(), "ready")?;
        let mut line = String::new();
        io::stdin().read_line(&mut line)?;
        let links: Vec<Link> = linked.drain(..).map(|linked| linked.link).collect();
        let begin = Instant::now();
        let back = in_turns(AT_ONCE, links, |link| async move {
            let resumed = link.resume(address, Form::Binary).await;
            resumed.map(|(linked, _)| linked).map_err(|(error, _)| error)
        })
        .await;
        let took = begin.elapsed();
        let resumed = back.iter().filter(|back| back.is_ok()).count();
        writeln!(
            io::stdout(),
            "{resumed} of {count} have resumed after {:.2} s",
            took.as_secs_f64()
        )?;
        // The connections stay as long as they are measured.
        io::stdin().read_line(&mut line)?;
        drop(back);
        Ok(())
    })
}

/// Does something for all, for so many at a time.
async fn in_turns<T, R, F>(at_once: usize, all: impl IntoIterator<Item = T>, task: impl Fn(T) -> F) -> Vec<R>
where
    F: Future<Output = R> + 'static,
    R: 'static,
{
    let local = tokio::task::LocalSet::new();
    local
        .run_until(async {
            let (mut running, mut done) = (JoinSet::new(), Vec::new());
            for one in all {
                if running.len() >= at_once {
                    done.extend(running.join_next().await.and_then(Result::ok));
                }
                running.spawn_local(task(one));
            }
            while let Some(ended) = running.join_next().await {
                done.extend(ended);
            }
            done
        })
        .await
}
