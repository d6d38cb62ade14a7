//! The base station as people start it, against robots that were written in another language (`robot.py`), over real sockets.

#[path = "../../../fleet/base-station/tests/all/robot.rs"]
#[allow(dead_code, reason = "the tests of the library ask more of it")]
mod robot;

use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use serde_json::Value as Json;
use tempfile::TempDir;

use crate::robot::{Robot, fleet};

/// The program, as its link starts it.
fn started_as_link() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mom-device"));
    command.arg0("mom-base-station");
    command
}

/// The program with a fleet of these robots, and a folder for its files.
fn program(ports: &[u16]) -> (Command, TempDir) {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("fleet.toml");
    std::fs::write(&file, fleet(ports)).expect("a file");
    let mut command = started_as_link();
    command.arg("--fleet").arg(file).env_remove("MOM_FLEET");
    (command, folder)
}

async fn run(mut command: Command) -> Output {
    let run = tokio::task::spawn_blocking(move || command.output());
    run.await.expect("no panic").expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[tokio::test]
async fn send_tells_what_it_sent_and_stops_the_robot_at_the_end() {
    let mut robot = Robot::start().await;
    let (mut command, folder) = program(&[robot.port]);
    let log = folder.path().join("log.jsonl");
    command.arg("--log").arg(&log);
    command.args([
        "send", "1", "motor", "50", "-50", "--repeat", "10ms", "--times", "3",
    ]);
    let output = run(command).await;
    assert!(output.status.success(), "{output:?}");
    assert_eq!(
        text(&output.stdout)
            .matches("unit 1 -> 06 00050 -0050  motor left=50 right=-50")
            .count(),
        3
    );
    for expected in [
        "06 00050 -0050",
        "06 00050 -0050",
        "06 00050 -0050",
        "06 00000 00000",
    ] {
        assert_eq!(robot.command().await, expected);
    }
    robot.until("closed").await;
    let wires = |kind: &str| wires(&log, kind);
    // The second answer tells that the stop was read.
    assert_eq!(wires("in"), ["00", "00"]);
    assert_eq!(
        wires("out"),
        [
            "00",
            "06 00050 -0050",
            "06 00050 -0050",
            "06 00050 -0050",
            "06 00000 00000",
            "00"
        ]
    );
}

/// Whatever ends the program, its terminal too, stops the robot.
#[tokio::test]
async fn a_robot_that_send_has_set_in_motion_drives_until_ctrl_c() {
    // What tests start ignores SIGHUP where they were started by `nohup`.
    let status = std::fs::read_to_string("/proc/self/status").expect("the system tells");
    let ignored = status
        .lines()
        .find_map(|line| line.strip_prefix("SigIgn:")?.trim().chars().last());
    let ignores_hangup = ignored
        .and_then(|digit| digit.to_digit(16))
        .is_some_and(|digit| digit & 1 == 1);
    for signal in ["-INT", "-HUP", "-QUIT"]
        .into_iter()
        .filter(|signal| *signal != "-HUP" || !ignores_hangup)
    {
        let mut robot = Robot::start().await;
        let (mut command, _folder) = program(&[robot.port]);
        command.args(["send", "1", "motor", "100", "100"]);
        let mut child = command
            .stderr(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()
            .expect("it starts");
        assert_eq!(robot.command().await, "06 00100 00100");
        // It says so, and what it says is the last before it is interrupted.
        let stderr = child.stderr.take().expect("it is piped");
        let mut lines = BufReader::new(stderr).lines();
        let said = tokio::task::spawn_blocking(move || {
            lines.find_map(|line| line.ok().filter(|line| line.contains("Ctrl-C")))
        });
        let said = said.await.expect("no panic").expect("a line");
        assert!(said.contains("unit 1 drives until Ctrl-C; --stay 5s"), "{said}");
        // A robot with a watchdog needs more than one frame.
        for _ in 0..3 {
            robot.until("got 00").await;
        }
        let kill = Command::new("kill")
            .args([signal, &child.id().to_string()])
            .status();
        assert!(kill.expect("kill is there").success());
        assert_eq!(robot.command().await, "06 00000 00000", "{signal}");
        let ended = tokio::task::spawn_blocking(move || child.wait())
            .await
            .expect("no panic");
        assert!(ended.expect("it ends").success());
    }
}

/// Whether a program waits for a reader of what it writes.
fn is_blocked(id: u32) -> bool {
    let tasks = std::fs::read_dir(format!("/proc/{id}/task")).expect("it runs");
    tasks.flatten().any(|task| {
        std::fs::read_to_string(task.path().join("wchan")).is_ok_and(|place| place.contains("pipe_write"))
    })
}

/// Its log goes to a pipe that nobody empties; its statements come all the same.
#[tokio::test]
async fn what_is_typed_is_carried_out_though_the_output_is_not_read() {
    let mut robot = Robot::start().await;
    let (mut command, _folder) = program(&[robot.port]);
    let mut child = command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("it starts");
    let mut stdin = child.stdin.take().expect("it is piped");
    robot.until("got 00").await;
    while !is_blocked(child.id()) {
        writeln!(stdin, "1 status").expect("it reads");
        robot.line().await;
    }
    writeln!(stdin, "1 motor 5 5").expect("it reads");
    while robot.command().await != "06 00005 00005" {}
    writeln!(stdin, "1 motor 0 0").expect("it reads");
    while robot.command().await != "06 00000 00000" {}
    child.kill().expect("it runs");
    child.wait().expect("it ends");
}

/// Who reads its output slowly, or not at all, must not keep it from stopping its robots.
#[tokio::test]
async fn a_station_whose_output_is_not_read_stops_its_robots_and_ends() {
    let mut robot = Robot::start().await;
    let (mut command, _folder) = program(&[robot.port]);
    command.args(["send", "--repeat", "1ms", "1", "motor", "100", "100"]);
    let mut child = command
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("it starts");
    assert_eq!(robot.command().await, "06 00100 00100");
    while !is_blocked(child.id()) {
        robot.line().await;
    }
    let kill = Command::new("kill").arg(child.id().to_string()).status();
    assert!(kill.expect("kill is there").success());
    while robot.command().await != "06 00000 00000" {}
    let ended = tokio::task::spawn_blocking(move || child.wait()).await;
    assert_eq!(ended.expect("no panic").expect("it ends").code(), Some(1));
}

/// The frames of one direction in a log.
fn wires(log: &Path, kind: &str) -> Vec<String> {
    let text = std::fs::read_to_string(log).expect("a log");
    let entries = text
        .lines()
        .map(|line| serde_json::from_str(line).expect("a line of JSON"));
    let of_kind = entries.filter(|entry: &Json| entry["kind"] == kind);
    of_kind
        .filter_map(|entry| Some(entry["wire"].as_str()?.to_owned()))
        .collect()
}

#[tokio::test]
async fn send_waits_for_the_reply() {
    let robot = Robot::start().await;
    let (mut command, _folder) = program(&[robot.port]);
    command.args(["send", "1", "status"]);
    let output = run(command).await;
    assert!(output.status.success(), "{output:?}");
    let stdout = text(&output.stdout);
    assert!(stdout.contains("unit 1 <- 04 00037  status bits=37"), "{stdout}");
}

#[tokio::test]
async fn run_carries_out_a_script_and_names_who_is_missing() {
    let (mut robot, gone) = (Robot::start().await, Robot::start().await);
    let (mut command, folder) = program(&[robot.port, gone.port]);
    drop(gone);
    let script = folder.path().join("script.txt");
    std::fs::write(
        &script,
        "repeat 2; all leds 3; end\n1 status; on 1 reply status\n1 leds 0",
    )
    .unwrap();
    command.args(["--timeout", "500ms", "run"]).arg(script);
    let output = run(command).await;
    for expected in ["07 00003", "07 00003", "04", "07 00000"] {
        assert_eq!(robot.command().await, expected);
    }
    let stderr = text(&output.stderr);
    assert!(
        stderr.contains("unit 2 is trying: cannot connect: Connection refused"),
        "{stderr}"
    );
    assert!(
        stderr.contains("unit 2: it is trying, so it takes no commands"),
        "{stderr}"
    );
    assert!(!output.status.success());
}

#[tokio::test]
async fn list_tells_states_round_trips_and_status_bits() {
    let (robot, gone) = (Robot::start().await, Robot::start().await);
    let (mut command, _folder) = program(&[robot.port, gone.port]);
    drop(gone);
    command.args(["--timeout", "500ms", "list"]);
    let output = run(command).await;
    let stdout = text(&output.stdout);
    let lines: Vec<Vec<&str>> = stdout
        .lines()
        .map(|line| line.split_whitespace().collect())
        .collect();
    let address = format!("127.0.0.1:{}", robot.port);
    assert!(
        matches!(&lines[1][..], ["1", at, "writable", _, "ms", "37"] if *at == address),
        "{stdout}"
    );
    assert!(
        matches!(&lines[2][..], ["2", _, "trying", "cannot", "connect:", ..]),
        "{stdout}"
    );
}

#[tokio::test]
async fn without_a_terminal_it_takes_statements_as_lines_and_terminated_within_one_it_stops_the_robot() {
    let mut robot = Robot::start().await;
    let (mut command, _folder) = program(&[robot.port]);
    let piped = command.stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut child = piped.spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap())
        .lines()
        .map_while(Result::ok);
    assert!(lines.any(|line| line.ends_with("unit 1 is writable")));
    writeln!(stdin, "repeat 100000; 1 motor 9 9; wait 1; end").unwrap();
    assert_eq!(robot.command().await, "06 00009 00009");
    let killed = Command::new("kill").arg(child.id().to_string()).status().unwrap();
    assert!(killed.success());
    let mut last = Vec::new();
    loop {
        match robot.line().await {
            line if line == "closed" => break,
            line => last.push(line),
        }
    }
    // The NULL behind the stop tells that it was read.
    assert!(
        last.ends_with(&["got 06 00000 00000".to_owned(), "got 00".to_owned()]),
        "{last:?}"
    );
    assert!(child.wait().unwrap().success());
}

#[tokio::test]
async fn with_a_fault_in_a_file_or_a_statement_nothing_is_started() {
    let mut robot = Robot::start().await;
    let (mut command, _folder) = program(&[robot.port]);
    command.args(["send", "1", "moter", "1", "1"]);
    let output = run(command).await;
    let stderr = text(&output.stderr);
    assert!(
        stderr.contains("line 1, column 3: there is no command `moter`; did you mean `motor`?"),
        "{stderr}"
    );
    assert!(!output.status.success());

    let (mut command, folder) = program(&[robot.port, robot.port]);
    command.arg("list");
    let output = run(command).await;
    let stderr = text(&output.stderr);
    let file = folder.path().join("fleet.toml");
    let (file, port) = (file.display(), robot.port);
    let fault = format!("line 6, column 11: 127.0.0.1:{port} is already the address of unit 1");
    assert_eq!(stderr, format!("mom-base-station: {file}: {fault}\n"));
    robot.ask("mute");
    assert_eq!(robot.line().await, "did mute", "nobody has connected before");
}

#[tokio::test]
async fn robots_are_added_changed_and_removed_in_the_file() {
    let (_, folder) = program(&[4001]);
    let file = folder.path().join("hall.toml");
    let edit = async |args: &[&str]| {
        let mut command = started_as_link();
        command.arg("--fleet").arg(&file).args(args);
        run(command).await
    };
    let now = || std::fs::read_to_string(&file).expect("it is there");
    let added = edit(&["add", "7", "10.0.0.7:4000", "--group", "scouts"]).await;
    assert!(added.status.success(), "{added:?}");
    assert!(text(&added.stdout).starts_with("added unit 7 in "), "{added:?}");
    std::fs::write(&file, format!("# The hall.\n\n{}", now())).expect("it is ours");
    for args in [
        &["add", "8", "10.0.0.8:4000"][..],
        &[
            "change",
            "7",
            "--address",
            "[::1]:4000",
            "--no-group",
            "--name",
            "Bob",
        ],
        &["change", "8", "--unit", "9"],
    ] {
        let done = edit(args).await;
        assert!(done.status.success(), "{done:?}");
    }
    let wanted = "# The hall.\n\n[[robot]]\nunit = 7\naddress = \"[::1]:4000\"\nname = \"Bob\"\n\n\
        [[robot]]\nunit = 9\naddress = \"10.0.0.8:4000\"\n";
    assert_eq!(now(), wanted);
    for (args, said) in [
        (
            &["add", "9", "10.0.0.9:4000"][..],
            "nothing was changed: line 13, column 8: unit 9 is already in line 9",
        ),
        (&["add", "100000", "10.0.0.9:4000"], "a unit number is 1 to 99999"),
        (&["add", "10", "10.0.0.9"], "the port is missing"),
        (&["change", "7"], "there is nothing to change"),
        (&["remove", "8"], "there is no unit 8"),
        (&["remove", "7", "9"], "there is no `[[robot]]`"),
    ] {
        let refused = edit(args).await;
        let said_it = text(&refused.stderr);
        assert!(
            !refused.status.success() && said_it.contains(said),
            "{args:?}: {said_it}"
        );
        assert_eq!(now(), wanted);
    }
    let removed = edit(&["remove", "9"]).await;
    assert!(
        removed.status.success() && !now().contains("unit = 9"),
        "{removed:?}"
    );
}

/// Nobody is told that a change is made which another one has taken back.
#[tokio::test]
async fn changes_at_once_are_all_made() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("hall.toml");
    let mut adding: Vec<_> = (1..=8)
        .map(|unit| {
            let mut command = started_as_link();
            let (unit, address) = (unit.to_string(), format!("10.0.0.{unit}:4000"));
            command.arg("--fleet").arg(&file).args(["add", &unit, &address]);
            command.stdout(std::process::Stdio::null());
            command.spawn().expect("the program starts")
        })
        .collect();
    for added in &mut adding {
        assert!(added.wait().expect("it ends").success());
    }
    let made = std::fs::read_to_string(&file).expect("it is there");
    assert_eq!(made.matches("[[robot]]").count(), 8, "{made}");
}
