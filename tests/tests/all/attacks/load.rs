//! What nobody has thought of: random load beside the canary, which must not notice, and a program that is afterwards as it was before.

use std::env;
use std::fs::{self, File};
use std::net::SocketAddr;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use mom_broker::{Broker, Clock, Config};
use mom_proto::codec::Form;
use mom_proto::{Code, Family, Map, Parcel, Value};
use mom_tests::canary::Canary;
use mom_tests::load::{Load, OWN};
use mom_tests::process::{files, resident, threads};
use mom_tests::programs::{Running, project};
use mom_tests::raw::{PATIENCE, Raw, at};
use mom_tests::tls;
use tempfile::TempDir;
use tokio::task::{JoinHandle, spawn_blocking};

/// Loads that are given to one hub together.
const LOADS: u64 = 2;

const MIB: usize = 1 << 20;

/// What the whole hub may hold: some of the load meets that bound.
const MEMORY: usize = 2 * MIB;

/// The same of the program, which takes some memory itself.
const MEMORY_OF_PROGRAM: usize = 64 * MIB;

/// The hub's own beside what waits: its program, threads, and what is being read.
const BESIDE: usize = 64 * MIB;

/// What the channels of the configuration keep, and no more.
const KEPT: i64 = 2 << 20;

/// After so long the memory is given back.
const GIVEN_BACK: Duration = Duration::from_secs(15);

/// The runtime's threads for what blocks end after some seconds without work, and there may always be some.
const MORE_THREADS: usize = 4;

/// What the program says of its errors.
const LOG: &str = "log";

/// How long a load lasts and what it does: `MOM_LOAD_SECONDS` and `MOM_LOAD_SEED`.
#[derive(Clone, Copy, Debug)]
struct Run {
    seconds: u64,
    seed: u64,
}

impl Run {
    /// As the environment says; a failure says with which.
    fn from_environment() -> Run {
        let number = |name: &str| env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
        let now = SystemTime::now().duration_since(UNIX_EPOCH);
        Run {
            seconds: number("MOM_LOAD_SECONDS").unwrap_or(8),
            // A whole test run has a fixed seed for all that is random.
            seed: number("MOM_LOAD_SEED")
                .or_else(|| number("PROPTEST_RNG_SEED"))
                .unwrap_or_else(|| now.map_or(1, |now| now.as_secs())),
        }
    }

    fn start(self, hub: SocketAddr) -> Vec<JoinHandle<Load>> {
        let loads = (0..LOADS).map(|at| {
            let mut load = Load::new(hub, self.seed.wrapping_add(at));
            tokio::spawn(async move {
                load.run(Duration::from_secs(self.seconds)).await;
                load
            })
        });
        loads.collect()
    }
}

/// A configuration whose hub has a certificate.
fn configuration() -> Config {
    let file = project().join("tests/loaded.toml");
    let mut config = Config::load(&file).expect("a right configuration");
    config.memory = Some(MEMORY);
    config.limits.outbox = MIB;
    config.tls = tls::of_hub();
    config
}

/// A broker of its own: its process is looked at.
async fn program() -> (Running, SocketAddr, TempDir) {
    let folder = tempfile::tempdir().expect("a folder");
    let text = fs::read_to_string(project().join("tests/loaded.toml")).expect("it is there");
    let users = project().join("config/lab-users.toml");
    let text = text.replace(
        "../config/lab-users.toml",
        users.to_str().expect("a path in text"),
    );
    let tls = tls::of_hub();
    let (certificate, key) = (tls.certificate.expect("a file"), tls.key.expect("a file"));
    let text = format!(
        "memory = {MEMORY_OF_PROGRAM}\n{text}\n[tls]\ncertificate = {certificate:?}\nkey = {key:?}\n"
    );
    let file = folder.path().join("loaded.toml");
    fs::write(&file, text).expect("written");
    let log = File::create(folder.path().join(LOG)).expect("a file");
    let started = spawn_blocking(move || {
        let config = ["--config", file.to_str().expect("a path in text")];
        let listen = ["--listen", "127.0.0.1:0"];
        let args = [config, listen].concat();
        let broker = Running::start_with("mom-broker", &args, &[], log.into());
        let address = broker.listening();
        (broker, address)
    });
    let (broker, address) = started.await.expect("it starts");
    (broker, address.parse().expect("an address"), folder)
}

/// A peer of which the load knows nothing: makes what it works in, and looks.
async fn observer(hub: SocketAddr) -> Raw {
    let mut observer = Raw::login(hub, Form::Binary, "alice").await;
    observer.join(&["/free"]).await;
    let create = Parcel::new(Family::Context, "create").context(at(OWN));
    let made = observer
        .ask(create.content(Map::new().with("kind", "session")))
        .await;
    made.expect("anybody may");
    observer
}

/// Deletes what the load has made.
async fn delete(observer: &mut Raw) {
    match observer.ask_about(Family::Context, "delete", OWN).await {
        Ok(_) => {}
        Err(error) => assert_eq!(error.code, Code::UNKNOWN_PATH, "{error}"),
    }
}

/// The contexts of a session, and how many members each has.
async fn children(observer: &mut Raw, path: &str) -> Vec<(Value, Value)> {
    let listed = insist(observer, "list", path).await;
    let children = listed
        .get("children")
        .and_then(Value::as_list)
        .unwrap_or_default();
    let of = |child: &Value, key| child.get(key).cloned().unwrap_or_default();
    children
        .iter()
        .map(|child| (of(child, "path"), of(child, "members")))
        .collect()
}

/// What `stats` of the root says.
async fn told(observer: &mut Raw) -> Value {
    insist(observer, "stats", "/").await
}

