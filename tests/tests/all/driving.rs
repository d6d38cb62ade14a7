//! `mom jog`, `mom run --show rapid` and `mom trace` in the lab: the hand moves for as long as it is told, no faster
//! than it can, and not out of its workspace.

use std::io::Write as _;
use std::process::{Command, Output, Stdio};

use mom_client::{Client, Event, Events, Value};
use mom_tests::programs::{PATIENCE, Running, program, project, run, text};
use serde_json::Value as Json;
use tokio::time::timeout;

fn jog(hub: &str, args: &[&str]) -> Output {
    let mut command = Command::new(program("mom"));
    command.arg("jog").args(args).stdin(Stdio::null());
    command.envs([("MOM_HUB", hub), ("MOM_USER", "alice"), ("MOM_PASSWORD", "alice")]);
    command.output().expect("it runs")
}

fn place(output: &Output, axis: &str) -> f64 {
    let said = text(&output.stdout) + &text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
    let json: Json = serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{said}"));
    json[axis].as_f64().unwrap_or_else(|| panic!("{json}"))
}

#[test]
fn the_hand_moves_for_as_long_as_it_is_told() {
    let (_lab, hub) = Running::lab();
    let moved = jog(&hub, &["--json", "--for", "600ms", "100", "0", "-50", "0", "0"]);
    // A velocity that is said late moves less, and none moves more: 60 mm and what it takes to brake.
    let (x, z) = (place(&moved, "x"), place(&moved, "z"));
    assert!(
        (10.0..75.0).contains(&x) && (260.0..295.0).contains(&z),
        "{x} {z}"
    );
    let further = jog(&hub, &["--json", "--for", "3s", "150", "0", "0", "0", "0"]);
    let edge = place(&further, "x");
    assert!((x + 100.0..=300.0).contains(&edge), "{edge}");
    for (args, code, words) in [
        (&["200", "0", "0", "0", "0"][..], 1, "200 mm/s is too fast"),
        (&["0", "0", "0", "-100", "0"], 1, "100 degrees/s is too fast"),
        (&["10", "0"], 2, "5 values required"),
        (&[], 2, "no terminal"),
    ] {
        let refused = jog(&hub, args);
        let said = text(&refused.stderr);
        assert_eq!(refused.status.code(), Some(code), "{args:?}: {said}");
        assert!(said.contains(words), "{args:?}: {said}");
    }
}

/// Two legs for a move to below, from where the arm is; the gripper by its output.
#[test]
fn a_script_is_shown_as_its_controller_would_be_told() {
    let (_lab, hub) = Running::lab();
    let mut command = Command::new(program("mom"));
    command.args(["run", "--show", "rapid", "-"]);
    command.envs([
        ("MOM_HUB", &*hub),
        ("MOM_USER", "alice"),
        ("MOM_PASSWORD", "alice"),
    ]);
    command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut running = command.spawn().expect("it starts");
    let mut stdin = running.stdin.take().expect("its input is piped");
    stdin
        .write_all(b"move 20 0 290 0 0; grip close\nmove 20 0 280 0 0")
        .expect("it reads");
    drop(stdin);
    let output = running.wait_with_output().expect("it runs");
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
    let lines: Vec<&str> = said.lines().filter(|line| line.ends_with(';')).collect();
    let moves = |place: &str, line: &str| {
        line.starts_with(&format!("MoveL [[{place}],")) && line.contains("vslow,fine,grippertool")
    };
    // Across at the height where it stands, then down; and from where the first command has led.
    assert!(
        moves("20,0,300", lines[0]) && moves("20,0,290", lines[1]),
        "{said}"
    );
    assert_eq!(lines[2], "SetDO do_gripper,1;");
    assert!(moves("20,0,280", lines[3]) && lines.len() == 4, "{said}");
}

/// The way of one command by the hub's clock: each step after the one before, as far as the clocks are known.
#[test]
fn a_command_is_traced_from_here_to_the_robot_and_back() {
    let (_lab, hub) = Running::lab();
    let mut command = Command::new(program("mom"));
    command
        .args(["trace", "--json", "move 15 0 300 0 0"])
        .stdin(Stdio::null());
    command.envs([
        ("MOM_HUB", &*hub),
        ("MOM_USER", "alice"),
        ("MOM_PASSWORD", "alice"),
    ]);
    let output = command.output().expect("it runs");
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let steps: Vec<Json> = text(&output.stdout)
        .lines()
        .map(|line| serde_json::from_str(line).expect("one object on each line"))
        .collect();
    let words: Vec<&str> = steps.iter().filter_map(|step| step["step"].as_str()).collect();
    let way = [
        "sent",
        "received by the hub",
        "delivered",
        "taken by the robot",
        "begun",
        "done",
        "heard here",
    ];
    assert_eq!(words, way);
    for pair in steps.windows(2) {
        let (before, after) = (&pair[0], &pair[1]);
        let known = before["error"].as_i64().zip(after["error"].as_i64());
        let Some((one, other)) = known else { continue };
        let passed = after["after"].as_i64().expect("µs") - before["after"].as_i64().expect("µs");
        assert!(passed >= -one - other, "{before} {after}");
    }
    // 15 mm at 150 mm/s.
    let [begun, done] = [4, 5].map(|place: usize| steps[place]["after"].as_i64().expect("µs"));
    assert!(done - begun > 90_000, "{begun} {done}");
}

