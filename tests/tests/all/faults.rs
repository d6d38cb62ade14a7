//! A wrong configuration is told whole, in words, by `check`, at the start and at a reload alike.

use std::fs;
use std::path::Path;
use std::process::Output;

use mom_tests::programs::{PATIENCE, Running, program, run, text};
use tempfile::TempDir;

/// Eight lines that are wrong, each in its own way, with the words that tell it.
const FAULTS: [(&str, &str); 8] = [
    (
        "listen = [\"127.0.0.1:99999\"]",
        "listen[0]: a port is a whole number from 0 to 65535",
    ),
    (
        "conections = 50",
        "conections: there is no key `conections`; did you mean `connections`?",
    ),
    ("users = \"nobody.toml\"", "users: "),
    (
        "outbox = \"4 MB\"",
        "limits.outbox: must be a whole number above 0, not \"4 MB\"",
    ),
    (
        "allow = [\"jion\"]",
        "managers.lab.rules[0].allow[0]: \"jion\" is not known here; did you mean `join`?",
    ),
    (
        "safe = { channel = \"/arm\", name = \"stop\" }",
        "contexts[0].safe.name: safe cannot be stop or unstop",
    ),
    (
        "manager = \"lba\"",
        "contexts[1].manager: there is no manager \"lba\"",
    ),
    (
        "guard = { token = \"/tokn\", names = [\"command\"] }",
        "contexts[1].guard.token: there is no token /tokn",
    ),
];

/// A file with these lines among right ones.
fn config(faults: &[(&str, &str)]) -> String {
    let line = |index: usize| faults.get(index).map_or("", |(line, _)| line);
    format!(
        "{}\n{}\n{}\n[limits]\n{}\n[managers.lab]\nkind = \"roles\"\n[[managers.lab.rules]]\nname = \"all\"\n{}\n\
         [[contexts]]\npath = \"/token\"\nkind = \"token\"\n{}\n[[contexts]]\npath = \"/arm\"\nkind = \"channel\"\n{}\n{}\n",
        line(0),
        line(1),
        line(2),
        line(3),
        line(4),
        line(5),
        line(6),
        line(7)
    )
}

/// Each fault is told once, at its line.
fn check_told(told: &str, file: &Path) {
    let text = fs::read_to_string(file).expect("readable");
    for (wrong, words) in FAULTS {
        let line = text.lines().position(|line| line == wrong).expect("it is there") + 1;
        let place = format!("{}:{line}: {words}", file.display());
        assert_eq!(
            told.matches(&place).count(),
            1,
            "{place}\nis told once in\n{told}"
        );
    }
    for jargon in ["usize", "u64", "expected", "invalid type", "unknown field"] {
        assert!(!told.contains(jargon), "{jargon} in {told}");
    }
}

fn run_in(folder: &Path, args: &[&str]) -> Output {
    let state = folder.display().to_string();
    run("mom-broker", args, &[("XDG_STATE_HOME", &state)])
}

#[test]
fn check_tells_eight_different_faults_and_so_does_the_start() {
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("mom.toml");
    fs::write(&file, config(&FAULTS)).expect("written");
    let name = file.to_str().expect("text");
    for args in [&["check", name][..], &["--config", name]] {
        let output = run_in(folder.path(), args);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains("8 faults:"), "{said}");
        check_told(&said, &file);
    }
    let output = run_in(folder.path(), &["check", "--json", name]);
    assert_eq!(output.status.code(), Some(1));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let lines: Vec<String> = report["errors"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|error| {
            let part = |key: &str| error[key].as_str().expect("text").to_owned();
            format!(
                "{}:{}: {}: {}",
                part("file"),
                error["line"],
                part("key"),
                part("text")
            )
        })
        .collect();
    assert_eq!(
        (report["right"].as_bool(), lines.len()),
        (Some(false), 8),
        "{report}"
    );
    check_told(&lines.join("\n"), &file);
}

/// A running broker logs the same list, a line for each fault, and goes by the old file.
#[test]
fn a_reload_tells_them_too() {
    let folder = TempDir::new().expect("a folder");
    let (file, log) = (folder.path().join("mom.toml"), folder.path().join("log"));
    fs::write(&file, "reload = \"signal\"\n").expect("written");
    let name = file.to_str().expect("text");
    let args = ["--config", name, "--listen", "127.0.0.1:0"];
    let kept = fs::File::create(&log).expect("a file");
    let broker = Running::start_with("mom-broker", &args, &[("NO_COLOR", "1")], kept.into());
    broker.line_with("listening");
    fs::write(&file, config(&FAULTS)).expect("written");
    broker.signal("HUP");
    let said = std::iter::repeat_with(|| fs::read_to_string(&log).expect("readable"));
    let begun = std::time::Instant::now();
    let mut said = said.inspect(|_| assert!(begun.elapsed() < PATIENCE, "it says so in time"));
    let said = said
        .find(|said| said.matches("stays as it was").count() >= 8)
        .expect("it says so");
    check_told(&said, &file);
    broker.signal("TERM");
    assert!(broker.wait().success());
}

#[test]
fn a_wrong_address_on_the_command_line_is_told_as_that() {
    let output = std::process::Command::new(program("mom-broker"))
        .args(["--listen", "127.0.0.1:70000"])
        .output();
    let output = output.expect("it runs");
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(
        said.contains("a port is a whole number from 0 to 65535"),
        "{said}"
    );
}