/// Asks again and again, as often as the hub takes it.
async fn insist(observer: &mut Raw, verb: &str, path: &str) -> Value {
    loop {
        match observer.ask_about(Family::Context, verb, path).await {
            Ok(answer) => return answer,
            Err(error) => assert_eq!(error.code, Code::TRY_LATER, "{error}"),
        }
    }
}

fn used(stats: &Value) -> i64 {
    let used = stats
        .get("memory")
        .and_then(|memory| memory.get("used")?.as_int());
    used.expect("the root tells of memory")
}

/// The steps of loads that have ended.
async fn steps(running: Vec<JoinHandle<Load>>) -> u64 {
    let mut loads = Vec::new();
    for load in running {
        loads.push(load.await.expect("the load goes on"));
    }
    let steps = loads.iter().map(Load::steps).sum();
    assert!(steps > 100, "only {steps} steps");
    assert_eq!(
        Load::missing(&loads),
        Vec::<String>::new(),
        "not done in {steps} steps"
    );
    steps
}

/// In the hub all is as its own checks want it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn random_load_is_nothing_to_the_canary() {
    let run = Run::from_environment();
    println!("MOM_LOAD_SEED={} MOM_LOAD_SECONDS={}", run.seed, run.seconds);
    let broker = Broker::start_at(configuration(), Clock::system()).await;
    let broker = broker.expect("it starts");
    let mut observer = observer(broker.local_addr()).await;
    let mut canary = Canary::start(broker.local_addr()).await;
    let loads = run.start(broker.local_addr());
    while loads.iter().any(|load| !load.is_finished()) {
        canary.check().await;
        observer.check_alive().await;
    }
    let steps = steps(loads).await;
    println!("{steps} steps, beside {} commands", canary.stop().await);
    broker.check();
    // Beyond the bound who is charged most is refused, and put out a second later.
    let ended = Instant::now();
    loop {
        let stats = told(&mut observer).await;
        if used(&stats) <= i64::try_from(MEMORY).expect("small") {
            break;
        }
        assert!(ended.elapsed() < GIVEN_BACK, "{stats:?}");
    }
    delete(&mut observer).await;
    broker.check();
    broker.stop().await;
}

/// The memory of the program is bounded at all times, and when all have gone nothing is left of them.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn random_load_leaves_nothing_in_the_program() {
    let run = Run::from_environment();
    println!("MOM_LOAD_SEED={} MOM_LOAD_SECONDS={}", run.seed, run.seconds);
    let (broker, hub, folder) = program().await;
    let mut observer = observer(hub).await;
    let mut canary = Canary::start(hub).await;
    let before = Figures::of(&broker, &mut observer).await;
    let loads = run.start(hub);
    let (mut most, mut held) = (0, 0);
    while loads.iter().any(|load| !load.is_finished()) {
        canary.check().await;
        held = held.max(used(&told(&mut observer).await));
        // What it allocates: a debug build has 32 MiB of its own file there, too, which the system takes back as it likes.
        most = most.max(resident(&broker, "RssAnon"));
        let allowed = MEMORY_OF_PROGRAM + MEMORY_OF_PROGRAM / 4 + BESIDE;
        assert!(most <= allowed, "{} of {} MiB", most / MIB, allowed / MIB);
    }
    let steps = steps(loads).await;
    delete(&mut observer).await;
    let ended = Instant::now();
    let allowed = before.memory + before.memory / 10 * 3 + BESIDE;
    loop {
        canary.check().await;
        let now = resident(&broker, "VmRSS");
        if now <= allowed {
            break;
        }
        let (now, allowed) = (now / MIB, allowed / MIB);
        assert!(ended.elapsed() < GIVEN_BACK, "{now} of {allowed} MiB");
    }
    loop {
        canary.check().await;
        let now = Figures::of(&broker, &mut observer).await;
        if now.is_as(&before) {
            break;
        }
        assert!(ended.elapsed() < PATIENCE, "{now:?} after {before:?}");
    }
    // A task of its own that panics is nobody's but its connection's.
    let log = fs::read_to_string(folder.path().join(LOG)).expect("it is there");
    assert!(!log.contains("panicked"), "{log}");
    println!(
        "{steps} steps, {} MiB before, {} MiB at most with {held} bytes that waited, as before after {:?}, beside {} commands",
        before.memory / MIB,
        most / MIB,
        ended.elapsed(),
        canary.stop().await
    );
}

/// What is to be afterwards as it was before.
#[derive(Debug)]
struct Figures {
    memory: usize,
    threads: usize,
    files: usize,
    peers: usize,
    /// What waits or is kept, in the hub's own count.
    used: i64,
    contexts: Vec<(Value, Value)>,
}

impl Figures {
    async fn of(broker: &Running, observer: &mut Raw) -> Figures {
        let stats = told(observer).await;
        let mut contexts = children(observer, "/").await;
        contexts.retain(|(path, _)| path.as_str() != Some("/free"));
        let free = children(observer, "/free").await;
        contexts.extend(free.into_iter().filter(|(path, _)| path.as_str() != Some(OWN)));
        Figures {
            memory: resident(broker, "VmRSS"),
            threads: threads(broker),
            files: files(broker),
            peers: stats
                .get("peers")
                .and_then(Value::as_list)
                .map_or(0, <[Value]>::len),
            used: used(&stats),
            contexts,
        }
    }

    fn is_as(&self, before: &Figures) -> bool {
        self.threads <= before.threads + MORE_THREADS
            && self.files <= before.files
            && self.peers <= before.peers
            && self.used <= before.used + KEPT
            && self.contexts == before.contexts
    }
}
