//! `docs/lab.md` and `docs/fleet.md`: their commands are typed as they stand there, and say what stands there.

use std::fs;
use std::io::{BufRead as _, BufReader};
use std::os::unix::fs::symlink;
use std::os::unix::process::CommandExt as _;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::thread;

use mom_tests::programs::{PATIENCE, Running, program, project, turn};

/// A command of the page, and what it is to say.
#[derive(Debug)]
struct Typed {
    person: String,
    line: String,
    /// Whether it goes on beside the others.
    beside: bool,
    expected: Vec<String>,
    code: i32,
}

/// Whose prompts a page has; the owner of the lab starts programs.
const PERSONS: [&str; 4] = ["alice", "bob", "carol", "owner"];

/// The commands of the blocks of a page that begin so.
fn typed(page: &str, fence: &str) -> Vec<Typed> {
    let page = fs::read_to_string(project().join(page)).expect("it is there");
    let mut all: Vec<Typed> = Vec::new();
    for block in page.split(fence).skip(1) {
        for line in block.split("```").next().unwrap_or_default().lines() {
            let prompt = PERSONS
                .into_iter()
                .find_map(|person| Some((person, line.strip_prefix(person)?.strip_prefix("$ ")?)));
            if let Some((person, command)) = prompt {
                let beside = command.strip_suffix(" &");
                all.push(Typed {
                    person: person.to_owned(),
                    line: beside.unwrap_or(command).to_owned(),
                    beside: beside.is_some(),
                    expected: Vec::new(),
                    code: 0,
                });
                continue;
            }
            let last = all.last_mut().expect("a command before what it says");
            match line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
                Some(code) if code.parse::<i32>().is_ok() => last.code = code.parse().expect("a number"),
                _ => last.expected.push(line.to_owned()),
            }
        }
    }
    all
}

/// Whether a line of the page stands for this one: `…` for anything, and any blanks for others.
fn stands_for(pattern: &str, line: &str) -> bool {
    let plain = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let line = plain(line);
    let mut rest = line.as_str();
    pattern
        .split('…')
        .map(plain)
        .all(|piece| match rest.find(&piece) {
            Some(place) => {
                rest = &rest[place + piece.len()..];
                true
            }
            None => false,
        })
}

/// A shell with a command in it, and the lines that it says on both outputs, as they come.
fn start(typed: &Typed, hub: &str, folder: &std::path::Path) -> (Child, mpsc::Receiver<String>) {
    let programs = program("mom");
    let path = std::env::var("PATH").unwrap_or_default();
    let path = format!("{}:{path}", programs.parent().expect("a folder").display());
    let mut child = Command::new("sh")
        .args(["-c", &format!("({}) 2>&1", typed.line)])
        .envs([
            ("PATH", path.as_str()),
            ("MOM_HUB", hub),
            ("MOM_USER", &typed.person),
            ("MOM_PASSWORD", &typed.person),
        ])
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        // So that it ends with what it has started.
        .process_group(0)
        .spawn()
        .expect("there is a shell");
    let (sender, lines) = mpsc::channel();
    let output = BufReader::new(child.stdout.take().expect("it is piped"));
    thread::spawn(move || {
        for line in output.lines().map_while(Result::ok) {
            if sender.send(line).is_err() {
                return;
            }
        }
    });
    (child, lines)
}

#[test]
fn what_stands_there_is_typed_and_said() {
    let _turn = turn().blocking_lock();
    let (_lab, hub) = Running::lab();
    let all = typed("docs/lab.md", "```console\n");
    assert!(all.len() > 12, "{all:?}");
    type_all(&all, &hub);
}

#[test]
fn what_stands_there_of_two_arms_is_typed_and_said() {
    let (_lab, hub) = Running::lab_with(&["--two-arms"]);
    let all = typed("docs/lab.md", "```console two-arms\n");
    assert!(all.len() > 6, "{all:?}");
    type_all(&all, &hub);
}

/// Ten robots as programs of their own: a formation, a link that is cut, a battery that dies, and carol who takes the group.
#[test]
fn what_stands_there_of_a_fleet_is_typed_and_said() {
    let (_broker, hub) = Running::broker(&project().join("config/fleet.toml"));
    let all = typed("docs/fleet.md", "```console ten\n");
    assert!(all.len() > 12, "{all:?}");
    type_all(&all, &format!("bin://{hub}"));
}

/// CUBO and its middle as programs of their own: a square, a network that is cut, and carol who takes it.
#[test]
fn what_stands_there_of_a_thin_robot_is_typed_and_said() {
    let (_broker, hub) = Running::broker(&project().join("config/fleet.toml"));
    let all = typed("docs/simulacrum.md", "```console cubo\n");
    assert!(all.len() > 12, "{all:?}");
    type_all(&all, &format!("bin://{hub}"));
}

fn type_all(all: &[Typed], hub: &str) {
    let folder = tempfile::tempdir().expect("a folder");
    symlink(project().join("config"), folder.path().join("config")).expect("a link");
    let mut beside = Vec::new();
    for typed in all {
        let (mut child, lines) = start(typed, hub, folder.path());
        let mut said = Vec::new();
        for expected in &typed.expected {
            loop {
                let line = lines.recv_timeout(PATIENCE);
                let line = line.unwrap_or_else(|_| panic!("{}: no `{expected}` in {said:#?}", typed.line));
                let found = stands_for(expected, &line);
                said.push(line);
                if found {
                    break;
                }
            }
        }
        if typed.beside {
            // Its lines are read on, or it would stand still.
            beside.push((child, lines));
            continue;
        }
        said.extend(lines.iter());
        let status = child.wait().expect("it ends");
        assert_eq!(status.code(), Some(typed.code), "{}: {said:#?}", typed.line);
    }
    for (mut child, lines) in beside {
        drop(lines);
        // Whatever it does now, the page has nothing to say about it.
        let _ = Command::new("kill")
            .args(["-KILL", "--", &format!("-{}", child.id())])
            .status();
        let _ = child.wait();
    }
}
