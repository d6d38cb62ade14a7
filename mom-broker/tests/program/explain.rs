//! `check` shows what a file makes, `explain` says who may what and by which rule, `schema` prints their shape.

use std::fs;
use std::path::Path;

use serde_json::Value;
use tempfile::TempDir;

use super::{CONTEXT, lab, program, run, text};

#[test]
fn check_says_whether_a_file_is_right() {
    let right = run(program().arg("check").arg(lab()));
    let said = text(&right.stdout);
    assert!(right.status.success(), "{right:?}");
    let (first, tree) = said.split_once('\n').expect("lines");
    assert!(
        first.ends_with("lab.toml: right; 3 managers, 19 contexts, 13 users"),
        "{first}"
    );
    let expected = "  /                session  lab
  ├─ calibrate     channel  lab (of /)
  ├─ camera        session  lab (of /)
  │  ├─ pan        channel  lab (of /); command needs /camera/pan-token; device: camera
  │  ├─ pan-token  token    robot-token; lease 180000 ms, lazy
  │  ├─ top        channel  lab (of /); device: camera
  │  ├─ wrist      channel  lab (of /); device: camera
  │  ├─ x          channel  lab (of /); device: camera
  │  └─ y          channel  lab (of /); device: camera
  ├─ chat          channel  lab (of /)
  ├─ log           channel  log
  ├─ model         session  lab (of /)
  │  ├─ blue       token    robot-token; lease 180000 ms, lazy
  │  ├─ green      token    robot-token; lease 180000 ms, lazy
  │  ├─ objects    channel  lab (of /)
  │  └─ red        token    robot-token; lease 180000 ms, lazy
  ├─ robot         session  lab (of /)
  │  ├─ arm        channel  lab (of /); command needs /robot/token; device: arm
  │  └─ token      token    robot-token; lease 180000 ms, lazy
  └─ servo         channel  lab (of /)
";
    assert_eq!(tree, expected);

    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("mom.toml");
    fs::write(&file, CONTEXT.replace("channel", "chanel")).expect("written");
    let wrong = run(program().arg("check").arg(&file));
    assert_eq!(wrong.status.code(), Some(1));
    let said = text(&wrong.stderr);
    assert!(
        said.contains(&format!("{}:4: contexts[0].kind: ", file.display())),
        "{said}"
    );
    assert!(said.contains("channel"), "the nearest kind: {said}");
    assert!(wrong.stdout.is_empty());

    let tls = "[tls]\ncertificate = \"hub.crt\"\nkey = \"hub.key\"\n";
    let hub = folder.path().join("hub.toml");
    for (text, line, why) in [
        (tls.to_owned(), 2, "hub.crt: it cannot be read"),
        (tls.replace("key =", "# key ="), 1, "both certificate and key"),
    ] {
        fs::write(&hub, text).expect("written");
        let wrong = run(program().arg("check").arg(&hub));
        let said = super::text(&wrong.stderr);
        assert_eq!(wrong.status.code(), Some(1), "{said}");
        assert!(said.contains(&format!("hub.toml:{line}: tls")), "{said}");
        assert!(said.contains(why), "{said}");
    }

    let wrong = run(program().arg("check").arg(&file).arg("--json"));
    assert_eq!(wrong.status.code(), Some(1));
    let said: Value = serde_json::from_slice(&wrong.stdout).expect("JSON");
    assert_eq!(said["right"], false);
    assert_eq!(said["errors"][0]["line"], 4);
    assert_eq!(said["errors"][0]["key"], "contexts[0].kind");
}

#[test]
fn check_shows_who_may_be_a_device() {
    let right = run(program().arg("check").arg(lab()).arg("--json"));
    let said: Value = serde_json::from_slice(&right.stdout).expect("JSON");
    let contexts = said["contexts"].as_array().expect("a list").iter();
    let arm = contexts.filter(|context| context["path"] == "/robot/arm");
    let devices: Vec<&Value> = arm.map(|arm| &arm["devices"]).collect();
    assert_eq!(devices, [&serde_json::json!(["arm"])]);

    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("mom.toml");
    let open = format!("root = \"open\"\n{CONTEXT}[login]\nguests = true\n");
    fs::write(&file, open).expect("written");
    let open = run(program().arg("check").arg(&file));
    assert!(text(&open.stdout).contains("; device: anybody"), "{open:?}");
}

