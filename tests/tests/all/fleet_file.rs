//! A gateway follows its fleet's file while its robots drive (W12, W14).

use std::fs::File;
use std::process::Stdio;
use std::thread::JoinHandle;
use std::time::Instant;

use mom_client::{Channel, Client, Code, Event, Events, Family, Map, Parcel, Path, Value};
use mom_tests::programs::{PATIENCE, Running, project, run, text};
use serde_json::Value as Json;
use tokio::time::timeout;

/// The row of a robot in `mom fleet list`, once it is as asked for.
fn row(hub: &str, unit: i64, is: impl Fn(&Json) -> bool) -> Json {
    let user = [("MOM_HUB", hub), ("MOM_USER", "bob"), ("MOM_PASSWORD", "bob")];
    let until = Instant::now() + PATIENCE;
    loop {
        let output = run("mom", &["--json", "fleet", "list"], &user);
        let rows = text(&output.stdout);
        let mut rows = rows.lines().filter_map(|line| serde_json::from_str(line).ok());
        let row: Option<Json> = rows.find(|row: &Json| row["unit"] == unit);
        if let Some(row) = row.as_ref().filter(|row| is(row)) {
            return row.clone();
        }
        assert!(Instant::now() < until, "robot {unit}: {row:?}");
    }
}

/// Waits until a log says that.
pub(crate) fn logged(log: &std::path::Path, words: &str) -> String {
    let until = Instant::now() + PATIENCE;
    loop {
        let said = std::fs::read_to_string(log).expect("the log is there");
        if let Some(line) = said.lines().find(|line| line.contains(words)) {
            return line.to_owned();
        }
        assert!(Instant::now() < until, "{words} in {said}");
    }
}

/// The table of each of the five robots, once their program has written them.
pub(crate) fn tables(file: &str) -> Vec<String> {
    let until = Instant::now() + PATIENCE;
    loop {
        let text = std::fs::read_to_string(file).unwrap_or_default();
        let tables: Vec<String> = text
            .split("[[robot]]")
            .skip(1)
            .map(|table| format!("[[robot]]{table}"))
            .collect();
        if tables.len() == 5 {
            return tables;
        }
        assert!(Instant::now() < until, "{text}");
    }
}

/// Has alice send a robot a statement; whether it succeeded, and what was said.
fn drive(hub: &str, unit: &'static str, statement: &'static str) -> JoinHandle<(bool, String)> {
    let hub = hub.to_owned();
    std::thread::spawn(move || {
        let alice = [
            ("MOM_HUB", hub.as_str()),
            ("MOM_USER", "alice"),
            ("MOM_PASSWORD", "alice"),
        ];
        let output = run("mom", &["fleet", "send", unit, statement], &alice);
        (
            output.status.success(),
            text(&output.stdout) + &text(&output.stderr),
        )
    })
}

