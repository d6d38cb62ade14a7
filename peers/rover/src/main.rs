//! A robot that is a peer itself, as a program of its own.

use std::future::Future;
use std::io::IsTerminal;
use std::path::PathBuf;
use std::pin::pin;
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use clap::Parser;
use mom_client::{Client, Key, Path, Proof};
use mom_rover::{Rover, RoverOptions, run};
use mom_wheels::{Chassis, Floor, Pose, Power, Simulated};
use tokio::signal::unix::{SignalKind, signal};
use tracing_subscriber::EnvFilter;

/// For how long the hub keeps its place when the connection is lost.
const GRACE: Duration = Duration::from_secs(30);

const EXAMPLES: &str = "\
Examples:
  MOM_PASSWORD=rover-a mom-rover --name a --tell /convoy --at 2000,1000,0
  MOM_PASSWORD=rover-b mom-rover --name b --in /convoy --at 1000,1000,0
  mom-rover --path /fleet/12 --user rover-12 --key rover-12.key
  mom-rover --name a --hub bins://lab.example.org --key rover-a.key --pull 1000

The robot is the session /rover/NAME, with the channel robot and the token token, which are made where they are missing. Whoever holds the token
drives it with motor, goto, via, leds and wait, as the robots of a gateway, and has it follow another one with `follow rover-a 500`: the peer's
name and mm behind it, until another command comes. A robot with --pull is fed by `mom fleet feed`. The password is that of MOM_PASSWORD,
unless --password-file names a file. A key (mom keygen) is taken from anywhere, a password over TLS (bins://, tcps://) or loopback. Where there
is no hub yet it waits. The log goes to the standard error; RUST_LOG says how much of it. Ctrl-C and SIGTERM halt the robot and end the program.";

/// A wheeled robot that is a peer of the hub itself; here a simulated one.
#[derive(Debug, Parser)]
#[command(name = "mom-rover", version, after_help = EXAMPLES)]
struct RoverArgs {
    /// Its name: it is /rover/NAME, and logs in as rover-NAME
    #[arg(long, required_unless_present = "path")]
    name: Option<String>,
    /// Its session instead of /rover/NAME, such as /fleet/12 beside the robots of a gateway
    #[arg(long)]
    path: Option<String>,
    /// Tell in this channel where it is, so that others can follow it
    #[arg(long, value_name = "CHANNEL")]
    tell: Option<String>,
    /// Hear in this channel where its leader is
    #[arg(long = "in", value_name = "CHANNEL")]
    hear: Option<String>,
    /// Ask for each command, again every so many ms, and take none that is late
    #[arg(long, value_name = "MS", num_args = 0..=1, default_missing_value = "1000",
        value_parser = clap::value_parser!(u64).range(50..=60_000))]
    pull: Option<u64>,
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
    /// The manager of its token, by its name in the hub's configuration; without it: that of the session
    #[arg(long, value_name = "NAME")]
    manager: Option<String>,
    /// The hub, as bin://host:port (binary) or tcp://host:port (XML), bins:// or tcps:// with TLS, which may end in ?pin=FINGERPRINT
    #[arg(long, env = "MOM_HUB", default_value = "bin://127.0.0.1:7666")]
    hub: String,
    /// The user to log in as instead of rover-NAME
    #[arg(long)]
    user: Option<String>,
    /// A file whose first line is the password
    #[arg(long, value_name = "FILE", conflicts_with = "key")]
    password_file: Option<PathBuf>,
    /// A file with the private key of the user, as mom keygen makes it; it needs no password
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
}

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    if let Some(written) = mom_pages::asked::<RoverArgs>() {
        return Ok(written?);
    }
    let args = RoverArgs::parse();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    let mut shutdown = pin!(shutdown()?);
    let options = options(&args)?;
    let robot = Simulated::new(Chassis::LINUXBOT, Power::LINUXBOT, Floor::ARENA, start(&args.at)?)
        .context("--at is a place within the walls, 100 mm from each")?;
    let rover = Rover::new(Box::new(robot), Chassis::LINUXBOT, options.unit());
    let name = options.path.rsplit('/').next().unwrap_or_default();
    let user = args.user.clone().unwrap_or_else(|| format!("rover-{name}"));
    let connecting = Client::builder(&args.hub)
        .user(&user)
        .proof(proof(&args)?)
        .link(GRACE)
        .wait_for_hub();
    let connected = tokio::select! {
        connected = connecting.connect() => connected,
        () = &mut shutdown => return Ok(()),
    };
    let client = connected.with_context(|| format!("{user} cannot log in at {}", args.hub))?;
    let path = options.path.clone();
    let ended = run(client, rover, options, shutdown).await;
    ended.with_context(|| {
        format!("the robot ended; `mom explain --help` says how to learn what {user} may do in {path} and its convoy")
    })
}

fn options(args: &RoverArgs) -> anyhow::Result<RoverOptions> {
    let path = match (&args.path, &args.name) {
        (Some(path), _) => path.clone(),
        (None, name) => format!("/rover/{}", name.as_deref().unwrap_or_default()),
    };
    for path in [Some(&path), args.tell.as_ref(), args.hear.as_ref()]
        .into_iter()
        .flatten()
    {
        let read = Path::parse(path);
        read.with_context(|| format!("{path:?} is no path of a context; one is such as /rover/a"))?;
    }
    Ok(RoverOptions {
        path,
        manager: args.manager.clone(),
        tell: args.tell.clone(),
        hear: args.hear.clone(),
        pull: args.pull.map(Duration::from_millis),
    })
}

fn start(at: &[f64]) -> anyhow::Result<Pose> {
    match at {
        &[x, y, heading] if heading.is_finite() => Ok(Pose::new(x, y, heading)),
        _ => bail!("--at takes three numbers, such as 1000,1000,90: mm, mm and degrees"),
    }
}

/// Authenticates by key if there is one.
fn proof(args: &RoverArgs) -> anyhow::Result<Proof> {
    if let Some(file) = &args.key {
        return Ok(Proof::Key(Key::from_file(file).context("--key")?));
    }
    let Some(file) = &args.password_file else {
        let password = std::env::var("MOM_PASSWORD");
        return password
            .map(Proof::Password)
            .map_err(|_| anyhow!("set MOM_PASSWORD, or name a file with --password-file or --key"));
    };
    let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    Ok(Proof::Password(
        text.lines().next().unwrap_or_default().to_owned(),
    ))
}

/// Done at Ctrl-C or SIGTERM.
fn shutdown() -> anyhow::Result<impl Future<Output = ()>> {
    let mut interrupt = signal(SignalKind::interrupt()).context("cannot listen for Ctrl-C")?;
    let mut terminate = signal(SignalKind::terminate()).context("cannot listen for SIGTERM")?;
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
        tracing::info!("ending");
    })
}
