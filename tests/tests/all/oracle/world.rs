//! A device with all that stands between it and its owners: a hub of its own, its programs, and the networks between them.

use std::fs;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use mom_client::{Channel, Client, Event, Events, HUB, Token, Value};
use mom_tests::datagrams::{Datagrams, Weather};
use mom_tests::faulty::{Fault, FaultyNetwork};
use mom_tests::programs::{PATIENCE, Running, project};
use tempfile::TempDir;
use tokio::task::JoinHandle;
use tokio::time::timeout;

use super::log::{Hindered, Micros, Notes, Reading, Seen};
use super::planted::{Plant, Planted};
use super::rules::Spec;

/// The drivers, and who may stop and unstop: carol is an operator, whose level is above the others'.
pub(super) const PEOPLE: [&str; 3] = ["alice", "bob", "carol"];
pub(super) const OPERATOR: usize = 2;

/// The devices of lab, fleet and CUBO, and one that is made to be at fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Arm,
    Mount,
    Rover,
    Linuxbot,
    Cubo,
    Planted(Plant),
}

impl Kind {
    pub(super) const ALL: [Self; 5] = [Self::Arm, Self::Mount, Self::Rover, Self::Linuxbot, Self::Cubo];

    /// What its programs declare, and what is measured of its body.
    pub(super) fn spec(self) -> Spec {
        let wheels = Spec {
            name: "",
            least: vec![0.15, 0.15, 0.3],
            turns: Some(2),
            tolerance: vec![2.5, 2.5, 2.5],
            stopping: 1_000_000,
            hold: 500_000,
            swings: false,
        };
        match self {
            Self::Arm => Spec {
                name: "arm",
                least: vec![0.15; 4],
                turns: None,
                tolerance: vec![0.5; 4],
                stopping: 200_000,
                hold: 1_500_000,
                swings: false,
            },
            Self::Mount => Spec {
                name: "mount",
                least: vec![0.1; 2],
                turns: None,
                tolerance: vec![0.1; 2],
                stopping: 200_000,
                hold: 1_500_000,
                swings: false,
            },
            Self::Rover => Spec {
                name: "rover",
                ..wheels
            },
            Self::Linuxbot => Spec {
                name: "linuxbot",
                stopping: 1_500_000,
                ..wheels
            },
            Self::Cubo => Spec {
                name: "cubo",
                least: vec![0.15, 0.15, 0.3, 0.3, 0.3, 0.3],
                tolerance: vec![2.5; 6],
                swings: true,
                ..wheels
            },
            Self::Planted(_) => Spec {
                name: "planted",
                least: vec![0.15, 0.3],
                turns: Some(1),
                tolerance: vec![2.0, 2.0],
                stopping: 600_000,
                hold: 0,
                swings: false,
            },
        }
    }