#[test]
fn a_changed_file_is_taken_over_while_the_other_robots_drive() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| {
        folder
            .path()
            .join(name)
            .to_str()
            .expect("a path in text")
            .to_owned()
    };
    let (all, fleet, log) = (at("all.toml"), at("fleet.toml"), folder.path().join("log"));
    let robots = ["--robots", "5", "--write-fleet", &all, "--listen", "127.0.0.1:0"];
    let _robots = Running::start("mom-linuxbot", &robots, &[]);
    let tables = tables(&all);
    std::fs::write(&fleet, tables[..3].concat()).expect("it is written");
    let (_broker, address) = Running::broker(&project().join("config/fleet.toml"));
    let hub = format!("bin://{address}");
    let gateway = Running::start_with(
        "mom-gateway",
        &["--fleet", &fleet, "--hub", &hub, "--manager", "robot-token"],
        &[("MOM_PASSWORD", "gateway")],
        Stdio::from(File::create(&log).expect("a log")),
    );
    logged(&log, "all robots are connected");
    let (stays, goes) = (
        drive(&hub, "1", "motor 50 -50 5000"),
        drive(&hub, "2", "motor 50 -50 60000"),
    );
    for unit in [1, 2] {
        row(&hub, unit, |row| row["moving"] == true && row["linked"] == true);
    }
    // A file with a mistake is refused whole.
    std::fs::write(&fleet, tables[1].clone() + "adress = \"127.0.0.1:1\"\n").expect("it is written");
    gateway.signal("HUP");
    let refused = logged(&log, "the fleet stays as it was");
    assert!(
        refused.contains("column 1: there is no key `adress`"),
        "{refused}"
    );
    // The second is taken out, the third is the fifth from now on, and the fourth comes.
    let third = tables[4].replace("unit = 5", "unit = 3");
    std::fs::write(
        &fleet,
        [&tables[0], &third, &tables[3]].map(String::as_str).concat(),
    )
    .expect("it is written");
    gateway.signal("HUP");
    logged(&log, "the fleet's file is taken over");
    let gone = row(&hub, 2, |row| row["linked"] == false);
    assert_eq!(
        gone["unreached-why"], "it was taken out of the fleet's file",
        "{gone}"
    );
    let (succeeded, said) = goes.join().expect("it has ended");
    assert!(!succeeded, "{said}");
    for (unit, name) in [(3, "3"), (4, "4")] {
        row(&hub, unit, |row| row["linked"] == true);
        let (succeeded, said) = drive(&hub, name, "leds 255").join().expect("it has ended");
        assert!(succeeded, "{said}");
    }
    let (succeeded, said) = stays.join().expect("it has ended");
    assert!(succeeded && said.contains("finished"), "{said}");
    // It is back as soon as it is in the file again.
    std::fs::write(&fleet, tables.concat()).expect("it is written");
    gateway.signal("HUP");
    row(&hub, 2, |row| row["linked"] == true);
    row(&hub, 5, |row| row["linked"] == true);
    gateway.signal("TERM");
    assert!(gateway.wait().success());
}

/// The next message of this name, and what it says.
async fn told(events: &mut Events, name: &str, is: impl Fn(&Value) -> bool) -> Value {
    let wanted = async {
        loop {
            match events.next().await.expect("the channel stays") {
                Event::Message(parcel) if parcel.name() == name && is(&parcel.value()) => {
                    return parcel.value();
                }
                _ => {}
            }
        }
    };
    timeout(PATIENCE, wanted)
        .await
        .unwrap_or_else(|_| panic!("{name} does not come"))
}

fn entry(unit: i64, address: &str) -> Map {
    Map::new().with("unit", unit).with("address", address)
}

/// The addresses that the gateway tells, by unit number.
fn addresses(robots: &Value) -> Vec<(i64, String)> {
    let robots = robots.get("robots").and_then(Value::as_list).expect("a list");
    let of = |robot: &Value| {
        let unit = robot.get("unit").and_then(Value::as_int).expect("a number");
        (
            unit,
            robot
                .get("address")
                .and_then(Value::as_str)
                .expect("an address")
                .to_owned(),
        )
    };
    robots.iter().map(of).collect()
}

/// An operator at the hub.
struct Operator {
    client: Client,
    channel: Channel,
    events: Events,
}

impl Operator {
    async fn at(hub: &str) -> Operator {
        let client = Client::builder(hub)
            .user("carol")
            .password("carol")
            .connect()
            .await;
        let client = client.expect("a user of the lab");
        let channel = client.channel("/fleet/file").await.expect("operators may");
        let events = channel.events();
        Operator {
            client,
            channel,
            events,
        }
    }

    /// What the gateway answers to an edit.
    async fn edit(&mut self, edit: Map) -> Value {
        self.channel.send("edit", edit).await.expect("operators may");
        told(&mut self.events, "edited", |_| true).await
    }

    async fn robots(&mut self, count: usize) -> Vec<(i64, String)> {
        let is = |said: &Value| addresses(said).len() == count;
        addresses(&told(&mut self.events, "robots", is).await)
    }
}

fn word<'a>(said: &'a Value, key: &str) -> Option<&'a str> {
    said.get(key).and_then(Value::as_str)
}

/// Robots, their gateway and its hub as programs; the file has the first three robots, with a comment.
struct FleetLab {
    folder: tempfile::TempDir,
    hub: String,
    /// The addresses of the five robots, by their number less one.
    at: Vec<String>,
    gateway: Running,
    _programs: [Running; 2],
}

