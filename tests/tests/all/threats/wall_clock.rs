//! Threat 25: a wall clock that is wrong, or steps while the broker runs. Leases go by another clock.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel, Time, Value};
use mom_tests::canary::Canary;
use mom_tests::raw::{PATIENCE, Raw};
use mom_tests::service::{Home, Service};

use super::arena::{self, Robot, about, command, grab};

const DAY: i64 = 24 * 60 * 60;
const YEAR: i64 = 365 * DAY;

/// The wall clock of one process, to be moved.
struct Wall {
    /// What `faketime` puts into the environment of a program, but for the time.
    preload: Vec<(String, String)>,
    file: PathBuf,
}

impl Wall {
    /// None where `faketime` is not installed, which is said.
    fn new(folder: &Path) -> Option<Wall> {
        let asked = Command::new("faketime")
            .args(["-m", "-f", "+0s", "env", "-0"])
            .output();
        let Some(asked) = asked.ok().filter(|asked| asked.status.success()) else {
            let word = "skipped: faketime is not installed (apt-get install faketime)";
            writeln!(std::io::stderr(), "{word}").expect("standard error");
            return None;
        };
        let told = String::from_utf8_lossy(&asked.stdout);
        let told = told.split('\0').filter_map(|line| line.split_once('='));
        let new = told
            .filter(|(key, value)| std::env::var(key).ok().as_deref() != Some(*value))
            .filter(|(key, _)| !key.starts_with("FAKETIME") && *key != "_");
        let preload: Vec<_> = new
            .map(|(key, value)| (key.to_owned(), value.to_owned()))
            .collect();
        assert!(!preload.is_empty(), "faketime says where its library is");
        let file = folder.join("wall");
        Some(Wall { preload, file })
    }

    /// Steps it to this many seconds off.
    fn step(&self, seconds: i64) {
        // Whole or not at all: the process reads it at any moment.
        let new = self.file.with_extension("new");
        std::fs::write(&new, format!("{seconds:+}\n")).expect("a file");
        std::fs::rename(&new, &self.file).expect("the same folder");
    }

    async fn start(&self, home: &Home) -> Service {
        let file = self.file.display().to_string();
        let mut environment = vec![
            ("FAKETIME_TIMESTAMP_FILE", &*file),
            ("FAKETIME_NO_CACHE", "1"),
            ("FAKETIME_DONT_FAKE_MONOTONIC", "1"),
        ];
        environment.extend(self.preload.iter().map(|(key, value)| (&**key, &**value)));
        home.start_in(&environment).await
    }
}

/// The time of day by a broker, µs since the epoch.
async fn time_of(peer: &mut Raw) -> i64 {
    let pong = peer.ask(Parcel::new(Family::Time, "ping")).await;
    match pong.expect("an answer").value().get("received") {
        Some(Value::Time(time)) => time.micros(),
        other => panic!("{other:?}"),
    }
}

fn real_time() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).expect("after 1970");
    i64::try_from(since.as_micros()).expect("before the end of time")
}

fn terms(lease: Duration) -> Map {
    let lease = i64::try_from(lease.as_millis()).expect("a lease");
    Map::new().with("expiry", "eager").with("lease", lease)
}

/// A wall clock that is 10 years ahead or 15 days late from the start is what the hub shows, and nothing else.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_25_a_wrong_wall_clock() {
    for seconds in [-15 * DAY, 10 * YEAR] {
        let home = Home::new("");
        let Some(wall) = Wall::new(home.folder()) else {
            return;
        };
        wall.step(seconds);
        let service = wall.start(&home).await;
        let mut canary = Canary::start(service.address()).await;
        let mut alice = Raw::login(service.address(), Form::Xml, "alice").await;
        let off = (time_of(&mut alice).await - real_time()) / 1_000_000;
        assert!(
            (off - seconds).abs() < DAY,
            "the clock is faked: {off} s, not {seconds}"
        );
        arena::make(service.address(), terms(Duration::from_secs(1))).await;
        check_short_lease(&service, &mut canary).await;
        canary.stop().await;
        assert_eq!(service.terminate().await.code(), Some(0));
    }
}

