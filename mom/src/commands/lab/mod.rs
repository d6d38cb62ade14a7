//! `mom lab`: a hub, a robot arm, five cameras, their model of the objects and two agents in one process, to try; or two arms, a
//! fleet, or a thin robot.

use std::env;
use std::io::{self, IsTerminal as _};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use mom_arm::{ArmOptions, Mount};
use mom_broker::{Broker, BrokerError, Config, TlsConfig};
use mom_calibrate::agent::AgentOptions;
use mom_camera::{CameraOptions, View};
use mom_client::{Client, ClientError, Code};
use mom_model::ModelOptions;
use mom_servo::peer::ServoOptions;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep};
use tracing_subscriber::EnvFilter;

use crate::cli;
use crate::failure::{Doing as _, Failure};
use crate::output::Output;
use crate::output::style::{Tone, ink};
use mom_pages::Interrupt;

mod cubo;
mod eyes;
mod fleet;
mod summary;

use eyes::Eyes;
use summary::LabSummary;

/// The default address of the hub, where the other commands look for it.
const USUAL: &str = "127.0.0.1:7666";
/// The two arms: user, channel, and where the table is in the frame of the zones (as config/two-arms.toml says).
const TWO_ARMS: [(&str, &str, Mount); 2] = [
    (
        "arm",
        "/robot/arm",
        Mount {
            x: 0.0,
            y: 0.0,
            yaw: 0.0,
        },
    ),
    (
        "arm-2",
        "/robot-2/arm",
        Mount {
            x: 500.0,
            y: 0.0,
            yaw: 180.0,
        },
    ),
];
/// Bytes of what the hub of the lab decides that are recorded.
const RECORDED: u64 = 32 * 1024 * 1024;
/// The longest time for the devices to join their channels.
const READY: Duration = Duration::from_secs(5);
const LOOK: Duration = Duration::from_millis(10);

/// What is in a lab.
#[derive(Debug, Clone, Copy)]
enum Kind {
    Arm,
    TwoArms,
    Fleet { robots: u16, together: bool },
    Cubo,
}

impl Kind {
    fn of(args: &cli::LabArgs) -> Self {
        match (args.fleet, args.two_arms) {
            (Some(robots), _) => Self::Fleet {
                robots,
                together: args.together,
            },
            (None, true) => Self::TwoArms,
            (None, false) if args.cubo => Self::Cubo,
            (None, false) => Self::Arm,
        }
    }
}

pub(crate) async fn run(args: &cli::LabArgs, output: Output) -> Result<(), Failure> {
    log(&args.log)?;
    let mut interrupt = Interrupt::install()?;
    let kind = Kind::of(args);
    let mut config = match kind {
        Kind::Arm => Config::lab(),
        Kind::TwoArms => Config::two_arms(),
        Kind::Fleet { .. } | Kind::Cubo => Config::fleet(),
    };
    if let Some(listen) = args.listen {
        config.listen = vec![listen.into()];
    }
    let kept = config.store.keep_state(|name| env::var_os(name));
    kept.map_err(|error| start_failure(error.into()))?;
    if let Some(state) = &config.store.state {
        config.tls = certificate(state);
    }
    // For what-if; gone with the lab.
    let recorded = tempfile::tempdir()?;
    config.record.path = Some(recorded.path().join("control.jsonl"));
    config.record.size = RECORDED;
    let users = config.users.clone();
    let broker = Broker::start(config).await.map_err(start_failure)?;
    let mut eyes = match kind {
        Kind::Fleet { robots, .. } => Eyes::open(robots).await?,
        Kind::Arm | Kind::TwoArms | Kind::Cubo => Eyes::default(),
    };
    let lab = LabSummary {
        address: within_reach(broker.local_addr()),
        pin: broker.fingerprint(),
        console: broker.console().is_some(),
        program: env::args().next().unwrap_or_else(|| "mom".to_owned()),
        users,
        kind,
        pages: eyes.addresses().to_vec(),
    };
    let broker = Arc::new(broker);
    let (stop, stopping) = watch::channel(false);
    let mut devices = match kind {
        Kind::Arm => start_devices(&broker, &stopping).await?,
        Kind::TwoArms => start_arms(&broker, &stopping).await?,
        Kind::Cubo => cubo::start(&broker, &stopping).await?,
        Kind::Fleet { robots, together } => {
            fleet::start(&broker, robots, together, &mut eyes, &stopping).await?
        }
    };
    output.tell(|| lab.json(), || lab.text())?;
    let ended = tokio::select! {
        () = interrupt.wait() => None,
        ended = all_ended(&mut devices, output) => ended,
    };
    output.remark(ink("stopping", Tone::Faint));
    // The devices log out first; they hold the receivers of this.
    let _ = stop.send(true);
    while devices.join_next().await.is_some() {}
    stop_broker(broker).await;
    ended.map_or(Ok(()), |why| Err(Failure::plain(why)))
}