/// `mom run` names the state that a relative command is based on (M35).
#[test]
fn a_script_goes_on_from_where_the_hand_is() {
    let (_lab, hub) = Running::lab();
    let file = tempfile::NamedTempFile::new().expect("a file");
    std::fs::write(file.path(), "by 10 0 0 0 0\nby 5 0 -20 0 0; by 1 0 0 0 0\n").expect("it is written");
    let path = file.path().to_str().expect("a path in text");
    let env = [
        ("MOM_HUB", &*hub),
        ("MOM_USER", "alice"),
        ("MOM_PASSWORD", "alice"),
    ];
    let done = run("mom", &["run", path], &env);
    let said = text(&done.stderr) + &text(&done.stdout);
    assert_eq!(done.status.code(), Some(0), "{said}");
    let state = jog(&hub, &["--json", "--for", "1ms", "0", "0", "0", "0", "0"]);
    assert_eq!((place(&state, "x"), place(&state, "z")), (16.0, 280.0));
}

/// A broker with the lab's configuration and the arm's own program, each a process.
struct RealArm {
    _broker: Running,
    _arm: Running,
    hub: String,
}

impl RealArm {
    async fn start(args: &[&str]) -> Self {
        let (broker, address) = Running::broker(&project().join("config/lab.toml"));
        let hub = format!("bin://{address}");
        let args = [&["--hub", &hub], args].concat();
        let lab = Self {
            _broker: broker,
            _arm: Running::start("mom-arm", &args, &[("MOM_PASSWORD", "arm")]),
            hub,
        };
        let carol = lab.join("carol").await;
        let mut states = carol
            .channel("/robot/arm")
            .await
            .expect("carol may look")
            .events();
        heard(&mut states, "state").await;
        lab
    }

    async fn join(&self, user: &str) -> Client {
        let client = Client::builder(&self.hub)
            .user(user)
            .password(user)
            .connect()
            .await;
        client.expect("the lab knows its users")
    }
}

/// The content of the next message of this name.
async fn heard(events: &mut Events, name: &str) -> Value {
    let wanted = async {
        loop {
            let event = events.next().await.expect("the client lives");
            if let Event::Message(parcel) = event
                && parcel.name() == name
            {
                return parcel.value();
            }
        }
    };
    timeout(PATIENCE, wanted)
        .await
        .unwrap_or_else(|_| panic!("never came: {name}"))
}

/// A command that waited behind another for longer than the arm takes it is not begun.
#[tokio::test]
async fn the_arm_does_not_begin_what_is_older_than_it_allows() {
    let lab = RealArm::start(&["--max-age", "600ms"]).await;
    let alice = lab.join("alice").await;
    let token = alice.token("/robot/token").await.expect("alice may look");
    let _guard = token.grab().await.expect("it is free");
    let arm = alice.channel("/robot/arm").await.expect("alice may drive");
    let mut events = arm.events();
    // The arm stands under the new fence, and the hub has measured both clocks, when one is taken.
    let error = |status: &Value| status.get("error").and_then(|error| error.get("name")).cloned();
    loop {
        arm.send("command", "wait 1").await.expect("it is sent");
        let first = heard(&mut events, "status").await;
        if error(&first).is_none() {
            break;
        }
    }
    while heard(&mut events, "status")
        .await
        .get("state")
        .and_then(Value::as_str)
        != Some("finished")
    {}
    arm.send("command", "wait 1200").await.expect("it is sent");
    arm.send("command", "move 10 0 300 0 0")
        .await
        .expect("it is sent");
    let refused = loop {
        let status = heard(&mut events, "status").await;
        if error(&status).is_some() {
            break status;
        }
    };
    assert_eq!(error(&refused), Some("too-old".into()), "{refused:?}");
}

/// The link between the arm's program and its controller fails in the middle of a move, and again later (M53): the
/// command ends with that error, and the next one is carried out when the link is back.
#[tokio::test]
async fn the_link_to_the_controller_fails_and_recovers() {
    let lab = RealArm::start(&["--link-fault", "5s/5s"]).await;
    let hub = &lab.hub;
    let carol = lab.join("carol").await;
    let mut events = carol
        .channel("/robot/arm")
        .await
        .expect("carol may look")
        .events();
    let run = |script: &str| {
        let file = tempfile::NamedTempFile::new().expect("a file");
        std::fs::write(file.path(), script).expect("it is written");
        let path = file.path().to_str().expect("a path in text").to_owned();
        run(
            "mom",
            &["run", &path],
            &[("MOM_HUB", hub), ("MOM_USER", "alice"), ("MOM_PASSWORD", "alice")],
        )
    };
    // 8 s of motion: the link cannot stand for as long.
    let failed = run("move 300 0 300 0 0; move -300 0 300 0 0; home");
    let said = text(&failed.stderr) + &text(&failed.stdout);
    assert_eq!(failed.status.code(), Some(1), "{said}");
    assert!(
        said.contains("the controller no longer answers") && said.contains("[link 5003]"),
        "{said}"
    );
    // The link is down now: the next command is refused, and sent again when it is back.
    let done = run("grip close");
    let said = text(&done.stderr) + &text(&done.stdout);
    assert_eq!(done.status.code(), Some(0), "{said}");
    assert!(said.contains("1 command done"), "{said}");
    let refused_for_now = async {
        loop {
            let status = heard(&mut events, "status").await;
            let Some(error) = status.get("error") else {
                continue;
            };
            let retry = error.get("retry").and_then(Value::as_bool) == Some(true);
            if retry && error.get("name").and_then(Value::as_str) == Some("link") {
                return;
            }
        }
    };
    timeout(PATIENCE, refused_for_now)
        .await
        .expect("it was refused first");
}
