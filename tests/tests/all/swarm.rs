//! As many robots as are wanted, at ten commands a second each, while others command them too: only the owner is obeyed.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use mom_client::{Channel, Client, Code, Event, Value};
use mom_tests::canary::Canary;
use mom_tests::programs::{Running, project};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep_until, timeout};

/// Each robot gets a command so often (W18).
const PERIOD: Duration = Duration::from_millis(100);
/// What an owner says: it turns on the spot, for less than the period.
const COMMAND: &str = "motor 100 -100 50";
/// What nobody who may command says: LEDs keep their data, so a peer that was obeyed once is found out later.
const STRANGER: i64 = 99;
const FORMER: i64 = 77;
/// Robots under one token.
const GROUP: usize = 50;
/// Until all robots of a fleet are there, and until they stand.
const SETTLED: Duration = Duration::from_secs(120);

/// The hub's configuration: that of the fleet, and the place of the canary beside it.
fn configuration() -> String {
    let config = project().join("config");
    let text = fs::read_to_string(config.join("fleet.toml")).expect("it is there");
    let users = format!("users = {:?}", config.join("lab-users.toml"));
    let mut text = text.replace("users = \"lab-users.toml\"", &users);
    for (path, rest) in [
        ("/robot", "kind = \"session\""),
        ("/robot/token", "kind = \"token\"\nmanager = \"robot-token\""),
        (
            "/robot/arm",
            "kind = \"channel\"\nguard = { token = \"/robot/token\", names = [\"command\"] }",
        ),
    ] {
        let _ = write!(text, "\n[[contexts]]\npath = \"{path}\"\n{rest}\n");
    }
    text
}

/// The fleet's file with a group for every so many robots.
fn grouped(text: &str) -> String {
    let mut out = String::new();
    let mut robots = 0;
    for line in text.lines() {
        let _ = writeln!(out, "{line}");
        if line.starts_with("address") {
            let _ = writeln!(out, "group = \"group-{}\"", robots / GROUP);
            robots += 1;
        }
    }
    out
}

async fn arrive(hub: &str, name: &str) -> Client {
    let client = Client::builder(hub).user(name).password(name).connect().await;
    client.expect("the lab knows its users")
}

/// What was counted of one group's owner.
#[derive(Debug, Default)]
struct Counts {
    sent: AtomicU64,
    finished: AtomicU64,
    failed: AtomicU64,
    /// Of one who has lost the token.
    stale: AtomicU64,
}

/// Takes a group's token, and commands its robots until it is over, with or without the token; which grant it was.
async fn own(
    client: Client,
    group: usize,
    robots: Vec<usize>,
    counts: Arc<Counts>,
    mut over: watch::Receiver<bool>,
) -> (usize, u64) {
    let token = client.token(&format!("/fleet/group-{group}/token")).await;
    let mut guard = token.expect("it is there").grab().await.expect("it is had");
    let fence = guard.fence();
    let mut channels: Vec<Channel> = Vec::new();
    let mut readers = JoinSet::new();
    for robot in robots {
        let channel = client.channel(&format!("/fleet/{robot}/robot")).await;
        let channel = channel.expect("she may look");
        let (mut events, me, counts) = (channel.events(), client.name(), Arc::clone(&counts));
        readers.spawn(async move {
            while let Some(event) = events.next().await {
                let Event::Message(parcel) = event else { continue };
                let value = parcel.value();
                let text = |key| value.get(key).and_then(Value::as_str);
                if parcel.name() != "status" || text("peer") != Some(me.as_str()) {
                    continue;
                }
                match text("state") {
                    Some("finished") => counts.finished.fetch_add(1, Ordering::Relaxed),
                    Some("error") => counts.failed.fetch_add(1, Ordering::Relaxed),
                    _ => 0,
                };
            }
        });
        channels.push(channel);
    }
    let mut ticks = interval(PERIOD / u32::try_from(channels.len()).expect("few"));
    ticks.set_missed_tick_behavior(MissedTickBehavior::Burst);
    let mut lost = false;
    for channel in channels.iter().cycle() {
        tokio::select! {
            _ = over.wait_for(|over| *over) => break,
            _ = ticks.tick() => {}
        }
        lost = lost || guard.is_lost();
        let (words, counted) = match lost {
            true => (format!("leds {FORMER}"), &counts.stale),
            false => (COMMAND.to_owned(), &counts.sent),
        };
        // One that is not its own any more is refused later, by an event.
        let said = channel.message("command").content(words.as_str()).fence(fence);
        if said.send().await.is_ok() {
            counted.fetch_add(1, Ordering::Relaxed);
        }
    }
    if !lost {
        guard.release().await.expect("it was had");
    } else {
        guard.lost().await;
    }
    (group, fence)
}

