//! The fleet (W1 to W17): robots on the base station's wire, driven through the hub as any device.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::process::Output;
use std::time::Instant;

use mom_client::{Client, Code, Event, Events, TokenGuard, Value};
use mom_drive::{CommandEnd, Commander, DeviceChannel, How};
use mom_tests::programs::{PATIENCE, Running, project, run, text};
use serde_json::Value as Json;
use tokio::time::timeout;

/// What `mom` does for this person.
fn typed(hub: &str, user: &str, words: &[&str]) -> Output {
    run(
        "mom",
        words,
        &[("MOM_HUB", hub), ("MOM_USER", user), ("MOM_PASSWORD", user)],
    )
}

fn good(hub: &str, user: &str, words: &[&str]) -> String {
    let said = typed(hub, user, words);
    let (out, errors) = (text(&said.stdout), text(&said.stderr));
    assert!(said.status.success(), "{words:?}: {out}{errors}");
    out
}

fn bad(hub: &str, user: &str, words: &[&str]) -> String {
    let said = typed(hub, user, words);
    assert!(!said.status.success(), "{words:?}");
    text(&said.stdout) + &text(&said.stderr)
}

/// The rows of `mom fleet list`, once all robots have said how they are.
fn list(hub: &str) -> Vec<Json> {
    let until = Instant::now() + PATIENCE;
    loop {
        let out = good(hub, "bob", &["--json", "fleet", "list"]);
        let rows: Vec<Json> = out
            .lines()
            .map(|line| serde_json::from_str(line).expect("a row"))
            .collect();
        if rows.iter().all(|row| row["linked"] == true && row["x"].is_i64()) {
            return rows;
        }
        assert!(Instant::now() < until, "not all are told of: {rows:?}");
    }
}

fn number(row: &Json, key: &str) -> i64 {
    row[key].as_i64().unwrap_or_else(|| panic!("{key} in {row}"))
}

async fn arrive(hub: &str, name: &str) -> Client {
    let client = Client::builder(hub).user(name).password(name).connect().await;
    client.expect("the lab knows its users")
}

/// A robot under its token.
async fn drive(client: &Client, unit: u32, token: &str) -> (Commander, TokenGuard) {
    let held = client.token(token).await.expect("they may look");
    let guard = held.grab().await.expect("it is free");
    let channel = format!("/fleet/{unit}/robot");
    let channel = DeviceChannel::join(client, &channel)
        .await
        .expect("they may look");
    (Commander::new(channel, guard.fence()), guard)
}

/// What of a robot the fleet's channel tells next that is as wanted.
async fn told(status: &mut Events, unit: i64, wanted: impl Fn(&Value) -> bool) -> Value {
    let told = async {
        loop {
            if let Some(Event::Message(parcel)) = status.next().await {
                let content = parcel.value();
                if content.get("unit").and_then(Value::as_int) == Some(unit) && wanted(&content) {
                    return content;
                }
            }
        }
    };
    timeout(PATIENCE, told).await.expect("it is told")
}

fn moves(content: &Value) -> bool {
    content.get("moving").and_then(Value::as_bool) == Some(true)
}

fn code_of(end: CommandEnd) -> Code {
    match end.how {
        How::Failed(report) => report.wire_error().code,
        other => panic!("not refused: {other:?}"),
    }
}

#[test]
fn robots_are_driven_side_by_side_and_told_of() {
    let (_lab, hub) = Running::lab_with(&["--fleet", "3"]);
    let before = list(&hub);
    assert_eq!(
        before.iter().map(|row| number(row, "unit")).collect::<Vec<_>>(),
        [1, 2, 3]
    );
    for row in &before {
        assert_eq!(
            (number(row, "battery"), &row["stopped"]),
            (100, &Json::Bool(false))
        );
        assert!(number(row, "round-trip") > 0, "{row}");
        assert!(row["age-ms"].as_f64().is_some_and(|age| age > 0.0), "{row}");
    }
    let done = good(
        &hub,
        "alice",
        &["fleet", "send", "1,3", "motor 400 400 500; leds 5"],
    );
    assert_eq!(done.matches("finished").count(), 2, "{done}");
    let after = list(&hub);
    for (before, after) in before.iter().zip(&after) {
        let driven = number(after, "unit") != 2;
        let way = number(after, "x") - number(before, "x");
        assert_eq!(way > 100, driven, "{after}");
        assert_eq!(number(after, "leds"), if driven { 5 } else { 0 }, "{after}");
    }
    let script = "# a column\n1: goto 700 1200\n2-3: via 1500 1200 1200 1200\n---\nall: leds 255\n";
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("formation.txt");
    std::fs::write(&file, script).expect("it is written");
    let said = good(&hub, "alice", &["fleet", "run", file.to_str().expect("a path")]);
    let last: Vec<&str> = said.lines().skip(3).collect();
    assert!(
        last.len() == 3 && last.iter().all(|line| line.ends_with("finished  leds 255")),
        "nobody blinks before all are there: {said}"
    );
    for (row, (x, y)) in list(&hub).iter().zip([(700, 1200), (1200, 1200), (1200, 1200)]) {
        assert!(
            (number(row, "x") - x).abs() < 20 && (number(row, "y") - y).abs() < 20,
            "{row}"
        );
    }
}