    fn config(self) -> &'static str {
        match self {
            Self::Arm | Self::Mount => "lab.toml",
            Self::Rover | Self::Planted(_) => "convoy.toml",
            Self::Linuxbot | Self::Cubo => "fleet.toml",
        }
    }

    /// Whether its guard is in the configuration, and not made by its gateway.
    pub(super) fn has_guard(self) -> bool {
        !matches!(self, Self::Linuxbot | Self::Cubo)
    }

    pub(super) fn channel_path(self) -> &'static str {
        match self {
            Self::Arm => "/robot/arm",
            Self::Mount => "/camera/pan",
            Self::Rover => "/rover/a/robot",
            Self::Planted(_) => "/rover/b/robot",
            Self::Linuxbot => "/fleet/13/robot",
            Self::Cubo => "/fleet/1/robot",
        }
    }

    fn token(self) -> &'static str {
        match self {
            Self::Arm => "/robot/token",
            Self::Mount => "/camera/pan-token",
            Self::Rover => "/rover/a/token",
            Self::Planted(_) => "/rover/b/token",
            Self::Linuxbot => "/fleet/13/token",
            Self::Cubo => "/fleet/1/token",
        }
    }

    /// The middle of its way.
    pub(super) fn middle(self) -> f64 {
        match self {
            Self::Rover | Self::Linuxbot | Self::Cubo => 2500.0,
            _ => 0.0,
        }
    }

    /// A script by which it moves this way after so many ms, for so many ms twice where a statement says how long it
    /// takes. Also how long its last statement takes.
    pub(super) fn script(self, ways: f64, pause: u64, lasts: u64) -> (String, Option<Micros>) {
        let sign = if ways < 0.0 { "-" } else { "" };
        let timed = i64::try_from(lasts).map(|ms| ms * 1000).ok();
        match self {
            Self::Arm => (format!("wait {pause}; move {sign}300 0 300 0 0"), None),
            Self::Mount => (format!("wait {pause}; look {sign}170 -20"), None),
            _ => {
                let drive = format!("motor {sign}300 {sign}300 {lasts}");
                // Its arms swing meanwhile.
                let between = match self {
                    Self::Cubo if pause == 200 => format!("do gesture {}", lasts % 8),
                    _ => format!("wait {pause}"),
                };
                (format!("{drive}; {between}; {drive}"), timed)
            }
        }
    }

    /// What a state says of the first number of its place.
    fn place(self, state: &Value) -> Option<f64> {
        let number = match self {
            Self::Arm => state.get("pose")?.get("x")?,
            Self::Mount => state.get("pan")?,
            _ => state.get("x")?,
        };
        match number {
            Value::Double(number) => Some(*number),
            Value::Int(number) => Some(*number as f64),
            _ => None,
        }
    }
}

/// One program, which may be killed and started again.
#[derive(Debug)]
pub(super) struct Program {
    name: &'static str,
    args: Vec<String>,
    environment: Vec<(&'static str, String)>,
    log: PathBuf,
    running: Option<Running>,
    pub(super) is_stopped: bool,
}

impl Program {
    fn new(folder: &Path, name: &'static str, args: &[&str], password: &str) -> Self {
        Self {
            name,
            args: args.iter().map(|&arg| arg.to_owned()).collect(),
            environment: vec![
                ("MOM_PASSWORD", password.to_owned()),
                ("XDG_STATE_HOME", folder.join(name).display().to_string()),
                ("RUST_LOG", "info".to_owned()),
            ],
            log: folder.join(format!("{name}.log")),
            running: None,
            is_stopped: false,
        }
    }

    pub(super) fn start(&mut self) -> &Running {
        let log = fs::OpenOptions::new().append(true).create(true).open(&self.log);
        let log = Stdio::from(log.expect("a log"));
        let args: Vec<&str> = self.args.iter().map(String::as_str).collect();
        let environment: Vec<(&str, &str)> = self
            .environment
            .iter()
            .map(|(key, value)| (*key, value.as_str()))
            .collect();
        self.is_stopped = false;
        self.running
            .insert(Running::start_with(self.name, &args, &environment, log))
    }

    pub(super) fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// Kills it (SIGKILL).
    pub(super) fn kill(&mut self) {
        self.running = None;
        self.is_stopped = false;
    }

    pub(super) fn pause(&mut self) {
        if let Some(running) = &self.running {
            running.signal("STOP");
            self.is_stopped = true;
        }
    }

    pub(super) fn go_on(&mut self) {
        if let Some(running) = self.running.as_ref().filter(|_| self.is_stopped) {
            running.signal("CONT");
        }
        self.is_stopped = false;
    }

