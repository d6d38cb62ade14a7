//! Recordings of real brokers, decided again.

use std::path::Path;
use std::process::{Command, Output};
use std::time::Duration;

use mom_broker::{Broker, Clock};
use mom_proto::{Family, Map, Parcel, Value, Verb};
use serde_json::{Value as Json, json};

use crate::lab::{Lab, Peer, RULES, at};

const RECORD: &str = "record = { path = \"control.jsonl\" }";

pub(crate) fn what_if(lab: &Lab, file: &str, more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mom-broker"))
        .current_dir(lab.folder())
        .args(["what-if", file, "--log", "control.jsonl"])
        .args(more)
        .output()
        .expect("the program runs")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

pub(crate) fn steps(lab: &Lab) -> Vec<Json> {
    let lines = lab.lines("control.jsonl");
    let steps = lines.iter().filter_map(|line| line.get("step").cloned());
    steps.collect()
}

/// Many things that a lab may see.
async fn a_day(lab: &Lab) {
    let (broker, clock) = lab.start().await;
    let mut alice = Peer::xml(&broker, "alice").await;
    let mut bob = Peer::binary(&broker, "bob").await;
    let mut carol = Peer::binary(&broker, "carol").await;
    for peer in [&mut alice, &mut bob, &mut carol] {
        for path in ["/chat", "/robot", "/robot/arm", "/robot/token"] {
            assert_eq!(peer.verb(Verb::Join, path).await, "ok");
        }
    }
    for _ in 0..5 {
        assert_eq!(alice.message("say", "/chat", "a-secret-of-alice").await, "ok");
        assert_eq!(bob.message("shout", "/chat", "BOB").await, "denied");
    }
    assert_eq!(alice.verb(Verb::Grab, "/robot/token").await, "ok");
    assert_eq!(alice.message("command", "/robot/arm", "up").await, "ok");
    assert_eq!(bob.message("command", "/robot/arm", "down").await, "not-owner");
    assert_eq!(bob.verb(Verb::Grab, "/robot/token").await, "denied");
    clock.advance(Duration::from_secs(100));
    // A number for the path, as binary peers use it.
    let mut by_number = Parcel::new(Family::Token, "info");
    by_number.number = carol
        .ask(Parcel::new(Family::Context, "info").context(at("/robot/token")))
        .await
        .value()
        .get("number")
        .and_then(Value::as_int)
        .and_then(|number| u64::try_from(number).ok())
        .map(mom_proto::ContextNumber);
    assert!(by_number.number.is_some());
    assert_eq!(carol.ask(by_number.clone()).await.name(), "ok");
    by_number.number = Some(mom_proto::ContextNumber(4711));
    assert_eq!(carol.ask(by_number).await.name(), "unknown-path");
    // Level beats lease, and who waits does so no longer than it said.
    assert_eq!(carol.verb(Verb::Grab, "/robot/token").await, "ok");
    let wait = Map::new().with("wait", 1000);
    let grab = Parcel::new(Family::Token, "grab")
        .context(at("/robot/token"))
        .content(wait);
    let waits = alice.say(grab).await;
    alice.event("queued").await;
    clock.advance(Duration::from_secs(2));
    assert_eq!(alice.answer_to(waits).await.name(), "timed-out");
    what_is_made(&mut carol, 2000, Some(&clock)).await;
    // A chair is asked and says yes.
    let opens = alice
        .say(Parcel::new(Family::Token, "grab").context(at("/robot/door")))
        .await;
    assert_eq!(carol.approve().await, "ok");
    assert_eq!(alice.answer_to(opens).await.name(), "ok");
    assert_eq!(carol.verb(Verb::Logout, "/").await, "ok");
    assert_eq!(alice.verb(Verb::Grab, "/robot/token").await, "ok");
    drop(alice);
    bob.event("released").await;
    broker.stop().await;
}

/// All kinds of values in what is asked for, and a lease that ends by itself.
async fn what_is_made(carol: &mut Peer, lease: i32, clock: Option<&Clock>) {
    let eager = Map::new()
        .with("kind", "level-or-lease")
        .with("lease", lease)
        .with("expiry", "eager");
    let make = Map::new().with("kind", "token").with("manager", eager);
    assert_eq!(carol.verb_with(Verb::Create, "/robot/key", make).await, "ok");
    let odd = Map::new()
        .with("kind", "channel")
        .with("x", Value::Double(0.1))
        .with("y", bytes::Bytes::from_static(b"\0\x01"))
        .with("z", mom_proto::Time::default());
    assert_eq!(
        carol.verb_with(Verb::Create, "/robot/odd", odd).await,
        "bad-content"
    );
    assert_eq!(carol.verb(Verb::Join, "/robot/key").await, "ok");
    assert_eq!(carol.verb(Verb::Grab, "/robot/key").await, "ok");
    if let Some(clock) = clock {
        clock.advance(Duration::from_secs(3));
    }
    carol.event("released").await;
}

#[tokio::test]
async fn the_same_configuration_decides_the_same() {
    let lab = Lab::new(RECORD);
    a_day(&lab).await;
    let steps = steps(&lab);
    assert!(steps.len() > 30, "{}", steps.len());
    let text_of_all = lab.read("control.jsonl");
    assert!(!text_of_all.contains("a-secret-of-alice"), "content of messages");
    let said = steps
        .iter()
        .filter(|step| step["input"]["request"]["name"] == "say")
        .count();
    assert_eq!(said, 1, "the others passed by the verdict that stands");
    let same = what_if(&lab, "lab.toml", &["--rules"]);
    assert_eq!(
        text(&same.stdout),
        format!(
            "{} inputs decided again by lab.toml: nothing differs\n",
            steps.len()
        )
    );
    assert_eq!((same.status.code(), text(&same.stderr)), (Some(0), String::new()));
}

/// Real time never comes out the same twice; what was recorded does.
#[tokio::test]
async fn time_that_goes_by_itself_is_replayed_too() {
    let lab = Lab::new(RECORD);
    let broker = Broker::start(lab.config()).await.expect("it starts");
    let mut carol = Peer::xml(&broker, "carol").await;
    for path in ["/robot", "/robot/arm"] {
        assert_eq!(carol.verb(Verb::Join, path).await, "ok");
    }
    what_is_made(&mut carol, 20, None).await;
    broker.stop().await;
    let same = what_if(&lab, "lab.toml", &["--rules"]);
    assert_eq!(same.status.code(), Some(0), "{same:?}");
}

#[tokio::test]
async fn another_lease_is_kept_by_the_new_clock() {
    let lab = Lab::new(RECORD);
    a_day(&lab).await;
    // Eager now, and so short that alice loses the robot 90 s into the 100 in which nothing came.
    let lease = "lease = 90000, expiry = \"eager\"";
    let changed = Lab::body(RULES).replace("lease = 180000", lease);
    assert!(changed.contains(lease));
    lab.write("new.toml", &changed);
    let differs = what_if(&lab, "new.toml", &["--json"]);
    assert_eq!(differs.status.code(), Some(2), "{differs:?}");
    let lines: Vec<Json> = text(&differs.stdout)
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    let lost = lines.iter().find(|line| line["what"] == "tick");
    assert_eq!(
        lost.map(|line| (&line["at"], &line["was"], &line["is"])),
        Some((
            &json!("2026-11-21T10:01:30.000000Z"),
            &json!([]),
            &json!([{"what": "lost", "context": "/robot/token", "owner": "alice", "reason": "expired"}]),
        )),
        "{lines:#?}"
    );
}

#[tokio::test]
async fn a_rule_less_is_three_decisions() {
    let lab = Lab::new(RECORD);
    let (broker, clock) = lab.start().await;
    let mut alice = Peer::xml(&broker, "alice").await;
    let mut bob = Peer::binary(&broker, "bob").await;
    for peer in [&mut alice, &mut bob] {
        for path in ["/robot", "/robot/arm"] {
            assert_eq!(peer.verb(Verb::Join, path).await, "ok");
        }
    }
    assert_eq!(bob.verb(Verb::Grab, "/robot/token").await, "denied");
    clock.advance(Duration::from_millis(1500));
    assert_eq!(alice.verb(Verb::Grab, "/robot/token").await, "ok");
    assert_eq!(alice.message("command", "/robot/arm", "up").await, "ok");
    assert_eq!(alice.message("command", "/robot/arm", "up").await, "ok");
    assert_eq!(bob.message("command", "/robot/arm", "down").await, "not-owner");
    assert_eq!(alice.verb(Verb::Release, "/robot/token").await, "ok");
    broker.stop().await;

    let (_, without) = RULES.split_once("\n\n").expect("a rule, and those after it");
    assert!(!without.contains("alice"));
    lab.write("new.toml", &Lab::body(without));
    let differs = what_if(&lab, "new.toml", &[]);
    assert_eq!(differs.status.code(), Some(2), "{differs:?}");
    let inputs = steps(&lab).len();
    let t = "2026-11-21T10:00:01.500000Z";
    assert_eq!(
        text(&differs.stdout),
        format!(
            "{t} alice: grab /robot/token: alice owns /robot/token by \"lab/alice drives\", ok lease 180000 ms \
             -> refused denied by \"lab\" (new.toml:4)\n\
             {t} alice: send command /robot/arm: passed to /robot/arm -> refused not-owner \
             by \"guard of /robot/arm\" (new.toml:45)\n\
             {t} alice: release /robot/token: alice loses /robot/token (released), ok -> refused not-owner \
             by \"one owner at most\"\n\
             {inputs} inputs decided again by new.toml: 3 decisions differ\n"
        )
    );
    let json = text(&what_if(&lab, "new.toml", &["--json"]).stdout);
    let lines: Vec<Json> = json
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    assert_eq!(lines.len(), 4);
    assert_eq!(
        lines[1],
        json!({
            "at": t, "line": lines[1]["line"], "what": "send", "peer": "alice", "user": "alice",
            "message": "command", "context": "/robot/arm",
            "was": [{"what": "passed", "context": "/robot/arm", "peer": "alice"}],
            "is": [{"what": "refused", "id": 5, "code": "not-owner", "rule": "guard of /robot/arm", "peer": "alice",
                "place": "new.toml:45"}],
        })
    );
    assert_eq!(lines[3], json!({"summary": {"inputs": inputs, "differ": 3}}));
}

/// Questions have other numbers where fewer are asked; the answers still go to the right ones.
#[tokio::test]
async fn a_chair_that_is_asked_less_says_the_same() {
    const BOB: &str = "[[managers.lab.rules]]\nname = \"bob opens\"\nusers = [\"bob\"]\nallow = [\"grab\"]\n";
    let lab = Lab::with(RECORD, &format!("{BOB}{RULES}"));
    let (broker, _clock) = lab.start().await;
    let mut alice = Peer::xml(&broker, "alice").await;
    let mut bob = Peer::binary(&broker, "bob").await;
    let mut carol = Peer::xml(&broker, "carol").await;
    for peer in [&mut alice, &mut bob, &mut carol] {
        assert_eq!(peer.verb(Verb::Join, "/robot").await, "ok");
    }
    for (peer, then) in [(&mut bob, Verb::Release), (&mut alice, Verb::Renew)] {
        let grab = Parcel::new(Family::Token, "grab").context(at("/robot/door"));
        let asked = peer.say(grab).await;
        assert_eq!(carol.approve().await, "ok");
        assert_eq!(peer.answer_to(asked).await.name(), "ok");
        assert_eq!(peer.verb(then, "/robot/door").await, "ok");
    }
    broker.stop().await;

    let same = what_if(&lab, "lab.toml", &["--rules"]);
    assert_eq!(same.status.code(), Some(0), "{same:?}");
    lab.write("new.toml", &Lab::body(RULES));
    let differs = what_if(&lab, "new.toml", &["--json"]);
    let lines: Vec<Json> = text(&differs.stdout)
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    let who: Vec<String> = lines
        .iter()
        .map(|line| format!("{} {}", line["peer"], line["what"]))
        .collect();
    assert_eq!(
        who[..who.len() - 1],
        ["\"bob\" \"grab\"", "\"carol\" \"verdict\"", "\"bob\" \"release\""],
        "{lines:#?}"
    );
    let code = |line: &Json| line["is"][0]["code"].clone();
    assert_eq!(
        lines[..3].iter().map(code).collect::<Vec<_>>(),
        ["denied", "too-late", "not-owner"]
    );
}

/// A recording goes on over a change of the configuration; the replay goes by one throughout.
#[tokio::test]
async fn a_change_of_the_configuration_is_told() {
    let lab = Lab::new("audit = { path = \"audit.jsonl\" }\nrecord = { path = \"control.jsonl\" }");
    let (broker, _clock) = lab.start().await;
    let mut alice = Peer::xml(&broker, "alice").await;
    assert_eq!(alice.verb(Verb::Join, "/robot").await, "ok");
    assert_eq!(alice.verb(Verb::Grab, "/robot/token").await, "ok");
    let (_, without) = RULES.split_once("\n\n").expect("a rule, and those after it");
    lab.write(
        "lab.toml",
        &format!("audit = {{ path = \"other.jsonl\" }}\n{}", Lab::body(without)),
    );
    let report = broker.reload(lab.config()).expect("right");
    assert_eq!(report.needs_restart, ["audit", "record"]);
    assert_eq!(alice.verb(Verb::Renew, "/robot/token").await, "denied");
    broker.stop().await;

    let audit = lab.lines("audit.jsonl");
    let configured = audit.iter().find(|line| line["what"] == "configured");
    let configured = configured.expect("it was told");
    assert_eq!(configured["config"], "lab.toml");
    assert_ne!(configured["sha256"], audit[0]["sha256"]);
    let told = json!({"configure": ["lab.toml", configured["sha256"]]});
    assert!(steps(&lab).iter().any(|step| step["input"] == told));
    let said = what_if(&lab, "lab.toml", &[]);
    assert_eq!(said.status.code(), Some(2), "the grab was before: {said:?}");
    assert!(
        text(&said.stderr).contains("was changed 1 time while"),
        "{said:?}"
    );
    let lines = text(&said.stdout);
    assert_eq!(lines.lines().count(), 2 + 1, "{lines}");
    assert!(
        lines.contains("configure: alice loses /robot/token (revoked) -> nothing"),
        "{lines}"
    );
}

#[tokio::test]
async fn what_is_damaged_is_told() {
    let lab = Lab::new(RECORD);
    let (broker, _clock) = lab.start().await;
    drop(Peer::xml(&broker, "alice").await);
    broker.stop().await;
    let whole = lab.read("control.jsonl");
    let middle = whole.replacen("\"login\"", "\"lo", 1);
    assert_ne!(whole, middle);
    let cut = &whole[..whole.len() - 5];
    let early = whole.replace("the broker stopped", "it has reached its size");
    for (recording, code, words) in [
        (cut, 0, "its last line is damaged"),
        (early.as_str(), 0, "ends early: it has reached its size"),
        (middle.as_str(), 1, "control.jsonl:2: this line is damaged"),
        ("hello\n", 1, "control.jsonl:1: this is not a recording"),
    ] {
        lab.write("control.jsonl", recording);
        let said = what_if(&lab, "lab.toml", &[]);
        assert_eq!(said.status.code(), Some(code), "{said:?}");
        assert!(text(&said.stderr).contains(words), "{said:?}");
    }
    lab.write("control.jsonl", &whole);
    let nobody = Lab::body(RULES).replace("users = \"users.toml\"\n", "");
    lab.write("new.toml", &nobody);
    let said = what_if(&lab, "new.toml", &[]);
    assert!(
        text(&said.stderr).contains("not among its users") && text(&said.stderr).contains("alice"),
        "{said:?}"
    );
    let wrong = what_if(&lab, "users.toml", &[]);
    assert_eq!(wrong.status.code(), Some(1), "{wrong:?}");
}

#[tokio::test]
async fn a_recording_ends_at_its_size_and_the_one_before_is_kept() {
    let lab = Lab::new("record = { path = \"control.jsonl\", size = 4096 }");
    lab.write("control.jsonl", "the one before\n");
    let (broker, _clock) = lab.start().await;
    let mut alice = Peer::xml(&broker, "alice").await;
    for _ in 0..50 {
        alice.verb(Verb::Info, "/robot").await;
    }
    broker.stop().await;
    assert_eq!(lab.read("control.jsonl.1"), "the one before\n");
    let lines = lab.lines("control.jsonl");
    assert_eq!(lines.last(), Some(&json!({"end": "it has reached its size"})));
    assert!(lab.read("control.jsonl").len() < 4200);
    let mode = std::os::unix::fs::PermissionsExt::mode(
        &std::fs::metadata(Path::new(&lab.path("control.jsonl")))
            .expect("a file")
            .permissions(),
    );
    assert_eq!(mode & 0o777, 0o600);
    let said = what_if(&lab, "lab.toml", &[]);
    assert_eq!(said.status.code(), Some(0), "{said:?}");
}

/// Zones may be tried on a day on which nobody knew of them (M40).
#[tokio::test]
async fn zones_would_have_kept_two_apart() {
    const ZONES: &str = r#"
[[managers.lab.rules]]
name = "both use the table"
users = ["alice", "bob"]
allow = ["grab"]

[managers.place]
kind = "chain"
of = ["lab", "first-come"]

[[contexts]]
path = "/zone"
kind = "session"

[[contexts]]
path = "/zone/left"
kind = "token"
manager = "place"

[[contexts]]
path = "/zone/right"
kind = "token"
manager = "place"
"#;
    const BOXES: &str = r#"
[managers.boxes]
kind = "zones"
zones = [
  { token = "/zone/left", from = [-300, 0, 0], to = [20, 1, 1] },
  { token = "/zone/right", from = [-20, 0, 0], to = [300, 1, 1] },
]
"#;
    let rules = format!("{RULES}{ZONES}");
    let lab = Lab::with(RECORD, &rules);
    let (broker, _clock) = lab.start().await;
    let mut alice = Peer::xml(&broker, "alice").await;
    let mut bob = Peer::binary(&broker, "bob").await;
    for (peer, zone) in [(&mut alice, "/zone/left"), (&mut bob, "/zone/right")] {
        assert_eq!(peer.verb(Verb::Join, "/zone").await, "ok");
        assert_eq!(peer.verb(Verb::Grab, zone).await, "ok");
    }
    broker.stop().await;
    let chain = "of = [\"lab\", \"first-come\"]";
    let changed = Lab::body(&rules).replace(chain, "of = [\"lab\", \"first-come\", \"boxes\"]");
    lab.write("new.toml", &format!("{changed}{BOXES}"));
    let differs = what_if(&lab, "new.toml", &[]);
    assert_eq!(differs.status.code(), Some(2), "{differs:?}");
    let said = text(&differs.stdout);
    let refused = "bob: grab /zone/right: bob owns /zone/right by \"lab/both use the table\", ok \
                   -> refused held by \"boxes\" (new.toml:";
    assert!(said.contains(refused), "{said}");
    assert!(!said.contains("alice"), "{said}");
}
