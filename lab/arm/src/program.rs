//! The robot arm of the lab as a program of its own.

use std::ffi::OsString;
use std::path::PathBuf;
use std::time::Duration;

use crate::controller::{Controller, LinkFault, Traced};
use crate::{ArmMachine, ArmOptions, Mount, peer};
use anyhow::Context;
use clap::Parser;
use mom_pages::duration_within;
use mom_program::{HubArgs, begin, shutdown};
use mom_trace::Trace;

const EXAMPLES: &str = "\
Examples:
  MOM_PASSWORD=arm mom-arm
  mom-arm --hub tcp://127.0.0.1:7666 --password-file arm.secret
  mom-arm --hub bin://lab.example.org --key arm.key
  mom-arm --key arm.key --max-age 500ms
  MOM_PASSWORD=arm mom-arm --link-fault 30s/2s
  MOM_PASSWORD=arm mom-arm --zones /zone --mount 500,0,180
  RUST_LOG=debug MOM_PASSWORD=arm mom-arm --channel /robot/arm

Where its session, token or channel is missing, the arm makes it if it may. The password is that of MOM_PASSWORD, unless --password-file names a file. A key (mom keygen) is taken from
anywhere, a password over TLS (bins://, tcps://) or loopback. Where there is no hub yet it waits. The log goes to the standard error; RUST_LOG says how much of it. Ctrl-C and SIGTERM halt the arm and end the program.";

/// The robot arm of the demonstration lab: obeys the scripts of the token's owner and tells its state.
#[derive(Debug, Parser)]
#[command(name = "mom-arm", version, after_help = EXAMPLES, mut_arg("user", |user| user.default_value("arm")))]
struct ArmArgs {
    #[command(flatten)]
    hub: HubArgs,
    /// The channel of commands and states
    #[arg(long, value_name = "PATH", default_value = "/robot/arm")]
    channel: String,
    /// The token that guards the channel where the arm has to make it: `token` beside the channel, if none is named
    #[arg(long, value_name = "PATH")]
    token: Option<String>,
    /// The manager of that token, by its name in the hub's configuration, where the arm has to make it; without it: that of the session
    #[arg(long, value_name = "NAME")]
    manager: Option<String>,
    /// Refuse commands that are older than this when they begin, whatever their senders say: a time such as 500ms or 2s
    #[arg(long, value_name = "TIME", value_parser = time())]
    max_age: Option<Duration>,
    /// Let the simulated link to the controller fail (M53): it stands for the first time, is down for the second, again and again, such as
    /// 30s/2s
    #[arg(long, value_name = "UP/DOWN", value_parser = link_fault)]
    link_fault: Option<LinkFault>,
    /// Keep out of the zones that the commander does not own (M40): the tokens of this session, which tell their boxes
    #[arg(long, value_name = "PATH")]
    zones: Option<String>,
    /// Where the arm's table stands in the frame of the zones: mm, mm and degrees
    #[arg(long, value_name = "X,Y,YAW", default_value = "0,0,0", allow_hyphen_values = true, value_parser = clap::value_parser!(Mount))]
    mount: Mount,
    /// Let the simulated arm's time pass so many times as fast as real time, to try much in little time; 100 at most
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u32).range(1..=100))]
    pace: u32,
    /// Write where the simulated body is, every 10 ms, into this file, for tests
    #[arg(long, value_name = "FILE", conflicts_with = "pace")]
    trace: Option<PathBuf>,
}

/// A time that is not nothing.
fn time() -> impl Fn(&str) -> Result<Duration, String> + Clone + Send + Sync + 'static {
    duration_within(Duration::from_millis(1)..=Duration::from_secs(86_400))
}

/// `30s/2s`.
fn link_fault(text: &str) -> anyhow::Result<LinkFault> {
    let (after, lasting) = text
        .split_once('/')
        .context("it must be two times, such as 30s/2s")?;
    let micros = |text: &str| {
        anyhow::Ok(i64::try_from(
            time()(text).map_err(anyhow::Error::msg)?.as_micros(),
        )?)
    };
    Ok(LinkFault {
        after: micros(after)?,
        lasting: micros(lasting)?,
    })
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
    let Some(args) = begin::<ArmArgs>(args, "info")? else {
        return Ok(());
    };
    let mut shutdown = Box::pin(shutdown()?);
    let login = args.hub.login("mom-arm", env!("CARGO_PKG_VERSION"))?;
    let Some(client) = args.hub.connect(login, &mut shutdown).await? else {
        return Ok(());
    };
    let options = ArmOptions {
        channel: args.channel,
        token: args.token,
        manager: args.manager,
        // The peer that expelled it may have started another one, and a supervisor starts it again.
        comes_back: false,
        max_age: args.max_age,
        link_fault: args.link_fault,
        zones: args.zones,
        mount: args.mount,
        pace: args.pace,
    };
    let controller: Box<dyn Controller> = match &args.trace {
        Some(file) => {
            let trace = Trace::open(file).with_context(|| format!("cannot write {}", file.display()))?;
            Box::new(Traced::new(options.controller(), trace))
        }
        None => Box::new(options.controller()),
    };
    peer::run_arm(client, options, ArmMachine::new(controller), shutdown)
        .await
        .context("the arm ended")
}