impl FleetLab {
    fn start() -> FleetLab {
        let folder = tempfile::tempdir().expect("a folder");
        let all = folder.path().join("all.toml");
        let all = all.to_str().expect("text").to_owned();
        let robots = ["--robots", "5", "--write-fleet", &all, "--listen", "127.0.0.1:0"];
        let robots = Running::start("mom-linuxbot", &robots, &[]);
        let tables = tables(&all);
        let quoted = |table: &String| table.split('"').nth(1).expect("an address").to_owned();
        let fleet = folder.path().join("fleet.toml");
        std::fs::write(&fleet, format!("# Ours.\n\n{}", tables[..3].concat())).expect("it is written");
        let (broker, address) = Running::broker(&project().join("config/fleet.toml"));
        let hub = format!("bin://{address}");
        let gateway = FleetLab::gateway(&folder, &hub);
        logged(&folder.path().join("log"), "all robots are connected");
        FleetLab {
            at: tables.iter().map(quoted).collect(),
            folder,
            hub,
            gateway,
            _programs: [robots, broker],
        }
    }

    fn gateway(folder: &tempfile::TempDir, hub: &str) -> Running {
        let fleet = folder.path().join("fleet.toml");
        Running::start_with(
            "mom-gateway",
            &[
                "--fleet",
                fleet.to_str().expect("text"),
                "--hub",
                hub,
                "--manager",
                "robot-token",
            ],
            &[("MOM_PASSWORD", "gateway")],
            Stdio::from(File::create(folder.path().join("log")).expect("a log")),
        )
    }

    fn file(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("fleet.toml")).expect("it is there")
    }
}

async fn what_would_be_wrong_changes_nothing(lab: &FleetLab, carol: &mut Operator) {
    let before = lab.file();
    for (edit, name, field) in [
        (
            Map::new().with("add", entry(4, &lab.at[4])),
            "bad-content",
            Some("unit"),
        ),
        (
            Map::new().with("add", entry(5, &lab.at[0])),
            "bad-content",
            Some("address"),
        ),
        (
            Map::new().with("add", entry(5, "nowhere")),
            "bad-content",
            Some("address"),
        ),
        (
            Map::new().with("add", entry(5, &lab.at[4]).with("group", "7")),
            "bad-content",
            Some("group"),
        ),
        (
            Map::new().with("add", entry(5, &lab.at[4]).with("key", "x")),
            "bad-content",
            None,
        ),
        (
            Map::new().with("remove", 2).with("was", lab.at[0].as_str()),
            "stale",
            None,
        ),
        (
            Map::new().with("remove", 9).with("was", lab.at[0].as_str()),
            "stale",
            None,
        ),
        (Map::new().with("remove", 2), "bad-content", None),
    ] {
        let said = carol.edit(edit.clone()).await;
        assert_eq!(
            (word(&said, "name"), word(&said, "field")),
            (Some(name), field),
            "{edit:?}: {said:?}"
        );
        assert_eq!(said.get("ok"), Some(&false.into()));
    }
    assert_eq!(lab.file(), before);
}