#[test]
fn what_is_wrong_is_told_before_anything_moves() {
    let (_lab, hub) = Running::lab_with(&["--fleet", "2"]);
    list(&hub);
    for (words, told) in [
        (&["fleet", "send", "3", "leds 1"][..], "there is no robot 3"),
        (
            &["fleet", "send", "1", "gogo 1 2"],
            "there is no `gogo`; did you mean `goto`?",
        ),
        (
            &["fleet", "send", "1", "motor 2000 0 5"],
            "left is a whole number from -1000 to 1000, not `2000`",
        ),
        (&["fleet", "--fleet", "/chat", "list"], "/chat"),
    ] {
        let said = bad(&hub, "alice", words);
        assert!(said.contains(told), "{words:?}: {said}");
    }
    assert!(
        list(&hub)
            .iter()
            .all(|row| row["moving"] == false && number(row, "fence") == 0)
    );
    // A wall is found only by driving into it.
    let said = bad(&hub, "alice", &["fleet", "send", "1", "goto 9000 500"]);
    assert!(
        said.contains("obstacle: robot 1 gave its way up: something was in its way"),
        "{said}"
    );
    good(&hub, "alice", &["stop", "/fleet"]);
    let said = bad(&hub, "alice", &["fleet", "send", "2", "leds 1"]);
    assert!(
        said.contains("-> let it go with: mom unstop /fleet/2/robot"),
        "{said}"
    );
    good(&hub, "alice", &["unstop", "/fleet"]);
    good(&hub, "alice", &["fleet", "send", "2", "leds 1"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_whose_owner_is_lost_stands_and_obeys_the_next_one_only() {
    let (_lab, hub) = Running::lab_with(&["--fleet", "2"]);
    let (alice, carol) = (arrive(&hub, "alice").await, arrive(&hub, "carol").await);
    let mut status = carol
        .channel("/fleet/status")
        .await
        .expect("she may look")
        .events();
    told(&mut status, 1, |content| content.get("x").is_some()).await;
    let (mut robot, guard) = drive(&alice, 1, "/fleet/1/token").await;
    let fence = guard.fence();
    let moving = tokio::spawn(async move { (robot.carry_out("motor 100 -100 60000").await, robot) });
    let content = told(&mut status, 1, moves).await;
    assert_eq!(content.get("owner").and_then(Value::as_str), Some("alice"));
    // Her level is above that of alice.
    let (mut hers, _token) = drive(&carol, 1, "/fleet/1/token").await;
    let (ended, _) = timeout(PATIENCE, moving)
        .await
        .expect("it ends")
        .expect("no panic");
    let halted = code_of(ended);
    assert_eq!(halted.word(), "halted");
    let content = told(&mut status, 1, |content| !moves(content)).await;
    assert_eq!(content.get("owner").and_then(Value::as_str), Some("carol"));
    // What the old owner says now does nothing.
    let channel = alice.channel("/fleet/1/robot").await.expect("she may look");
    let late = channel
        .message("command")
        .content("motor 500 500 5000")
        .fence(fence);
    let refused = late.send_acknowledged().await.expect_err("it is not hers");
    assert_eq!(refused.code(), Some(&Code::OLDER_FENCE));
    assert!(hers.carry_out("leds 3").await.is_finished());
    // So does the end of a connection.
    let (mut robot, _token) = drive(&alice, 2, "/fleet/2/token").await;
    let gone = tokio::spawn(async move { robot.carry_out("motor -100 100 60000").await });
    told(&mut status, 2, moves).await;
    alice.close().await;
    told(&mut status, 2, |content| !moves(content)).await;
    drop(gone);
}

#[tokio::test(flavor = "multi_thread")]
async fn one_who_takes_the_token_of_all_has_all() {
    let (_lab, hub) = Running::lab_with(&["--fleet", "4", "--together"]);
    let (alice, carol) = (arrive(&hub, "alice").await, arrive(&hub, "carol").await);
    let mut status = carol
        .channel("/fleet/status")
        .await
        .expect("she may look")
        .events();
    for unit in 1..=4 {
        told(&mut status, unit, |content| content.get("x").is_some()).await;
    }
    let (_, guard) = drive(&alice, 1, "/fleet/token").await;
    for unit in 1..=4 {
        let channel = alice
            .channel(&format!("/fleet/{unit}/robot"))
            .await
            .expect("she may look");
        let command = channel.message("command").content("motor 100 -100 60000");
        command.fence(guard.fence()).send().await.expect("it is hers");
    }
    for unit in 1..=4 {
        told(&mut status, unit, moves).await;
    }
    let said = bad(&hub, "bob", &["fleet", "send", "all", "leds 1"]);
    assert!(said.contains("alice"), "{said}");
    let token = carol.token("/fleet/token").await.expect("she may look");
    let _hers = token.grab().await.expect("her level is above that of alice");
    for unit in 1..=4 {
        let content = told(&mut status, unit, |content| !moves(content)).await;
        assert_eq!(
            content.get("owner").and_then(Value::as_str),
            Some("carol"),
            "{unit}"
        );
    }
}

/// The rows of `mom fleet list` as soon as they are as wanted.
fn list_until(hub: &str, wanted: impl Fn(&Json) -> bool) {
    let until = Instant::now() + PATIENCE;
    loop {
        let said = typed(hub, "bob", &["--json", "fleet", "list"]);
        let out = text(&said.stdout);
        let mut rows = out.lines().map(|line| serde_json::from_str(line).expect("a row"));
        // Before the gateway has made its place there is none.
        if said.status.success() && rows.all(|row: Json| wanted(&row)) {
            return;
        }
        assert!(Instant::now() < until, "it never came to that: {out}");
    }
}

/// Whether a robot's motors are set, as it tells a base station of its own (W4).
fn is_moving(address: &str) -> bool {
    loop {
        let mut robot = TcpStream::connect(address).expect("it listens");
        robot.write_all(b"04").expect("it reads");
        let mut reply = [0; 8];
        // Until it has seen that another one is gone, it closes this one.
        if robot.read_exact(&mut reply).is_ok() && reply.starts_with(b"04 ") {
            let bits: u32 = text(&reply[3..]).parse().expect("a mask");
            return bits & 16 != 0;
        }
    }
}

/// Robots, gateway and hub as programs of their own: what of them is lost is told, comes back, and leaves nothing moving.
#[test]
fn what_is_lost_of_a_fleet_leaves_nothing_moving() {
    let folder = tempfile::tempdir().expect("a folder");
    let fleet = folder.path().join("fleet.toml");
    let fleet = fleet.to_str().expect("a path in text");
    let robot = |listen: &str| {
        let robot = Running::start("mom-linuxbot", &["--listen", listen, "--write-fleet", fleet], &[]);
        let line = robot.line_with("listens at");
        let address = line.split_whitespace().last().expect("an address").to_owned();
        (robot, address)
    };
    let (first, address) = robot("127.0.0.1:0");
    let (_broker, hub) = Running::broker(&project().join("config/fleet.toml"));
    let hub = format!("bin://{hub}");
    let arguments = ["--fleet", fleet, "--hub", &hub, "--manager", "robot-token"];
    let gateway = Running::start("mom-gateway", &arguments, &[("MOM_PASSWORD", "gateway")]);
    list_until(&hub, |row| row["linked"] == true && row["x"].is_i64());
    good(&hub, "alice", &["fleet", "send", "1", "motor 300 300 200"]);
    // It answers no more. What is told of it is as old as its last replies, three seconds and more.
    first.signal("STOP");
    list_until(&hub, |row| {
        let lost = row["linked"] == false;
        assert!(
            !lost || row["age-ms"].as_f64().is_some_and(|age| age > 2000.0),
            "{row}"
        );
        // Nobody knows that it stands.
        let known = row["moving"] == false || row["reached"] == true || !row["unreached-since"].is_i64();
        assert!(!lost || !known, "{row}");
        lost
    });
    first.signal("CONT");
    list_until(&hub, |row| row["linked"] == true);
    // The robot's program ends, and begins again.
    drop(first);
    list_until(&hub, |row| row["linked"] == false);
    let said = bad(&hub, "alice", &["fleet", "send", "1", "leds 1"]);
    assert!(said.contains("robot 1 is not connected to its gateway"), "{said}");
    let (_second, again) = robot(&address);
    assert_eq!(again, address);
    list_until(&hub, |row| row["linked"] == true);
    // The gateway is killed while the robot moves.
    let user = [
        ("MOM_HUB", &*hub),
        ("MOM_USER", "alice"),
        ("MOM_PASSWORD", "alice"),
    ];
    let _driving = Running::start("mom", &["fleet", "send", "1", "motor 100 -100 60000"], &user);
    list_until(&hub, |row| row["moving"] == true);
    gateway.signal("KILL");
    assert!(!is_moving(&address), "its connection is gone, so it stands");
}

/// What a robot's own page says that its left motor is set to, and where it is.
fn page(address: &str) -> (i64, f64) {
    let mut page = TcpStream::connect(address).expect("it listens");
    let request = b"GET /status.json HTTP/1.1\r\nHost: robot\r\nConnection: close\r\n\r\n";
    page.write_all(request).expect("it reads");
    let mut answer = String::new();
    page.read_to_string(&mut answer).expect("it answers");
    let (_, body) = answer.split_once("\r\n\r\n").expect("a head");
    let state: Json = serde_json::from_str(body).expect("an object");
    (number(&state, "left"), state["x"].as_f64().expect("mm"))
}

/// Waits until the page of a robot says so of its left motor.
fn page_until(address: &str, wanted: impl Fn(i64) -> bool) {
    let until = Instant::now() + PATIENCE;
    while !wanted(page(address).0) {
        assert!(
            Instant::now() < until,
            "it never came to that: {:?}",
            page(address)
        );
    }
}

/// A hub, its gateway and so many robots as programs of their own; the addresses of the robots' pages.
struct Programs {
    broker: Option<Running>,
    hub: String,
    _gateway: Running,
    _robots: Running,
    pages: Vec<String>,
    _folder: tempfile::TempDir,
}

impl Programs {
    fn start(robots: &str) -> Programs {
        let folder = tempfile::tempdir().expect("a folder");
        let fleet = folder.path().join("fleet.toml");
        let fleet = fleet.to_str().expect("a path in text");
        let listen = ["--listen", "127.0.0.1:0", "--web", "127.0.0.1:0"];
        let options = [&["--robots", robots, "--write-fleet", fleet], &listen[..]].concat();
        let running = Running::start("mom-linuxbot", &options, &[]);
        let pages = (1..=robots.parse().expect("a number"))
            .map(|unit: u32| {
                let line = running.line_with(&format!("robot {unit} has its page at"));
                let (_, address) = line.split_once("http://").expect("an address");
                address.trim_end_matches('/').to_owned()
            })
            .collect();
        let (broker, hub) = Running::broker(&project().join("config/fleet.toml"));
        let hub = format!("bin://{hub}");
        let arguments = ["--fleet", fleet, "--hub", &hub, "--manager", "robot-token"];
        let gateway = Running::start("mom-gateway", &arguments, &[("MOM_PASSWORD", "gateway")]);
        list_until(&hub, |row| row["linked"] == true && row["x"].is_i64());
        Programs {
            broker: Some(broker),
            hub,
            _gateway: gateway,
            _robots: running,
            pages,
            _folder: folder,
        }
    }

    /// A hub where the one before was, which knows nothing of it.
    fn begin_anew(&mut self) {
        let config = project().join("config/fleet.toml");
        let config = config.to_str().expect("a path in text");
        let address = self.hub.strip_prefix("bin://").expect("an address");
        let options = ["--config", config, "--listen", address];
        self.broker = Some(Running::start("mom-broker", &options, &[]));
    }

    /// Kills the hub as a power cut does.
    fn cut_power(&mut self) {
        let broker = self.broker.take().expect("it runs");
        broker.signal("KILL");
        broker.wait();
    }

    /// A robot that is a peer itself.
    fn rover(&self) -> Running {
        let options = [
            "--path",
            "/fleet/12",
            "--manager",
            "robot-token",
            "--user",
            "gateway",
        ];
        let options = [&options[..], &["--hub", &self.hub]].concat();
        Running::start("mom-rover", &options, &[("MOM_PASSWORD", "gateway")])
    }

    /// Alice drives, for as long as this lives.
    fn driving(&self, unit: &str) -> Running {
        let user = [
            ("MOM_HUB", &*self.hub),
            ("MOM_USER", "alice"),
            ("MOM_PASSWORD", "alice"),
        ];
        Running::start("mom", &["fleet", "send", unit, "motor 100 -100 60000"], &user)
    }
}

#[test]
fn a_deleted_channel_of_one_robot_leaves_the_others_and_comes_back() {
    let fleet = Programs::start("2");
    let _both = (fleet.driving("1"), fleet.driving("2"));
    page_until(&fleet.pages[0], |left| left == 100);
    page_until(&fleet.pages[1], |left| left == 100);
    good(&fleet.hub, "carol", &["delete", "/fleet/1/robot"]);
    page_until(&fleet.pages[0], |left| left == 0);
    assert_eq!(page(&fleet.pages[1]).0, 100, "the other one goes on");
    // It is taken up again, and stands until it is driven.
    let until = Instant::now() + PATIENCE;
    while !typed(&fleet.hub, "carol", &["fleet", "send", "1", "leds 3"])
        .status
        .success()
    {
        assert!(Instant::now() < until, "its channel never comes back");
    }
    assert_eq!((page(&fleet.pages[0]).0, page(&fleet.pages[1]).0), (0, 100));
}

#[test]
fn after_a_restart_of_the_hub_all_robots_go_on_and_none_has_moved_meanwhile() {
    let mut fleet = Programs::start("2");
    let _rover = fleet.rover();
    list_until(&fleet.hub, |row| row["linked"] == true);
    let driving = fleet.driving("1");
    page_until(&fleet.pages[0], |left| left == 100);
    fleet.cut_power();
    drop(driving);
    page_until(&fleet.pages[0], |left| left == 0);
    fleet.begin_anew();
    let until = Instant::now() + PATIENCE;
    for (user, unit) in [("alice", "1"), ("bob", "2"), ("carol", "12")] {
        while !typed(&fleet.hub, user, &["fleet", "send", unit, "leds 3"])
            .status
            .success()
        {
            assert!(Instant::now() < until, "robot {unit} never comes back");
        }
    }
    list_until(&fleet.hub, |row| {
        row["linked"] == true && number(row, "leds") == 3
    });
    assert_eq!(page(&fleet.pages[0]).0, 0);
}

/// A hub that forgets all, and with it the channels that the robots had made: their word that they are stopped is what there is.
#[test]
fn what_a_device_has_heard_of_stops_outlives_its_channel() {
    let mut fleet = Programs::start("1");
    let _rover = fleet.rover();
    list_until(&fleet.hub, |row| row["linked"] == true);
    good(&fleet.hub, "carol", &["stop", "/fleet/1/robot"]);
    good(&fleet.hub, "carol", &["stop", "/fleet/12/robot"]);
    fleet.cut_power();
    fleet.begin_anew();
    for (unit, path) in [("1", "/fleet/1/robot"), ("12", "/fleet/12/robot")] {
        let until = Instant::now() + PATIENCE;
        let refused = loop {
            let said = typed(&fleet.hub, "alice", &["fleet", "send", unit, "leds 3"]);
            assert!(!said.status.success(), "robot {unit} obeys without an unstop");
            let said = text(&said.stdout) + &text(&said.stderr);
            if said.contains("stopped") {
                break said;
            }
            assert!(Instant::now() < until, "robot {unit} never comes back: {said}");
        };
        assert!(refused.contains("is stopped"), "{refused}");
        good(&fleet.hub, "carol", &["unstop", path]);
        good(&fleet.hub, "alice", &["fleet", "send", unit, "leds 3"]);
    }
}