#[test]
fn check_warns_of_what_looks_like_a_mistake() {
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("mom.toml");
    fs::write(&file, CONTEXT.to_owned() + "[managers.spare]\nkind = \"open\"\n").expect("written");
    let warned = run(program().arg("check").arg(&file));
    let said = text(&warned.stdout);
    assert!(warned.status.success(), "a warning is not an error: {warned:?}");
    let warning = format!(
        "warning: {}:5: managers.spare: nothing in this file uses it",
        file.display()
    );
    assert!(said.contains(&warning), "{said}");
    let warned = run(program().arg("check").arg(&file).arg("--json"));
    let said: Value = serde_json::from_slice(&warned.stdout).expect("JSON");
    assert_eq!(said["right"], true);
    assert_eq!(said["warnings"][0]["key"], "managers.spare");
    assert_eq!(said["contexts"][1]["managed-at"], "/");
}

fn explain(arguments: &[&str]) -> Result<String, String> {
    explain_of(&lab(), arguments)
}

fn explain_of(file: &Path, arguments: &[&str]) -> Result<String, String> {
    let mut command = program();
    let asked = run(command.arg("explain").arg("--config").arg(file).args(arguments));
    match asked.status.success() {
        true => Ok(text(&asked.stdout)),
        false => Err(text(&asked.stderr)),
    }
}

#[test]
fn explain_says_why_not() {
    let held = explain(&[
        "--user",
        "alice",
        "--verb",
        "grab",
        "--context",
        "/robot/token",
        "--owner",
        "bob",
    ]);
    let held = held.expect("explained");
    for words in [
        "alice (level 1) may not grab /robot/token while bob owns it.\n",
        "held (101): /robot/token is held by bob at level 1, yours is 1; the lease ends in 180 s unless bob renews it\n",
        "retry-after=180000 place=1",
        "owner=bob owner-level=1",
        "  rule       robot-token/level-or-lease\n",
        "lab.toml:101, managers.robot-token.of[1]\n",
    ] {
        assert!(held.contains(words), "{words:?} in {held}");
    }
    let uncovered = explain(&["--user", "bob", "--verb", "break", "--context", "/robot/token"]);
    let uncovered = uncovered.expect("explained");
    assert!(
        uncovered.contains("  rule       none of lab covers it\n"),
        "{uncovered}"
    );
    let stays = explain(&["--user", "carol", "--verb", "delete", "--context", "/chat"]).expect("explained");
    assert!(
        stays.contains("permanent (") && stays.contains("the hub itself"),
        "{stays}"
    );
}

#[test]
fn explain_says_why() {
    let takes = explain(&[
        "--user",
        "carol",
        "--verb",
        "grab",
        "--context",
        "/robot/token",
        "--owner",
        "bob",
    ]);
    let takes = takes.expect("explained");
    assert!(
        takes.starts_with("carol (level 5, operator) may grab /robot/token while bob owns it.\n"),
        "{takes}"
    );
    for words in [
        "  rule       lab/operators may all\n",
        "lab.toml:78, managers.lab.rules[11]\n",
        "  takes it   from bob\n",
        "  needs      membership of /robot\n",
    ] {
        assert!(takes.contains(words), "{words:?} in {takes}");
    }
    let other = explain(&[
        "--user",
        "zoe",
        "--level",
        "9",
        "--verb",
        "list",
        "--context",
        "/",
        "--json",
    ]);
    let other: Value = serde_json::from_str(&other.expect("explained")).expect("JSON");
    assert_eq!((&other["answer"], &other["level"]), (&"allow".into(), &9.into()));
    assert_eq!(other["managed-at"], "/");
}

