//! CUBO as a program of its own: a thin robot, here a simulated one.

use std::ffi::OsString;
use std::io::{IsTerminal, Write as _};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::pin::pin;

use crate::{Cubo, CuboHandle, serve, serve_page};
use anyhow::{Context, bail};
use clap::Parser;
use mom_pages::Interrupt;
use mom_rsp::Key;
use mom_rsp::robot::Settings;
use mom_trace::Trace;
use mom_wheels::Pose;
use tokio::net::{TcpListener, UdpSocket};
use tracing_subscriber::EnvFilter;

const EXAMPLES: &str = "\
Examples:
  mom-cubo --listen 127.0.0.1:7700
  mom-cubo --write-key cubo.key
  mom-cubo --write-model cubo.toml
  mom-cubo --listen 0.0.0.0:7700 --robot-key cubo.key --at 1000,1000,90
  mom-cubo --web 127.0.0.1:8080

It waits for the computer that thinks for it (mom-simulacrum), rests when nothing was heard of that for 500 ms, and plans nothing by itself.
With a key it answers only who has it. Without one packets travel in the open, which is for loopback and trials. The log goes to the standard
error; RUST_LOG says how much of it. Ctrl-C and SIGTERM end the session and the program.";

/// CUBO, a thin robot that is mirrored over RSP; here a simulated one.
#[derive(Debug, Parser)]
#[command(name = "mom-cubo", version, after_help = EXAMPLES)]
struct CuboArgs {
    /// Where it listens (UDP); port 0 takes a free one, which is said
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:7700")]
    listen: SocketAddr,
    /// A file with the key that it shares with the middle: 64 hexadecimal digits
    #[arg(long, value_name = "FILE")]
    robot_key: Option<PathBuf>,
    /// Write a new key into this file, which must not be there, and end
    #[arg(long, value_name = "FILE")]
    write_key: Option<PathBuf>,
    /// Write the robot's model into this file, which must not be there, and end: its middle needs it (mom-simulacrum --model)
    #[arg(long, value_name = "FILE")]
    write_model: Option<PathBuf>,
    /// ms without a packet after which it rests
    #[arg(long, value_name = "MS", default_value = "500", value_parser = clap::value_parser!(u16).range(50..=10_000))]
    watchdog: u16,
    /// Address of its own page (HTTP), open to all who can reach it: the state of its body, also as /status.json;
    /// port 0 takes a free one, which is said
    #[arg(long, value_name = "ADDRESS:PORT")]
    web: Option<SocketAddr>,
    /// Where it begins on its floor of 5 m by 5 m: mm, mm, degrees
    #[arg(
        long,
        value_name = "X,Y,HEADING",
        value_delimiter = ',',
        num_args = 1,
        allow_hyphen_values = true,
        default_value = "2500,2500,0"
    )]
    at: Vec<f64>,
    /// Write where the simulated body is, every 10 ms, into this file, for tests
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
}

/// Runs the program with these arguments, of which the first is its name, until it is done or told to end.
///
/// # Errors
///
/// What the program ends by; wrong arguments end the process.
#[tokio::main(flavor = "current_thread")]
pub async fn run(args: Vec<OsString>) -> anyhow::Result<()> {
    if let Some(written) = mom_pages::asked::<CuboArgs>(&args) {
        return Ok(written?);
    }
    let args = CuboArgs::parse_from(args);
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        // A terminal that is gone takes no complaint either, and to insist would panic.
        .log_internal_errors(false)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    if let Some(file) = &args.write_key {
        return write_key(file);
    }
    if let Some(file) = &args.write_model {
        return write_new(file, 0o644, crate::MODEL);
    }
    let pose = match *args.at {
        [x, y, heading] if heading.is_finite() => Pose::new(x, y, heading),
        _ => bail!("--at takes three numbers, such as 1000,1000,90: mm, mm and degrees"),
    };
    let mut body = Cubo::new(pose).context("--at is a place within the walls, 110 mm from each")?;
    if let Some(file) = &args.trace {
        body.trace(Trace::open(file).with_context(|| format!("cannot write {}", file.display()))?);
    }
    let settings = Settings {
        key: args.robot_key.as_deref().map(read_key).transpose()?,
        watchdog: args.watchdog,
        ..Settings::default()
    };
    let mut interrupt = Interrupt::install()?;
    let mut shutdown = pin!(interrupt.wait());
    let socket = UdpSocket::bind(args.listen)
        .await
        .with_context(|| format!("cannot listen on {}", args.listen))?;
    writeln!(std::io::stdout(), "cubo listens on {}", socket.local_addr()?)?;
    let robot = CuboHandle::new(body, settings)?;
    let page = match args.web {
        Some(web) => Some(listen(web).await?),
        None => None,
    };
    let page = page.map(|page| tokio::spawn(serve_page(page, robot.clone())));
    tracing::info!("the robot waits for its controller");
    let served = serve(socket, robot, &mut shutdown).await;
    if let Some(page) = page {
        page.abort();
    }
    served.context("the socket failed")
}

/// The listener of its page.
async fn listen(web: SocketAddr) -> anyhow::Result<TcpListener> {
    let page = TcpListener::bind(web)
        .await
        .with_context(|| format!("cannot listen on {web}"))?;
    writeln!(
        std::io::stdout(),
        "cubo shows itself on http://{}/",
        page.local_addr()?
    )?;
    Ok(page)
}

fn write_key(file: &std::path::Path) -> anyhow::Result<()> {
    let mut key: Key = [0; 32];
    getrandom::fill(&mut key).context("the system gives no random numbers")?;
    let digits: String = key.iter().map(|byte| format!("{byte:02x}")).collect();
    // For its owner's eyes.
    write_new(file, 0o600, &(digits + "\n"))
}

/// Writes a file that is not there.
fn write_new(file: &std::path::Path, mode: u32, text: &str) -> anyhow::Result<()> {
    use std::os::unix::fs::OpenOptionsExt as _;
    let mut options = std::fs::OpenOptions::new();
    // Never over another one.
    let opened = options.write(true).create_new(true).mode(mode).open(file);
    let mut opened = opened.with_context(|| format!("cannot write {}", file.display()))?;
    opened.write_all(text.as_bytes())?;
    writeln!(std::io::stdout(), "wrote {}", file.display())?;
    Ok(())
}

/// 64 hexadecimal digits, the first line of the file.
fn read_key(file: &std::path::Path) -> anyhow::Result<Key> {
    let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    mom_rsp::key(text.lines().next().unwrap_or_default().trim())
        .with_context(|| format!("{}: a key is 64 hexadecimal digits", file.display()))
}
