//! A gateway follows its fleet's file while its robots drive (W12, W14).

use std::fs::File;
use std::process::Stdio;
use std::thread::JoinHandle;
use std::time::Instant;

use mom_tests::programs::{PATIENCE, Running, project, run, text};
use serde_json::Value as Json;

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
fn logged(log: &std::path::Path, words: &str) -> String {
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
fn tables(file: &str) -> Vec<String> {
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