/// The answers of the table, without rules and places.
fn answers(user: &str, context: &str) -> Vec<(String, String)> {
    let said = explain(&["--user", user, "--context", context, "--json"]).expect("explained");
    let said: Vec<Value> = serde_json::from_str(&said).expect("JSON");
    let row = |one: &Value| {
        let what = one["message"]
            .as_str()
            .or(one["verb"].as_str())
            .unwrap_or_default();
        (
            what.to_owned(),
            one["answer"].as_str().unwrap_or_default().to_owned(),
        )
    };
    said.iter().map(row).collect()
}

#[test]
fn explain_shows_all_that_can_be_asked() {
    for (user, context, allowed) in [
        (
            "alice",
            "/robot/arm",
            "lookup info join members stats command * stop unstop",
        ),
        (
            "arm",
            "/robot/arm",
            "lookup info join members stats command state status *",
        ),
        (
            "carol",
            "/robot/arm",
            "lookup info join members stats audit explain invite expel command * stop unstop",
        ),
        (
            "bob",
            "/robot/token",
            "lookup info join members stats grab renew give accept request",
        ),
        ("camera", "/robot", "lookup info join members stats list"),
        (
            "carol",
            "/robot",
            "lookup info join members stats audit explain invite expel list create",
        ),
        ("carol", "/new", "create"),
    ] {
        let answers = answers(user, context);
        let yes = answers.iter().filter(|(_, answer)| answer == "allow");
        let yes: Vec<&str> = yes.map(|(what, _)| what.as_str()).collect();
        assert_eq!(yes.join(" "), allowed, "{user} at {context}");
    }
    let table = explain(&["--user", "alice", "--context", "/robot/arm"]).expect("explained");
    let first = "alice (level 1) at /robot/arm (channel; managed by lab of /)\n";
    assert!(table.starts_with(first), "{table}");
    let line = |what: &str| {
        let found = table.lines().find(|line| line.trim_start().starts_with(what));
        found.unwrap_or_else(|| panic!("{what} in {table}")).to_owned()
    };
    let state = line("send state ");
    assert!(
        state.contains("  no ")
            && state.contains("lab/only the arm tells its state")
            && state.contains("lab.toml:20"),
        "{state}"
    );
    assert!(
        line("send command ").contains("yes, with ownership of /robot/token"),
        "{table}"
    );
    assert!(line("expel ").contains("lab (no rule)"), "{table}");
}

/// A club with a timetable, a chair, a line and a limit.
const CLUB: &str = r#"users = "users.toml"
root = "club"

[managers.club]
kind = "roles"
[[managers.club.rules]]
name = "guests by invitation"
invited = true
allow = ["join"]
[[managers.club.rules]]
name = "staff may all"
groups = ["operator", "device"]
allow = ["*"]
[[managers.club.rules]]
name = "people take part"
min-level = 1
allow = ["lookup", "info", "join", "grab", "renew", "request", "send"]

[managers.robot]
kind = "chain"
of = ["club", "timetable", "chair", "fair"]

[managers.timetable]
kind = "schedule"
slots = [
    { name = "course", from = "09:00", to = "12:00", groups = ["operator"] },
    { from = "22:00", to = "02:00", users = ["alice"] },
]

[managers.chair]
kind = "moderated"
chairs = { groups = ["operator"] }
verbs = ["request", "give"]
within = 60000

[managers.fair]
kind = "queue"
lease = 60000
hold = 300000

[managers.polite]
kind = "chain"
of = ["club", { kind = "quota", limits = [{ parcels = 10, burst = 20, bytes = 1000000 }] }]

[[contexts]]
path = "/robot"
kind = "session"

[[contexts]]
path = "/robot/token"
kind = "token"
manager = "robot"

[[contexts]]
path = "/chat"
kind = "channel"
manager = "polite"
"#;