/// While it runs the wall clock steps to and fro: a lease ends neither sooner nor later, what is left of it is what
/// was, and the time that the hub tells goes on as if nothing had happened.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_25_a_stepping_wall_clock() {
    let home = Home::new("");
    let Some(wall) = Wall::new(home.folder()) else {
        return;
    };
    wall.step(0);
    let service = wall.start(&home).await;
    let address = service.address();
    let mut canary = Canary::start(address).await;
    let lease = Duration::from_secs(3600);
    arena::make(address, terms(lease)).await;
    let mut robot = Robot::enter(address, Form::Binary).await;
    let mut alice = arena::driver(address, Form::Xml, "alice").await;
    let begun = Instant::now();
    let fence = grab(&mut alice).await;
    robot.expect(&format!("grabbed {} {fence}", alice.name())).await;
    let mut last = time_of(&mut alice).await;
    for (number, seconds) in [-15 * DAY, 10 * YEAR, 0, -1, 60, -10 * YEAR, 3600, -3600]
        .into_iter()
        .enumerate()
    {
        wall.step(seconds);
        let info = alice.ask(about("info")).await.expect("anybody may").value();
        let left = info.get("lease-left").and_then(Value::as_int).expect("a lease");
        let left = Duration::from_millis(u64::try_from(left).expect("not over"));
        assert!(
            left <= lease && left + begun.elapsed() + Duration::from_millis(1) >= lease,
            "{seconds} s: {left:?} is left"
        );
        alice.post(command(&number.to_string(), None)).await;
        robot.expect(&format!("command {number} {fence}")).await;
        let now = time_of(&mut alice).await;
        let passed = now - last;
        assert!(
            passed >= 0,
            "{seconds} s: the hub's time went back by {passed} µs"
        );
        assert!(
            passed < 600_000_000,
            "{seconds} s: the hub's time jumped by {passed} µs"
        );
        last = now;
        let renewed = alice.ask(about("renew")).await.expect("the owner may");
        assert_eq!(renewed.value().get("lease"), Some(&Value::Int(3_600_000)));
        canary.check().await;
    }
    alice.ask(about("release")).await.expect("the owner may");
    canary.stop().await;
    assert_eq!(service.terminate().await.code(), Some(0));
}

/// A short lease ends after its time, whatever the wall clock does meanwhile.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_25_a_step_in_the_middle_of_a_lease() {
    let home = Home::new("");
    let Some(wall) = Wall::new(home.folder()) else {
        return;
    };
    wall.step(0);
    let service = wall.start(&home).await;
    let mut canary = Canary::start(service.address()).await;
    arena::make(service.address(), terms(Duration::from_secs(1))).await;
    for seconds in [-15 * DAY, 10 * YEAR] {
        let (mut robot, fence, begun) = short_lease(&service).await;
        wall.step(seconds);
        check_expired(&mut robot, fence, begun).await;
        canary.check().await;
    }
    canary.stop().await;
    assert_eq!(service.terminate().await.code(), Some(0));
}

/// A machine that starts with an old clock and learns the time later: log and audit log say so, and go by it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_25_a_clock_that_is_set_later() {
    let home = Home::new("[audit]\npath = \"audit.jsonl\"\n");
    let Some(wall) = Wall::new(home.folder()) else {
        return;
    };
    wall.step(-10 * YEAR);
    let service = wall.start(&home).await;
    let mut canary = Canary::start(service.address()).await;
    wall.step(0);
    let begun = Instant::now();
    while !home.log().contains("the wall clock was set") {
        assert!(begun.elapsed() < PATIENCE, "{}", home.log());
        canary.check().await;
    }
    canary.stop().await;
    assert_eq!(service.terminate().await.code(), Some(0));
    let audit = std::fs::read_to_string(home.file("audit.jsonl")).expect("an audit log");
    let at = |what: &str| {
        let line = audit
            .lines()
            .find(|line| line.contains(&format!("\"what\":\"{what}\"")));
        let line: serde_json::Value = serde_json::from_str(line.unwrap_or_default()).expect("a line");
        let at: Time = line["at"].as_str().unwrap_or_default().parse().expect("a time");
        (real_time() - at.micros()) / 1_000_000 / DAY
    };
    assert!((3640..3660).contains(&at("started")), "{audit}");
    assert_eq!((at("clock-stepped"), at("stopped")), (0, 0), "{audit}");
}

async fn check_short_lease(service: &Service, canary: &mut Canary) {
    let (mut robot, fence, begun) = short_lease(service).await;
    check_expired(&mut robot, fence, begun).await;
    canary.check().await;
}

/// A robot, and an owner of its token that is asleep since then.
async fn short_lease(service: &Service) -> (Robot, u64, (Raw, Instant)) {
    let mut robot = Robot::enter(service.address(), Form::Binary).await;
    let mut alice = arena::driver(service.address(), Form::Xml, "alice").await;
    let begun = Instant::now();
    let fence = grab(&mut alice).await;
    robot.expect(&format!("grabbed {} {fence}", alice.name())).await;
    (robot, fence, (alice, begun))
}

/// It ends, and not too soon.
async fn check_expired(robot: &mut Robot, fence: u64, (mut alice, begun): (Raw, Instant)) {
    robot.expect("halt").await;
    robot
        .expect(&format!("released {} expired {fence}", alice.name()))
        .await;
    let lasted = begun.elapsed();
    assert!(lasted >= Duration::from_secs(1), "{lasted:?}");
    let error = alice.ask(about("renew")).await.expect_err("it is over");
    assert_eq!(error.code.word(), "not-owner");
}