/// Commands that are not his, until it is over; how many were refused, which is all of them.
async fn intrude(client: Client, robots: usize, mut over: watch::Receiver<bool>) -> u64 {
    let mut ticks = interval(Duration::from_millis(10));
    let mut refused = 0;
    for robot in (1..=robots.min(500)).cycle() {
        tokio::select! {
            _ = over.wait_for(|over| *over) => break,
            _ = ticks.tick() => {}
        }
        let channel = client.channel(&format!("/fleet/{robot}/robot")).await;
        let channel = channel.expect("he may look");
        let said = channel
            .message("command")
            .content(format!("leds {STRANGER}").as_str());
        let error = said.send_acknowledged().await.expect_err("it is not his");
        assert_eq!(error.code(), Some(&Code::NOT_OWNER), "{error}");
        refused += 1;
    }
    refused
}

/// What the fleet's channel tells: each robot's newest state, and how old each was.
struct Watcher {
    newest: BTreeMap<i64, Value>,
    ages: Vec<Duration>,
    events: mom_client::Events,
    client: Client,
}

impl Watcher {
    async fn start(hub: &str) -> Self {
        let client = arrive(hub, "carol").await;
        let channel = client.channel("/fleet/status").await;
        let events = channel.expect("it is in the hub's file").events();
        Self {
            newest: BTreeMap::new(),
            ages: Vec::new(),
            events,
            client,
        }
    }

    /// Hears what is told; a peer that was obeyed and may not command is found out here.
    async fn hear(&mut self) {
        let Some(Event::Message(parcel)) = self.events.next().await else {
            return;
        };
        let content = parcel.value();
        let leds = content.get("leds").and_then(Value::as_int);
        assert!(
            !matches!(leds, Some(STRANGER | FORMER)),
            "one was obeyed who does not own it: {content:?}"
        );
        if let Some(age) = self.client.clock().age(&parcel) {
            self.ages.push(age.duration());
        }
        if let Some(unit) = content.get("unit").and_then(Value::as_int) {
            self.newest.insert(unit, content);
        }
    }

    /// Hears until all robots are as wanted.
    async fn until(&mut self, robots: usize, what: &str, wanted: impl Fn(&Value) -> bool) {
        let heard = async {
            while self.newest.len() < robots || !self.newest.values().all(&wanted) {
                self.hear().await;
            }
        };
        let in_time = timeout(SETTLED, heard).await;
        let not: Vec<_> = self
            .newest
            .values()
            .filter(|value| !wanted(value))
            .take(3)
            .collect();
        let known = self.newest.len();
        assert!(
            in_time.is_ok(),
            "{what}: {known} of {robots} are known, and not {not:?}"
        );
    }

    fn percentile(&mut self, percent: usize) -> Duration {
        self.ages.sort_unstable();
        let at = self.ages.len() * percent / 100;
        self.ages.get(at).copied().unwrap_or_default()
    }
}

/// CPU seconds that a process has used, and the most memory that it had, in MiB.
fn used(process: u32) -> (f64, u64) {
    let stat = fs::read_to_string(format!("/proc/{process}/stat")).expect("it runs");
    // After its name, which may have spaces.
    let fields: Vec<&str> = stat
        .rsplit(')')
        .next()
        .unwrap_or_default()
        .split_whitespace()
        .collect();
    let ticks = |at: usize| fields.get(at).and_then(|text| text.parse::<f64>().ok());
    let seconds = (ticks(11).unwrap_or(0.0) + ticks(12).unwrap_or(0.0)) / 100.0;
    let status = fs::read_to_string(format!("/proc/{process}/status")).expect("it runs");
    let line = status.lines().find(|line| line.starts_with("VmHWM:"));
    let kib = line
        .and_then(|line| line.split_whitespace().nth(1))
        .and_then(|text| text.parse::<u64>().ok());
    (seconds, kib.unwrap_or(0) / 1024)
}

/// Hub, gateway and robots as programs of their own.
struct Programs {
    address: String,
    broker: Running,
    gateway: Running,
    bots: Running,
    _folder: tempfile::TempDir,
}

impl Programs {
    fn start(robots: usize) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let file = |name: &str| folder.path().join(name).to_str().expect("a path").to_owned();
        let (config, written, fleet) = (file("hub.toml"), file("written.toml"), file("fleet.toml"));
        fs::write(&config, configuration()).expect("it is written");
        let many = robots.to_string();
        let listen = ["--listen", "127.0.0.1:0", "--write-fleet", &written];
        let arguments = [&["--robots", &many][..], &listen].concat();
        let bots = Running::start("mom-linuxbot", &arguments, &[("RUST_LOG", "error")]);
        bots.line_with("listen");
        let written = fs::read_to_string(&written).expect("it is there");
        fs::write(&fleet, grouped(&written)).expect("it is written");
        let (broker, address) = Running::broker(config.as_ref());
        let hub = format!("bin://{address}");
        let arguments = ["--fleet", &fleet, "--hub", &hub, "--manager", "robot-token"];
        let login = [("MOM_PASSWORD", "gateway"), ("RUST_LOG", "warn")];
        let gateway = Running::start("mom-gateway", &arguments, &login);
        Self {
            address,
            broker,
            gateway,
            bots,
            _folder: folder,
        }
    }

    /// What each has used, and its most memory.
    fn used(&self) -> [(f64, u64); 3] {
        [&self.broker, &self.gateway, &self.bots].map(|program| used(program.id()))
    }
}