/// Says which devices end, and goes on with the others: a peer may have expelled one. Gives why the last one has ended.
async fn all_ended(devices: &mut Devices, output: Output) -> Option<String> {
    let mut last = None;
    while let Some(ended) = devices.join_next().await {
        let why = match ended {
            Ok((name, Err(error))) => format!("the {name} ended: {error}"),
            Ok((name, Ok(()))) => format!("the {name} ended"),
            Err(error) => format!("a device broke down: {error}"),
        };
        if !devices.is_empty() {
            let words = format!("{why}; the lab goes on without it until it is started again");
            output.remark(ink(&words, Tone::Bad));
        }
        last = Some(why);
    }
    last
}

/// A certificate that the lab makes itself, and keeps where it keeps the rest.
fn certificate(state: &Path) -> TlsConfig {
    TlsConfig {
        certificate: Some(state.join("hub.crt")),
        key: Some(state.join("hub.key")),
        self_signed: true,
        hosts: ["localhost", "127.0.0.1", "::1"].map(str::to_owned).to_vec(),
    }
}

/// The log, on standard error.
fn log(filter: &str) -> Result<(), Failure> {
    let filter = EnvFilter::try_new(filter).map_err(|error| {
        Failure::usage(
            format!("--log {filter}: {error}"),
            "try: --log info, or --log warn,mom_broker=debug",
        )
    })?;
    let colour = io::stderr().is_terminal() && env::var_os("NO_COLOR").is_none_or(|set| set.is_empty());
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(colour)
        .with_writer(io::stderr)
        // A terminal that is gone takes no complaint either, and to insist would panic.
        .log_internal_errors(false)
        .init();
    Ok(())
}

fn start_failure(error: BrokerError) -> Failure {
    match error {
        BrokerError::Listen { .. } => Failure::new(
            format!("the hub cannot start: {error}"),
            "if a lab runs already, use it: mom tree\nor take a free port: mom lab --listen 127.0.0.1:0",
        ),
        other => Failure::plain(format!("the hub cannot start: {other}")),
    }
}

/// An address that a program on this machine can connect to: the unspecified address becomes loopback.
fn within_reach(mut address: SocketAddr) -> SocketAddr {
    match address.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => address.set_ip(Ipv4Addr::LOCALHOST.into()),
        IpAddr::V6(ip) if ip.is_unspecified() => address.set_ip(Ipv6Addr::LOCALHOST.into()),
        _ => {}
    }
    address
}

/// The devices while they run, by their names.
type Devices = JoinSet<(String, Result<(), ClientError>)>;

/// An arm, in its channel.
async fn start_arm(
    devices: &mut Devices,
    broker: &Arc<Broker>,
    name: &str,
    options: ArmOptions,
    stopping: &watch::Receiver<bool>,
) -> Result<(), Failure> {
    let arm = log_in(broker, name, name.to_owned()).await?;
    let place = options.channel.clone();
    let running = mom_arm::peer::run(arm.clone(), options, stopped(stopping));
    let name = name.to_owned();
    devices.spawn(async move { (name, running.await) });
    ready(&arm, &place).await
}

