//! `mom lab`: a hub, a robot arm and four cameras in one process, to try.

use std::env;
use std::io::{self, IsTerminal as _};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::Path;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use mom_arm::ArmOptions;
use mom_broker::{Broker, BrokerError, Config, TlsConfig, UserEntry};
use mom_camera::{CameraOptions, View};
use mom_client::{Client, ClientError, Fingerprint};
use serde_json::{Value as Json, json};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep};
use tracing_subscriber::EnvFilter;

use crate::cli;
use crate::failure::{Doing as _, Failure};
use crate::interrupt::Interrupt;
use crate::output::Output;
use crate::output::style::{Tone, ink, padded};

/// The default address of the hub, where the other commands look for it.
const USUAL: &str = "127.0.0.1:7666";
/// The longest time for the devices to join their channels.
const READY: Duration = Duration::from_secs(5);
const LOOK: Duration = Duration::from_millis(10);

/// A device of the lab while it runs.
type RunningPeer = Pin<Box<dyn Future<Output = Result<(), ClientError>> + Send>>;

pub(crate) async fn run(args: &cli::LabArgs, output: Output) -> Result<(), Failure> {
    log(&args.log)?;
    let mut interrupt = Interrupt::install()?;
    let mut config = Config::lab();
    if let Some(listen) = args.listen {
        config.listen = vec![listen.into()];
    }
    let kept = config.store.keep_state(|name| env::var_os(name));
    kept.map_err(|error| start_failure(error.into()))?;
    if let Some(state) = &config.store.state {
        config.tls = certificate(state);
    }
    let users = config.users.clone();
    let broker = Broker::start(config).await.map_err(start_failure)?;
    let lab = LabSummary {
        address: within_reach(broker.local_addr()),
        pin: broker.fingerprint(),
        program: env::args().next().unwrap_or_else(|| "mom".to_owned()),
        users,
    };
    let broker = Arc::new(broker);
    let (stop, stopping) = watch::channel(false);
    let mut devices = start_devices(&broker, &stopping).await?;
    output.tell(|| lab.json(), || lab.text())?;
    let ended = tokio::select! {
        () = interrupt.wait() => None,
        ended = devices.join_next() => ended,
    };
    output.remark(ink("stopping", Tone::Faint));
    // The devices log out first; they hold the receivers of this.
    let _ = stop.send(true);
    while devices.join_next().await.is_some() {}
    stop_broker(broker).await;
    match ended {
        None => Ok(()),
        Some(Ok((name, Err(error)))) => Err(Failure::plain(format!("the {name} ended: {error}"))),
        Some(Ok((name, Ok(())))) => Err(Failure::plain(format!("the {name} ended"))),
        Some(Err(error)) => Err(Failure::plain(format!("a device broke down: {error}"))),
    }
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

/// Arm and cameras, in their channels.
async fn start_devices(
    broker: &Arc<Broker>,
    stopping: &watch::Receiver<bool>,
) -> Result<JoinSet<(String, Result<(), ClientError>)>, Failure> {
    let mut devices = JoinSet::new();
    let arm = log_in(broker, "arm", "arm".to_owned()).await?;
    let options = ArmOptions::default();
    let place = options.channel.clone();
    let running: RunningPeer = Box::pin(mom_arm::peer::run(arm.clone(), options, stopped(stopping)));
    devices.spawn(async move { ("arm".to_owned(), running.await) });
    ready(&arm, &place).await?;

    for view in View::ALL {
        let camera = log_in(broker, "camera", view.peer("camera")).await?;
        let options = CameraOptions::new(view);
        let place = options.channel.clone();
        let running: RunningPeer =
            Box::pin(mom_camera::peer::run(camera.clone(), options, stopped(stopping)));
        devices.spawn(async move { (format!("camera {view}"), running.await) });
        ready(&camera, &place).await?;
    }
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
        .no_reconnect();
    builder.connect().await.doing(format!("log in as {name}"))
}

/// Waits until a device is in its channel, so that what is printed next can be tried at once.
async fn ready(device: &Client, place: &str) -> Result<(), Failure> {
    let begin = Instant::now();
    let me = device.name();
    loop {
        let members = device.members(place).await.doing(format!("look into {place}"))?;
        if members.iter().any(|member| member.peer == me) {
            return Ok(());
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

/// The summary of a running lab.
struct LabSummary {
    address: SocketAddr,
    pin: Option<Fingerprint>,
    program: String,
    users: Vec<UserEntry>,
}

impl LabSummary {
    fn json(&self) -> Json {
        let people = self
            .users
            .iter()
            .map(|user| json!({"name": user.name, "level": user.level, "groups": user.groups}));
        json!({
            "state": "ready",
            "hub": format!("bin://{}", self.address),
            "xml": format!("tcp://{}", self.address),
            "tls": self.tls(),
            "users": people.collect::<Vec<_>>(),
        })
    }

    fn text(&self) -> String {
        let row = |label: &str, text: String| format!("  {}  {text}", padded(label, 7, Tone::Faint));
        let place = |text: &str| ink(text, Tone::Place);
        let mut lines = vec![
            ink(
                "A hub, a robot arm and four cameras are running here. Ctrl-C ends them.",
                Tone::Strong,
            ),
            String::new(),
            row(
                "hub",
                format!("{}  binary", place(&format!("bin://{}", self.address))),
            ),
            row(
                "",
                format!(
                    "{}  XML, for anything that can open a socket",
                    place(&format!("tcp://{}", self.address))
                ),
            ),
        ];
        lines.extend(self.tls().map(|address| {
            row(
                "",
                format!("{}  binary with TLS; tcps:// for XML", place(&address)),
            )
        }));
        lines.extend([
            row(
                "people",
                format!("{}; everyone's password is their name", self.people()),
            ),
            row(
                "robot",
                format!(
                    "{}, driven by whoever holds {}",
                    place("/robot/arm"),
                    place("/robot/token")
                ),
            ),
            row(
                "cameras",
                View::ALL
                    .map(|view| place(&CameraOptions::new(view).channel))
                    .join(", "),
            ),
            row("chat", place("/chat")),
            String::new(),
        ]);
        lines.extend(self.proposals());
        lines.join("\n")
    }

    /// What to type next.
    fn proposals(&self) -> Vec<String> {
        let program = &self.program;
        let person = |name: &str| format!("export {}MOM_USER={name} MOM_PASSWORD={name}", self.hub());
        let command = |text: &str| format!("  {}", ink(text.replace("MOM", program), Tone::Command));
        let export = |name: &str| format!("  {}", ink(person(name), Tone::Command));
        vec![
            "Try in another terminal, as alice:".to_owned(),
            export("alice"),
            command("MOM tree"),
            command("echo 'move 100 50 200 0 0; grip close' | MOM run -"),
            command("MOM jog --for 1s 50 0 -50 0 0"),
            command("MOM stop /robot/arm"),
            command("MOM unstop /robot/arm"),
            command("MOM snap"),
            command("MOM camera x --size 320x240 --quality 60"),
            command("echo reset | MOM run -"),
            command("MOM grab --answer /robot/token"),
            "and while she holds the token, in a third one, as bob:".to_owned(),
            export("bob"),
            command("MOM grab --wait 5m /robot/token"),
            command("MOM token /robot/token"),
            command("MOM watch --recursive /robot"),
        ]
    }

    /// The address with TLS, which knows the hub by its certificate.
    fn tls(&self) -> Option<String> {
        let pin = self.pin?;
        Some(format!("bins://{}?pin={pin}", self.address))
    }

    /// The users that are not devices.
    fn people(&self) -> String {
        let people = self
            .users
            .iter()
            .filter(|user| !user.groups.iter().any(|group| group == "device"));
        let people: Vec<String> = people
            .map(|user| {
                let mut facts = vec![format!("level {}", user.level)];
                facts.extend(user.groups.iter().cloned());
                format!("{} ({})", ink(&user.name, Tone::Peer), facts.join(", "))
            })
            .collect();
        people.join(", ")
    }

    /// The hub's address, if it is not the default.
    fn hub(&self) -> String {
        match self.address.to_string() == USUAL {
            true => String::new(),
            false => format!("MOM_HUB=bin://{} ", self.address),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lab(address: &str) -> String {
        let lab = LabSummary {
            address: address.parse().unwrap(),
            pin: Some(Fingerprint::new([0xAB; 32])),
            program: "target/release/mom".to_owned(),
            users: Config::lab().users,
        };
        anstream::adapter::strip_str(&lab.text()).to_string()
    }

    #[test]
    fn commands_can_be_copied() {
        let usual = lab(USUAL);
        for part in [
            "bin://127.0.0.1:7666",
            "tcp://127.0.0.1:7666",
            "bins://127.0.0.1:7666?pin=sha256:abab",
            "alice (level 1), bob (level 1), carol (level 5, operator);",
            "\n  export MOM_USER=alice MOM_PASSWORD=alice\n",
            "\n  target/release/mom tree\n",
            "\n  echo 'move 100 50 200 0 0; grip close' | target/release/mom run -\n",
        ] {
            assert!(usual.contains(part), "{part:?} in\n{usual}");
        }
        let other = lab("[::1]:4000");
        assert!(
            other.contains("export MOM_HUB=bin://[::1]:4000 MOM_USER=alice MOM_PASSWORD=alice\n"),
            "{other}"
        );
        assert!(
            other.contains("export MOM_HUB=bin://[::1]:4000 MOM_USER=bob"),
            "{other}"
        );
    }

    #[test]
    fn addresses_can_be_connected_to() {
        for (bound, told) in [
            ("0.0.0.0:1", "127.0.0.1:1"),
            ("[::]:2", "[::1]:2"),
            ("10.0.0.5:3", "10.0.0.5:3"),
        ] {
            assert_eq!(within_reach(bound.parse().unwrap()).to_string(), told);
        }
    }

    #[test]
    fn the_lab_is_where_everybody_looks() {
        assert_eq!(Config::lab().listen, [USUAL.into()]);
    }
}