    pub(super) fn reload(&self) {
        if let Some(running) = &self.running {
            running.signal("HUP");
        }
    }
}

/// A person at the hub.
pub(super) struct Person {
    pub(super) client: Client,
    pub(super) channel: Channel,
    pub(super) token: Token,
}

/// One device and its surroundings.
pub(super) struct World {
    pub(super) kind: Kind,
    pub(super) notes: Notes,
    /// What each person's newest command has as its last statement's time.
    pub(super) lasts: Arc<Mutex<Vec<Option<Micros>>>>,
    pub(super) people: Vec<Person>,
    /// The first is the hub, the last is the one in which the body is, unless that is planted.
    pub(super) programs: Vec<Program>,
    /// Between the device's program and the hub.
    pub(super) link: FaultyNetwork,
    /// Between the device's program and its robot.
    pub(super) wire: Option<FaultyNetwork>,
    pub(super) datagrams: Option<Datagrams>,
    pub(super) reading: Reading,
    config: PathBuf,
    /// Whether a token guards the channel, as its configuration says.
    pub(super) is_guarded: bool,
    pub(super) folder: TempDir,
    _planted: Option<Planted>,
    _watching: JoinHandle<()>,
}

impl World {
    /// All of it, at work.
    pub(super) async fn new(kind: Kind, seed: u64) -> World {
        let folder = tempfile::tempdir().expect("a folder");
        let config = folder.path().join("hub.toml");
        for (from, to) in [(kind.config(), "hub.toml"), ("lab-users.toml", "lab-users.toml")] {
            fs::copy(project().join("config").join(from), folder.path().join(to)).expect("a configuration");
        }
        let mut hub = Program::new(
            folder.path(),
            "mom-broker",
            &["--config", text(&config), "--listen", &place()],
            "",
        );
        let address: SocketAddr = hub.start().listening().parse().expect("an address");
        hub.args[3] = address.to_string();
        let slow = move |number: u64| Fault {
            delay: Duration::from_millis([0, 0, 5, 20][fastrand::Rng::with_seed(seed ^ number).usize(..4)]),
            ..Fault::default()
        };
        let link = FaultyNetwork::to(address, slow).await;
        let trace = folder.path().join("trace");
        let mut surroundings = Surroundings {
            folder: folder.path(),
            hub: format!("bin://{}", link.address),
            trace: &trace,
            seed,
            wire: None,
            datagrams: None,
            planted: None,
        };
        let mut programs = vec![hub];
        programs.extend(surroundings.device(kind).await);
        let Surroundings {
            wire,
            datagrams,
            planted,
            ..
        } = surroundings;
        let mut people = Vec::new();
        for name in PEOPLE {
            people.push(arrive(&format!("bin://{address}"), name, kind).await);
        }
        let (notes, lasts) = (Notes::default(), Arc::new(Mutex::new(vec![None; PEOPLE.len()])));
        let events = people[OPERATOR].channel.events();
        let watching = tokio::spawn(watch(events, kind, notes.clone(), Arc::clone(&lasts)));
        World {
            kind,
            notes,
            lasts,
            people,
            programs,
            link,
            wire,
            datagrams,
            reading: Reading::of(trace),
            config,
            is_guarded: true,
            folder,
            _planted: planted,
            _watching: watching,
        }
    }

    pub(super) fn operator(&self) -> &Person {
        &self.people[OPERATOR]
    }

    /// The hub reads its configuration again, which has changed where that matters to nobody, and by whether the channel is guarded.
    pub(super) fn configure(&mut self, number: u64, is_guarded: bool) {
        let old = fs::read_to_string(project().join("config").join(self.kind.config()));
        let mut new = old.expect("a configuration");
        if !is_guarded {
            let guard = format!("guard = {{ token = \"{}\", ", self.kind.token());
            new = new.replace(&guard, &format!("# {guard}"));
        }
        new += &format!("[[contexts]]\npath = \"/reloaded-{number}\"\nkind = \"channel\"\n");
        fs::write(&self.config, new).expect("it is written");
        self.is_guarded = is_guarded;
        self.programs[0].reload();
    }