/// An operator adds, changes and removes robots at the hub (W12, W14): the gateway keeps the file, with its comments,
/// drives what it says, and answers each mistake with the field at fault.
#[tokio::test(flavor = "multi_thread")]
async fn an_operator_edits_the_fleet_at_the_hub() {
    let lab = FleetLab::start();
    let hub = lab.hub.as_str();
    let mut carol = Operator::at(hub).await;
    assert_eq!(carol.robots(3).await.len(), 3);

    let said = carol
        .edit(Map::new().with("add", entry(4, &lab.at[3]).with("name", "by the door")))
        .await;
    assert_eq!(
        (said.get("ok"), word(&said, "by")),
        (Some(&true.into()), Some("carol")),
        "{said:?}"
    );
    assert_eq!(carol.robots(4).await[3], (4, lab.at[3].clone()));
    row(hub, 4, |row| row["linked"] == true);
    assert!(
        lab.file().starts_with("# Ours.\n") && lab.file().contains("name = \"by the door\""),
        "{}",
        lab.file()
    );

    what_would_be_wrong_changes_nothing(&lab, &mut carol).await;

    // The third listens elsewhere from now on; the first is removed.
    let to = entry(3, &lab.at[4]);
    let said = carol
        .edit(
            Map::new()
                .with("change", 3)
                .with("was", lab.at[2].as_str())
                .with("to", to),
        )
        .await;
    assert_eq!(said.get("ok"), Some(&true.into()), "{said:?}");
    assert_eq!(carol.robots(4).await[2], (3, lab.at[4].clone()));
    row(hub, 3, |row| row["linked"] == true);
    let said = carol
        .edit(Map::new().with("remove", 1).with("was", lab.at[0].as_str()))
        .await;
    assert_eq!(said.get("ok"), Some(&true.into()), "{said:?}");
    let gone = row(hub, 1, |row| row["linked"] == false);
    assert_eq!(
        gone["unreached-why"], "it was taken out of the fleet's file",
        "{gone}"
    );
    assert_eq!(
        addresses(&told(&mut carol.events, "robots", |_| true).await).len(),
        3
    );
    logged(&lab.folder.path().join("log"), "by=\"carol\"");
    let FleetLab {
        folder,
        hub,
        at,
        gateway,
        _programs,
    } = lab;
    gateway.signal("TERM");
    assert!(gateway.wait().success());
    // The channel has kept the last edit: it is done once, even if a gateway joins later.
    let file = folder.path().join("fleet.toml");
    let text = std::fs::read_to_string(&file).expect("it is there");
    let first = format!("\n[[robot]]\nunit = 1\naddress = \"{}\"\n", at[0]);
    std::fs::write(&file, text + &first).expect("it is written");
    let _again = FleetLab::gateway(&folder, &hub);
    assert_eq!(carol.robots(4).await[0], (1, at[0].clone()));
    let said = carol
        .edit(Map::new().with("remove", 9).with("was", "nowhere:1"))
        .await;
    assert_eq!(word(&said, "name"), Some("stale"), "{said:?}");
    let text = std::fs::read_to_string(&file).expect("it is there");
    assert!(text.contains(&at[0]), "{text}");
    carol.client.close().await;
}

/// A robot that another user holds is left to them; who is not an operator neither sees where robots listen nor changes it.
#[tokio::test(flavor = "multi_thread")]
async fn an_edit_takes_no_robot_out_of_anybodys_hands() {
    let lab = FleetLab::start();
    let mut carol = Operator::at(&lab.hub).await;
    carol.robots(3).await;
    let alice = Client::builder(&lab.hub)
        .user("alice")
        .password("alice")
        .connect()
        .await;
    let alice = alice.expect("a user of the lab");
    let token = alice.token("/fleet/1/token").await.expect("anybody may");
    let guard = token.grab().await.expect("it is free");
    let remove = || Map::new().with("remove", 1).with("was", lab.at[0].as_str());
    let elsewhere = Map::new()
        .with("change", 1)
        .with("was", lab.at[0].as_str())
        .with("to", entry(1, &lab.at[4]));
    for edit in [remove(), elsewhere] {
        let said = carol.edit(edit).await;
        assert_eq!(word(&said, "name"), Some("held"), "{said:?}");
        assert!(
            word(&said, "text").is_some_and(|text| text.contains("alice holds /fleet/1/token")),
            "{said:?}"
        );
    }
    assert_eq!(guard.release().await.map_err(|error| error.to_string()), Ok(()));
    let said = carol.edit(remove()).await;
    assert_eq!(said.get("ok"), Some(&true.into()), "{said:?}");

    let error = alice
        .channel("/fleet/file")
        .await
        .expect_err("she is not an operator");
    assert_eq!(error.code().map(Code::word), Some("denied"), "{error}");
    let edit = Parcel::new(Family::Message, "edit")
        .context(Path::parse("/fleet/file").expect("a path"))
        .content(Map::new().with("remove", 2).with("was", lab.at[1].as_str()));
    let mut edit = edit;
    edit.receipt = Some(true);
    let refused = alice.request(edit).await;
    assert!(refused.is_err(), "{refused:?}");
    assert!(lab.file().contains(&lab.at[1]));
    alice.close().await;
    carol.client.close().await;
}

