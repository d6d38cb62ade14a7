//! `check` shows what a file makes, `explain` says who may what and by which rule, `schema` prints their shape.

use std::fs;

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
        first.ends_with("lab.toml: right; 2 managers, 6 contexts, 5 users"),
        "{first}"
    );
    let expected = "  /            session  lab
  ├─ camera    session  lab (of /)
  │  └─ x      channel  lab (of /)
  ├─ chat      channel  lab (of /)
  └─ robot     session  lab (of /)
     ├─ arm    channel  lab (of /); command needs /robot/token
     └─ token  token    robot-token; lease 180000 ms, lazy
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

    let wrong = run(program().arg("check").arg(&file).arg("--json"));
    assert_eq!(wrong.status.code(), Some(1));
    let said: Value = serde_json::from_slice(&wrong.stdout).expect("JSON");
    assert_eq!(said["right"], false);
    assert_eq!(said["errors"][0]["line"], 4);
    assert_eq!(said["errors"][0]["key"], "contexts[0].kind");
}

#[test]
fn check_warns_of_what_looks_like_a_mistake() {
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("mom.toml");
    fs::write(&file, CONTEXT.to_owned() + "[managers.spare]\nkind = \"open\"\n").expect("written");
    let warned = run(program().arg("check").arg(&file));
    let said = text(&warned.stdout);
    assert!(warned.status.success(), "a warning is no error: {warned:?}");
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
    let mut command = program();
    let asked = run(command.arg("explain").arg("--config").arg(lab()).args(arguments));
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
        "lab.toml:56, managers.robot-token.of[1]\n",
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
    assert!(takes.contains("  needs      membership of /robot\n"), "{takes}");
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
            "lookup info join members command * stop unstop",
        ),
        (
            "arm",
            "/robot/arm",
            "lookup info join members command state status *",
        ),
        (
            "carol",
            "/robot/arm",
            "lookup info join members invite expel command * stop unstop",
        ),
        ("bob", "/robot/token", "lookup info join members grab renew"),
        ("camera", "/robot", "lookup info join members list"),
        (
            "carol",
            "/robot",
            "lookup info join members invite expel list create",
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
            "no token",
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