    /// All networks as they should be, and all programs running.
    pub(super) fn heal(&mut self) {
        let hinder = |what, begins| Seen::Hinder { what, begins };
        let programs = (0..self.programs.len()).map(Hindered::Program);
        for what in [Hindered::Link, Hindered::Wire].into_iter().chain(programs) {
            self.notes.note(hinder(what, false));
        }
        self.link.freeze(false);
        if let Some(wire) = &self.wire {
            wire.freeze(false);
        }
        if let Some(datagrams) = &self.datagrams {
            datagrams.set(Weather::default());
        }
        for program in &mut self.programs {
            program.go_on();
            if !program.is_running() {
                program.start();
            }
        }
    }
}

/// What a device is started with.
struct Surroundings<'a> {
    folder: &'a Path,
    hub: String,
    trace: &'a Path,
    seed: u64,
    wire: Option<FaultyNetwork>,
    datagrams: Option<Datagrams>,
    planted: Option<Planted>,
}

impl Surroundings<'_> {
    /// Starts the programs of a device.
    async fn device(&mut self, kind: Kind) -> Vec<Program> {
        let (folder, hub, trace) = (self.folder, self.hub.clone(), text(self.trace));
        let program = |name, args: &[&str], password| Program::new(folder, name, args, password);
        let mut programs = match kind {
            Kind::Arm => vec![program("mom-arm", &["--hub", &hub, "--trace", trace], "arm")],
            Kind::Mount => {
                let small = ["--view", "pan", "--width", "64", "--height", "48", "--rate", "1"];
                let args = [&small[..], &["--hub", &hub, "--trace", trace]].concat();
                vec![program("mom-camera", &args, "camera")]
            }
            Kind::Rover => {
                let args = ["--name", "a", "--hub", &hub, "--trace", trace];
                vec![program("mom-rover", &args, "rover-a")]
            }
            Kind::Linuxbot => return self.linuxbot().await,
            Kind::Cubo => return self.cubo().await,
            Kind::Planted(plant) => {
                self.planted = Some(Planted::start(&hub, plant, self.trace).await);
                vec![]
            }
        };
        for program in &mut programs {
            program.start();
        }
        programs
    }

    async fn linuxbot(&mut self) -> Vec<Program> {
        let fleet = self.folder.join("fleet.toml");
        // In the middle of a floor of 5 m by 5 m.
        let args = [
            "--robots",
            "25",
            "--only",
            "13",
            "--listen",
            &place(),
            "--trace",
            text(self.trace),
        ];
        let mut robot = Program::new(self.folder, "mom-linuxbot", &args, "");
        let line = robot.start().line_with("listens at");
        let address = line.rsplit(' ').next().and_then(|word| word.parse().ok());
        let address: SocketAddr = address.expect("the robot says where it listens");
        robot.args[5] = address.to_string();
        let wire = FaultyNetwork::to(address, |_| Fault::default()).await;
        let robots = format!("[[robot]]\nunit = 13\naddress = \"{}\"\n", wire.address);
        fs::write(&fleet, robots).expect("a fleet");
        let args = [
            "--hub",
            &self.hub,
            "--manager",
            "robot-token",
            "--fleet",
            text(&fleet),
        ];
        let mut gateway = Program::new(self.folder, "mom-gateway", &args, "gateway");
        gateway.start();
        self.wire = Some(wire);
        vec![gateway, robot]
    }

    async fn cubo(&mut self) -> Vec<Program> {
        let args = ["--listen", &place(), "--trace", text(self.trace)];
        let mut robot = Program::new(self.folder, "mom-cubo", &args, "");
        let line = robot.start().line_with("listens on");
        let address = line.rsplit(' ').next().and_then(|word| word.parse().ok());
        let address: SocketAddr = address.expect("the robot says where it listens");
        robot.args[1] = address.to_string();
        let datagrams = Datagrams::before(address, self.seed).expect("a network");
        let place = format!("/fleet/1={}", datagrams.address());
        let model = project().join("config/cubo.toml");
        let args = [
            "--hub",
            &self.hub,
            "--manager",
            "robot-token",
            "--model",
            text(&model),
            "--robot",
            &place,
        ];
        let mut middle = Program::new(self.folder, "mom-simulacrum", &args, "gateway");
        middle.start();
        self.datagrams = Some(datagrams);
        vec![middle, robot]
    }
}

