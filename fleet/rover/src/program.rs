//! A robot that is a peer itself, as a program of its own.

use std::ffi::OsString;
use std::path::PathBuf;
use std::time::Duration;

use crate::RoverOptions;
use anyhow::{Context, bail};
use clap::Parser;
use mom_client::Path;
use mom_program::{HubArgs, begin, shutdown};
use mom_trace::Trace;
use mom_wheeled::{Model, Rover};
use mom_wheels::{Driver, Floor, Point, Pose, Simulated, Traced};

const EXAMPLES: &str = "\
Examples:
  MOM_PASSWORD=rover-a mom-rover --name a --tell /convoy --at 2000,1000,0
  MOM_PASSWORD=rover-b mom-rover --name b --in /convoy --at 1000,1000,0
  mom-rover --path /fleet/12 --user rover-12 --key rover-12.key
  mom-rover --name a --hub bins://lab.example.org --key rover-a.key --pull 1000
  MOM_PASSWORD=rover-a mom-rover --name a --model config/lego.toml --charger 2500,2500 --battery 40

The robot is the session /rover/NAME, with the channel robot and the token token, which are made where they are missing. The owner of the token
drives it with motor, goto, via, leds and wait, as the robots of a gateway, and has it follow another one with `follow rover-a 500`: the peer's
name and mm behind it, until another command comes. A robot with --pull is fed by `mom fleet feed`. The password is that of MOM_PASSWORD,
unless --password-file names a file. A key (mom keygen) is taken from anywhere, a password over TLS (bins://, tcps://) or loopback. Where there
is not a hub yet it waits. The log goes to the standard error; RUST_LOG says how much of it. Ctrl-C and SIGTERM halt the robot and end the program.";

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
    /// What it is like, as config/lego.toml says it: geometry, battery, sensors; without it: the robot of the second paper
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Where its charger stands, mm, mm: it is charged while it stands there
    #[arg(
        long,
        value_name = "X,Y",
        value_delimiter = ',',
        num_args = 1,
        allow_hyphen_values = true
    )]
    charger: Vec<f64>,
    /// What is in its battery, in percent
    #[arg(long, value_name = "PERCENT", default_value = "100", value_parser = clap::value_parser!(u8).range(0..=100))]
    battery: u8,
    /// The manager of its token, by its name in the hub's configuration; without it: that of the session
    #[arg(long, value_name = "NAME")]
    manager: Option<String>,
    /// Write where the simulated body is, every 10 ms, into this file, for tests
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    #[command(flatten)]
    hub: HubArgs,
}

/// Runs the program with these arguments, of which the first is its name, until it is done or told to end.
///
/// # Errors
///
/// What the program ends by; wrong arguments end the process.
pub fn run(args: Vec<OsString>) -> anyhow::Result<()> {
    mom_program::block_on(Box::pin(work(args)))
}

async fn work(args: Vec<OsString>) -> anyhow::Result<()> {
    let Some(mut args) = begin::<RoverArgs>(args, "info")? else {
        return Ok(());
    };
    let mut shutdown = Box::pin(shutdown()?);
    let options = options(&args)?;
    let model = model(args.model.as_deref())?;
    let robot = simulated(&model, &args)?;
    let driver: Box<dyn Driver> = match &args.trace {
        Some(file) => {
            let trace = Trace::open(file).with_context(|| format!("cannot write {}", file.display()))?;
            Box::new(Traced::new(robot, trace))
        }
        None => Box::new(robot),
    };
    let rover = Rover::new(driver, model.chassis, options.unit());
    let name = options.path.rsplit('/').next().unwrap_or_default();
    args.hub.or_user(&format!("rover-{name}"));
    let login = args.hub.login("mom-rover", env!("CARGO_PKG_VERSION"))?;
    let Some(client) = args.hub.connect(login, &mut shutdown).await? else {
        return Ok(());
    };
    let path = options.path.clone();
    let ended = crate::run(client, rover, options, shutdown).await;
    ended.with_context(|| {
        format!(
            "the robot ended; `mom explain --help` says how to learn what {} may do in {path} and its convoy",
            args.hub.user()
        )
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
        read.with_context(|| format!("{path:?} is not a path of a context; one is such as /rover/a"))?;
    }
    Ok(RoverOptions {
        path,
        manager: args.manager.clone(),
        tell: args.tell.clone(),
        hear: args.hear.clone(),
        pull: args.pull.map(Duration::from_millis),
    })
}

fn model(file: Option<&std::path::Path>) -> anyhow::Result<Model> {
    let Some(file) = file else {
        return Ok(Model::LINUXBOT);
    };
    let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    Model::parse(&text).with_context(|| file.display().to_string())
}

/// The robot on its floor, with its battery and its charger.
fn simulated(model: &Model, args: &RoverArgs) -> anyhow::Result<Simulated> {
    let robot = Simulated::new(model.chassis, model.power, Floor::ARENA, start(&args.at)?)
        .with_context(|| {
            format!(
                "--at is a place within the walls, {} mm from each",
                model.chassis.radius
            )
        })?
        .with_fittings(model.fittings)
        .with_battery(args.battery);
    match args.charger[..] {
        [] => Ok(robot),
        [x, y] if x.is_finite() && y.is_finite() => Ok(robot.with_charger(Point::new(x, y))),
        _ => bail!("--charger takes two numbers, such as 1000,1000: mm and mm"),
    }
}

fn start(at: &[f64]) -> anyhow::Result<Pose> {
    match at {
        &[x, y, heading] if heading.is_finite() => Ok(Pose::new(x, y, heading)),
        _ => bail!("--at takes three numbers, such as 1000,1000,90: mm, mm and degrees"),
    }
}