/// Two arms that face each other, and keep out of each other's zones.
async fn start_arms(broker: &Arc<Broker>, stopping: &watch::Receiver<bool>) -> Result<Devices, Failure> {
    let mut devices = JoinSet::new();
    for (name, channel, mount) in TWO_ARMS {
        let options = ArmOptions {
            channel: channel.to_owned(),
            zones: Some("/zone".to_owned()),
            mount,
            ..ArmOptions::default()
        };
        start_arm(&mut devices, broker, name, options, stopping).await?;
    }
    Ok(devices)
}

/// Arm, cameras and the model, in their channels.
async fn start_devices(broker: &Arc<Broker>, stopping: &watch::Receiver<bool>) -> Result<Devices, Failure> {
    let mut devices = JoinSet::new();
    start_arm(&mut devices, broker, "arm", ArmOptions::default(), stopping).await?;

    for view in View::ALL {
        let camera = log_in(broker, "camera", view.peer("camera")).await?;
        let options = CameraOptions::new(view);
        let place = options.channel.clone();
        let running = mom_camera::peer::run(camera.clone(), options, stopped(stopping));
        devices.spawn(async move { (format!("camera {view}"), running.await) });
        ready(&camera, &place).await?;
    }

    let model = log_in(broker, "model", "model".to_owned()).await?;
    let options = ModelOptions::default();
    let place = options.channel.clone();
    let running = mom_model::peer::run(model.clone(), options, stopped(stopping));
    devices.spawn(async move { ("model".to_owned(), running.await) });
    ready(&model, &place).await?;
    let servo = log_in(broker, "servo", "servo".to_owned()).await?;
    let options = ServoOptions::default();
    let place = options.channel.clone();
    let running = mom_servo::peer::run(servo.clone(), options, stopped(stopping));
    devices.spawn(async move { ("servo agent".to_owned(), running.await) });
    ready(&servo, &place).await?;
    let calibrator = log_in(broker, "calibrate", "calibrate".to_owned()).await?;
    let options = AgentOptions::default();
    let place = options.channel.clone();
    let running = mom_calibrate::agent::run(calibrator.clone(), options, stopped(stopping));
    devices.spawn(async move { ("calibration agent".to_owned(), running.await) });
    ready(&calibrator, &place).await?;
    Ok(devices)
}

/// A device's connection inside this process; a lab's device has its name as its password.
async fn log_in(broker: &Arc<Broker>, name: &str, nickname: String) -> Result<Client, Failure> {
    let broker = Arc::clone(broker);
    let builder = Client::builder_local(move || broker.connect_local());
    let builder = builder
        .user(name)
        .password(name)
        .nickname(nickname)
        // Of one process: there is no link to fall silent, and a machine that is busy for a moment is not a loss.
        .no_reconnect();
    builder.connect().await.doing(format!("log in as {name}"))
}

/// Waits until a device is in its channel, so that what is printed next can be tried at once.
async fn ready(device: &Client, place: &str) -> Result<(), Failure> {
    let begin = Instant::now();
    let me = device.name();
    loop {
        match device.members(place).await {
            Ok(members) if members.iter().any(|member| member.peer == me) => return Ok(()),
            Ok(_) => {}
            // A gateway makes the places of its robots first.
            Err(error) if error.code() == Some(&Code::UNKNOWN_PATH) => {}
            failed => failed.map(drop).doing(format!("look into {place}"))?,
        }
        if begin.elapsed() > READY {
            return Err(Failure::plain(format!("the {me} cannot join {place}")));
        }
        sleep(LOOK).await;
    }
}

fn stopped(stopping: &watch::Receiver<bool>) -> impl Future<Output = ()> + Send + use<> {
    let mut stopping = stopping.clone();
    async move {
        // A sender that is gone means the end as well.
        let _ = stopping.wait_for(|stop| *stop).await;
    }
}

/// Lets waiting parcels leave, once the devices' connections have released the broker.
async fn stop_broker(mut broker: Arc<Broker>) {
    let begin = Instant::now();
    while begin.elapsed() < READY {
        match Arc::try_unwrap(broker) {
            Ok(broker) => return broker.stop().await,
            Err(shared) => broker = shared,
        }
        sleep(LOOK).await;
    }
}