/// Where a program listens: an address of its own, so that nobody takes its port while it is dead.
fn place() -> String {
    static NUMBER: AtomicU8 = AtomicU8::new(1);
    format!("127.66.1.{}:0", NUMBER.fetch_add(1, Ordering::Relaxed).max(1))
}

fn text(path: &Path) -> &str {
    path.to_str().expect("a path in text")
}

/// A person who has joined, once the device's contexts are there.
async fn arrive(hub: &str, name: &str, kind: Kind) -> Person {
    // Passwords take their time where many worlds begin at once.
    let client = Client::builder(hub)
        .user(name)
        .password(name)
        .event_buffer(4096)
        .request_timeout(PATIENCE)
        .connect()
        .await;
    let client = client.expect("the lab knows its users");
    let joined = async {
        loop {
            let channel = client.channel(kind.channel_path()).await;
            let token = client.token(kind.token()).await;
            match (channel, token) {
                (Ok(channel), Ok(token)) => return (channel, token),
                _ => tokio::time::sleep(Duration::from_millis(50)).await, // tidy: its gateway makes them when it is there
            }
        }
    };
    let (channel, token) = timeout(PATIENCE, joined).await.expect("the device is there");
    Person {
        client,
        channel,
        token,
    }
}

/// Notes what the channel tells.
async fn watch(mut events: Events, kind: Kind, notes: Notes, lasts: Arc<Mutex<Vec<Option<Micros>>>>) {
    while let Some(event) = events.next().await {
        match event {
            Event::Message(parcel) if parcel.name() == "state" => notes.note(state(kind, &parcel.value())),
            Event::Message(parcel) if parcel.name() == "halt" && parcel.sender.as_deref() == Some(HUB) => {
                let content = parcel.value();
                if content
                    .get("guard")
                    .is_some_and(|guard| guard.get("token").is_some())
                {
                    notes.note(Seen::Guarded);
                }
            }
            Event::Message(parcel) if parcel.name() == "status" => {
                if let Some(seen) = status(&parcel.value(), &lasts) {
                    notes.note(seen);
                }
            }
            Event::Grabbed { owner, fence, .. } => notes.note(Seen::Grant { owner, fence }),
            _ => {}
        }
    }
}

fn state(kind: Kind, state: &Value) -> Seen {
    let is = |key: &str| state.get(key).and_then(Value::as_bool) == Some(true);
    let moving = is("moving");
    let measures = kind != Kind::Arm || is("stopped");
    Seen::State {
        stopped: is("stopped"),
        stop: state
            .get("stop")
            .and_then(Value::as_int)
            .and_then(|stop| u64::try_from(stop).ok())
            .unwrap_or(0),
        moving,
        rests: !moving && (state.get("rest").is_some() || !measures),
        at: kind.place(state),
    }
}

fn status(status: &Value, lasts: &Mutex<Vec<Option<Micros>>>) -> Option<Seen> {
    let word = |key: &str| status.get(key).and_then(Value::as_str);
    let owner = word("peer")?;
    match word("state")? {
        "finished" | "error" => Some(Seen::Ended {
            owner: owner.to_owned(),
        }),
        "executing" if status.get("statement") == status.get("of") => {
            let person = PEOPLE.iter().position(|name| *name == owner)?;
            let lasts = lasts.lock().unwrap_or_else(PoisonError::into_inner);
            let lasts = (*lasts.get(person)?)?;
            Some(Seen::Last {
                owner: owner.to_owned(),
                lasts,
            })
        }
        _ => None,
    }
}