/// Asks about the club; each answer has to hold all of the words.
fn check_club(asked: &str, more: &[&str], words: &[&str]) {
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("mom.toml");
    fs::write(&file, CLUB).expect("written");
    let users = lab().with_file_name("lab-users.toml");
    fs::copy(users, folder.path().join("users.toml")).expect("copied");
    let asked: Vec<&str> = asked.split(' ').chain(more.iter().copied()).collect();
    let said = explain_of(&file, &asked).expect("explained");
    for words in words {
        assert!(said.contains(words), "{words:?} in {said}");
    }
}

#[test]
fn explain_knows_times_lines_and_chairs() {
    let grab = "--user alice --verb grab --context /robot/token";
    check_club(
        grab,
        &["--at", "2026-11-23T10:00:00Z"],
        &[
            "may not grab",
            "until 2026-11-23T12:00:00Z",
            "rule       timetable/course",
            "managers.timetable.slots[0]",
        ],
    );
    check_club(
        grab,
        &["--at", "2026-11-23T23:00:00Z"],
        &[
            "may grab",
            "until      2026-11-24T02:00:00.000000Z, whatever the lease",
        ],
    );
    check_club(
        grab,
        &["--at", "2026-11-23T13:00:00Z", "--owner", "bob"],
        &["has to wait to grab", "place=1 expected=60000", "rule       fair"],
    );
    check_club(
        "--user alice --verb request --context /robot/token",
        &["--at", "2026-11-23T13:00:00Z"],
        &[
            "if those who are asked allow it",
            "above it: carol; within 60 s",
            "rule       chair",
        ],
    );
}

#[test]
fn explain_knows_limits_and_invitations() {
    check_club(
        "--user alice --verb send --context /chat",
        &[],
        &[
            "at most 10 parcels per second and 20 at once",
            "rule       club/people take part",
        ],
    );
    let join = "--user eve --level 0 --verb join --context /chat";
    check_club(join, &[], &["may not join", "none of club covers it"]);
    check_club(
        join,
        &["--invited"],
        &["may join", "club/guests by invitation", "managers.club.rules[0]"],
    );
}

#[test]
fn explain_refuses_what_cannot_be_asked() {
    for (arguments, words) in [
        (&["--user", "alise", "--context", "/"][..], "did you mean alice?"),
        (&["--user", "alice", "--context", "robot"], "slash"),
        (
            &["--user", "alice", "--context", "/", "--verb", "grib"],
            "did you mean grab?",
        ),
        (
            &["--user", "alice", "--context", "/", "--verb", "ping"],
            "no manager is asked",
        ),
        (
            &["--user", "alice", "--context", "/chat", "--owner", "bob"],
            "not a token",
        ),
        (
            &["--user", "alice", "--context", "/chat", "--message", "x"],
            "--verb send",
        ),
        (
            &[
                "--user",
                "alice",
                "--context",
                "/chat",
                "--verb",
                "stop",
                "--message",
                "x",
            ],
            "leave the name out",
        ),
    ] {
        let refused = explain(arguments).expect_err("refused");
        assert!(refused.contains(words), "{words:?} in {refused}");
    }
}

#[test]
fn schema_prints_what_is_shipped() {
    for (arguments, file) in [
        (&["schema"][..], "mom.schema.json"),
        (&["schema", "--users"], "users.schema.json"),
    ] {
        let printed = run(program().args(arguments));
        let shipped = fs::read_to_string(lab().with_file_name(file)).expect("readable");
        assert_eq!(text(&printed.stdout), shipped, "{file}");
    }
}

/// What the documentation shows is what is printed.
#[test]
fn the_examples_in_the_documentation_are_real() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let page = fs::read_to_string(root.join("docs/configuration.md")).expect("readable");
    let examples: Vec<&str> = page.split("```console\n$ mom-broker ").skip(1).collect();
    assert!(examples.len() > 3);
    for example in examples {
        let (arguments, rest) = example.split_once('\n').expect("a line");
        let (expected, _) = rest.split_once("```").expect("an end");
        let shown = run(program().args(arguments.split(' ')).current_dir(&root));
        assert_eq!(
            text(&shown.stdout),
            expected,
            "docs/configuration.md: mom-broker {arguments}"
        );
    }
}