/// A stop holds for its channel: a stopped robot becomes no other unit, by no edit and by no file that is taken over.
#[tokio::test(flavor = "multi_thread")]
async fn a_stopped_robot_becomes_no_other_unit() {
    let lab = FleetLab::start();
    let mut carol = Operator::at(&lab.hub).await;
    carol.robots(3).await;
    let path = Path::parse("/fleet/1/robot").expect("a path");
    carol
        .client
        .stop(path.as_str())
        .send()
        .await
        .expect("operators may");
    let change = |to: Map| {
        Map::new()
            .with("change", 1)
            .with("was", lab.at[0].as_str())
            .with("to", to)
    };
    for edit in [
        change(entry(11, &lab.at[0])),
        change(entry(1, &lab.at[4])),
        Map::new().with("remove", 1).with("was", lab.at[0].as_str()),
    ] {
        let said = carol.edit(edit).await;
        assert_eq!(word(&said, "name"), Some("stopped"), "{said:?}");
        let text = word(&said, "text").unwrap_or_default();
        assert!(text.contains("unit 1 is stopped by carol"), "{text}");
    }
    let said = carol.edit(change(entry(1, &lab.at[0]).with("name", "Bob"))).await;
    assert_eq!(
        said.get("ok"),
        Some(&true.into()),
        "its name is nothing to it: {said:?}"
    );

    let log = lab.folder.path().join("log");
    let edited = lab.file().replace("unit = 1\n", "unit = 11\n");
    std::fs::write(lab.folder.path().join("fleet.toml"), edited).expect("it is written");
    lab.gateway.signal("HUP");
    let refused = logged(&log, "the fleet's file is not taken over");
    assert!(refused.contains("unit 1 is stopped by carol"), "{refused}");
    row(&lab.hub, 1, |row| row["linked"] == true);

    let number = carol
        .client
        .stops(path.as_str())
        .await
        .expect("she is told")
        .number;
    carol
        .client
        .unstop(path.as_str(), [(&path, number)])
        .send()
        .await
        .expect("operators may");
    lab.gateway.signal("HUP");
    row(&lab.hub, 11, |row| row["linked"] == true);
    carol.client.close().await;
}

/// Who drives a robot by its group's token does so from the moment on in which the robot is in the group.
#[tokio::test(flavor = "multi_thread")]
async fn a_change_of_the_group_changes_whose_token_guards() {
    let lab = FleetLab::start();
    let mut carol = Operator::at(&lab.hub).await;
    carol.robots(3).await;
    let to = entry(2, &lab.at[1]).with("group", "scouts");
    let said = carol
        .edit(
            Map::new()
                .with("change", 2)
                .with("was", lab.at[1].as_str())
                .with("to", to),
        )
        .await;
    assert_eq!(said.get("ok"), Some(&true.into()), "{said:?}");
    let until = Instant::now() + PATIENCE;
    loop {
        let info = carol.client.info("/fleet/2/robot").await;
        let guard = info.ok().and_then(|info| info.get("guard").cloned());
        if guard
            .as_ref()
            .is_some_and(|guard| word(guard, "token") == Some("/fleet/scouts/token"))
        {
            break;
        }
        assert!(Instant::now() < until, "{guard:?}");
    }
    row(&lab.hub, 2, |row| row["linked"] == true);
    let (succeeded, said) = drive(&lab.hub, "2", "leds 255").join().expect("it has ended");
    assert!(succeeded, "{said}");
    carol.client.close().await;
}

/// A spare gateway edits nothing before the first is gone.
#[tokio::test(flavor = "multi_thread")]
async fn one_of_two_gateways_edits() {
    let lab = FleetLab::start();
    let mut carol = Operator::at(&lab.hub).await;
    carol.robots(3).await;
    let spare = tempfile::tempdir().expect("a folder");
    std::fs::write(spare.path().join("fleet.toml"), lab.file()).expect("it is written");
    let _spare = FleetLab::gateway(&spare, &lab.hub);
    logged(
        &spare.path().join("log"),
        "another gateway edits the fleet's file",
    );
    let said = carol.edit(Map::new().with("add", entry(4, &lab.at[3]))).await;
    assert_eq!(said.get("ok"), Some(&true.into()), "{said:?}");
    assert_eq!(carol.robots(4).await.len(), 4);
    let of_spare = std::fs::read_to_string(spare.path().join("fleet.toml")).expect("it is there");
    assert!(!of_spare.contains(&lab.at[3]), "{of_spare}");
    lab.gateway.signal("TERM");
    assert_eq!(carol.robots(3).await.len(), 3, "the spare tells its own file");
    carol.client.close().await;
}