/// What a run was like.
struct Figures {
    robots: usize,
    seconds: f64,
    before: [(f64, u64); 3],
    after: [(f64, u64); 3],
    /// Of the canary.
    exchanges: u64,
    /// Of a stranger.
    refused: u64,
}

impl Figures {
    fn text(&self, counts: &Counts, watcher: &mut Watcher) -> String {
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let (robots, seconds, finished) = (self.robots, self.seconds, count(&counts.finished));
        let mut text = format!(
            "{robots} robots, {seconds:.1} s: {} commands sent, {finished} finished, {} failed or halted; refused: {} of a stranger, {} of a \
             former owner; {} exchanges of the canary",
            count(&counts.sent),
            count(&counts.failed),
            self.refused,
            count(&counts.stale),
            self.exchanges,
        );
        let _ = write!(
            text,
            "\n{:.2} commands a second and robot; age of states p50 {:.1} ms, p99 {:.1} ms",
            finished as f64 / seconds / robots as f64,
            watcher.percentile(50).as_secs_f64() * 1e3,
            watcher.percentile(99).as_secs_f64() * 1e3,
        );
        for (at, name) in ["hub", "gateway", "robots"].into_iter().enumerate() {
            let cpu = (self.after[at].0 - self.before[at].0) / seconds;
            let each = cpu * 1e3 / robots as f64;
            let _ = write!(
                text,
                "\n{name}: {cpu:.3} of a core, {each:.3} ms of CPU a second and robot, {} MiB",
                self.after[at].1
            );
        }
        text
    }
}

fn is(value: &Value, key: &str, wanted: bool) -> bool {
    value.get(key).and_then(Value::as_bool) == Some(wanted)
}

/// `MOM_ROBOTS` is how many there are, `MOM_FLEET_SECONDS` how long they are driven.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_fleet_at_ten_commands_a_second_obeys_its_owners_only() {
    let number = |name: &str| std::env::var(name).ok().and_then(|text| text.parse::<u32>().ok());
    let robots = number("MOM_ROBOTS").unwrap_or(100) as usize;
    let length = Duration::from_secs(number("MOM_FLEET_SECONDS").unwrap_or(20).into());
    let programs = Programs::start(robots);
    let hub = format!("bin://{}", programs.address);
    let mut watcher = Watcher::start(&hub).await;
    watcher
        .until(robots, "they come", |value| is(value, "linked", true))
        .await;
    let mut canary = Canary::start(programs.address.parse().expect("an address")).await;
    let before = programs.used();
    let (end, over) = watch::channel(false);
    let counts = Arc::new(Counts::default());
    let mut owners = JoinSet::new();
    let units: Vec<usize> = (1..=robots).collect();
    let groups: Vec<Vec<usize>> = units.chunks(GROUP).map(<[usize]>::to_vec).collect();
    for (robots, group) in groups.iter().cloned().zip(0..) {
        let client = arrive(&hub, "alice").await;
        owners.spawn(own(client, group, robots, Arc::clone(&counts), over.clone()));
    }
    let intruder = tokio::spawn(intrude(arrive(&hub, "bob").await, robots, over.clone()));
    watcher.ages.clear();
    let begun = Instant::now();
    let mut taken = false;
    while begun.elapsed() < length {
        if !taken && begun.elapsed() >= length / 2 {
            taken = true;
            // Her level is above that of alice, who goes on as if she had not noticed.
            let client = arrive(&hub, "carol").await;
            let robots = groups.first().cloned().unwrap_or_default();
            owners.spawn(own(client, 0, robots, Arc::clone(&counts), over.clone()));
        }
        let next = begun + if taken { length } else { length / 2 };
        tokio::select! {
            () = watcher.hear() => {}
            () = sleep_until(next) => {} // tidy: the time of the load
        }
    }
    let seconds = begun.elapsed().as_secs_f64();
    let after = programs.used();
    let _ = end.send(true);
    let grants: BTreeSet<(usize, u64)> = owners.join_all().await.into_iter().collect();
    assert_eq!(
        grants.len(),
        groups.len() + 1,
        "each grant has a fence of its own"
    );
    let refused = intruder.await.expect("he is refused each time");
    canary.check().await;
    let figures = Figures {
        robots,
        seconds,
        before,
        after,
        exchanges: canary.stop().await,
        refused,
    };
    println!("{}", figures.text(&counts, &mut watcher));
    watcher
        .until(robots, "they stand", |value| is(value, "moving", false))
        .await;
    let finished = counts.finished.load(Ordering::Relaxed);
    let stale = counts.stale.load(Ordering::Relaxed);
    assert!(refused > 0 && stale > 0, "others have tried");
    // How many it can be is for the machine; that robots were driven all the while is not.
    assert!(finished > robots as u64, "{finished} commands were carried out");
}
