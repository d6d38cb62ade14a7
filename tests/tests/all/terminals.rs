//! Programs whose terminal is closed end in order: what moves is halted first.

use std::fs::File;
use std::io::{BufReader, Read as _, Write as _};
use std::net::{Shutdown, TcpListener};
use std::os::fd::OwnedFd;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc;
use std::time::Instant;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags, open};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Winsize, tcsetwinsize};

use mom_tests::programs::{PATIENCE, Running, program};

use crate::programs::ignores_hangup;

/// A program and the terminal that is its own.
struct OnTerminal {
    child: Child,
    terminal: File,
    shown: Vec<u8>,
    _state: tempfile::TempDir,
}

impl OnTerminal {
    /// Starts a program with its three streams on a terminal of 100 columns and 30 lines.
    fn start(name: &str, args: &[&str], environment: &[(&str, &str)]) -> OnTerminal {
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let terminal = openpt(flags).expect("a terminal");
        grantpt(&terminal).expect("its user is this one");
        unlockpt(&terminal).expect("it can be opened");
        let size = Winsize {
            ws_row: 30,
            ws_col: 100,
            ws_xpixel: 0,
            ws_ypixel: 0,
        };
        tcsetwinsize(&terminal, size).expect("it has a size");
        let name_of_terminal = ptsname(&terminal, Vec::new()).expect("it has a name");
        let end = || -> OwnedFd {
            let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
            open(&*name_of_terminal, flags, Mode::empty()).expect("it opens")
        };
        let state = tempfile::tempdir().expect("a folder");
        let mut command = Command::new("setsid");
        command
            .arg("--ctty")
            .arg(program(name))
            .args(args)
            .env_remove("STATE_DIRECTORY")
            .env("XDG_STATE_HOME", state.path())
            .env("TERM", "xterm")
            .envs(environment.iter().copied())
            .stdin(Stdio::from(end()))
            .stdout(Stdio::from(end()))
            .stderr(Stdio::from(end()));
        let child = command.spawn().expect("the program starts");
        OnTerminal {
            child,
            terminal: File::from(terminal),
            shown: Vec::new(),
            _state: state,
        }
    }

    /// Waits until it has shown this.
    fn shows(&mut self, words: &str) {
        let until = Instant::now() + PATIENCE;
        let mut buffer = [0; 4096];
        while !String::from_utf8_lossy(&self.shown).contains(words) {
            let shown = String::from_utf8_lossy(&self.shown);
            assert!(Instant::now() < until, "{words} in {shown}");
            let mut fds = [PollFd::new(&self.terminal, PollFlags::IN)];
            let wait = Timespec {
                tv_sec: 0,
                tv_nsec: 100_000_000,
            };
            if poll(&mut fds, Some(&wait)).expect("it can be waited for") > 0 {
                let length = self
                    .terminal
                    .read(&mut buffer)
                    .unwrap_or_else(|error| panic!("{error}: {shown}"));
                self.shown.extend_from_slice(&buffer[..length]);
            }
        }
    }

    /// Types something.
    fn types(&mut self, text: &str) {
        self.terminal.write_all(text.as_bytes()).expect("it takes keys");
    }

    /// Closes the terminal, and waits for the end of the program.
    fn close(self) -> ExitStatus {
        let OnTerminal {
            mut child,
            terminal,
            _state,
            ..
        } = self;
        drop(terminal);
        let until = Instant::now() + PATIENCE;
        loop {
            if let Some(status) = child.try_wait().expect("a child can be waited for") {
                return status;
            }
            if Instant::now() > until {
                let _ = child.kill();
                panic!("it does not end");
            }
            std::thread::yield_now();
        }
    }
}

/// It says 1 where it finds that nothing can be shown before it hears that the terminal is gone.
fn ended_by_itself(program: OnTerminal) -> bool {
    matches!(program.close().code(), Some(0 | 1))
}

/// A robot of the fleet's wire: it answers each NULL, and tells every other frame that it reads.
fn robot() -> (String, mpsc::Receiver<String>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address").to_string();
    let (sender, frames) = mpsc::channel();
    std::thread::spawn(move || {
        let (mut answers, _) = listener.accept().expect("the station comes");
        let mut heard = BufReader::new(answers.try_clone().expect("one more"));
        let mut code = [0; 2];
        while heard.read_exact(&mut code).is_ok() {
            match &code {
                b"00" => answers.write_all(b"00").expect("the station is there"),
                // MOTOR: two numbers of five characters, each behind a blank.
                b"06" => {
                    let mut values = [0; 12];
                    heard.read_exact(&mut values).expect("a whole frame");
                    let _ = sender.send(String::from_utf8_lossy(&values).into_owned());
                }
                other => panic!("{other:?}"),
            }
        }
        let _ = answers.shutdown(Shutdown::Both);
    });
    (address, frames)
}

#[test]
fn a_station_whose_terminal_is_closed_stops_its_robots() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("fleet.toml");
    let (address, frames) = robot();
    std::fs::write(&file, format!("[[robot]]\nunit = 1\naddress = \"{address}\"\n")).expect("it is written");
    let fleet = file.to_str().expect("a path in text");
    let mut station = OnTerminal::start("mom-base-station", &["--fleet", fleet], &[]);
    station.shows("c connect all");
    station.types("c");
    station.shows("writable");
    station.types("s");
    station.types("motor 100 100\r");
    assert_eq!(frames.recv_timeout(PATIENCE).as_deref(), Ok(" 00100 00100"));
    assert!(ended_by_itself(station));
    assert_eq!(frames.recv_timeout(PATIENCE).as_deref(), Ok(" 00000 00000"));
}

/// To part from a robot stops it: nobody would be left that could.
#[test]
fn a_robot_that_its_station_parts_from_is_stopped() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("fleet.toml");
    let (address, frames) = robot();
    std::fs::write(&file, format!("[[robot]]\nunit = 1\naddress = \"{address}\"\n")).expect("it is written");
    let fleet = file.to_str().expect("a path in text");
    let mut station = OnTerminal::start("mom-base-station", &["--fleet", fleet], &[]);
    station.shows("c connect all");
    station.types("c");
    station.shows("writable");
    station.types("s");
    station.types("motor 100 100\r");
    assert_eq!(frames.recv_timeout(PATIENCE).as_deref(), Ok(" 00100 00100"));
    station.types("d");
    assert_eq!(frames.recv_timeout(PATIENCE).as_deref(), Ok(" 00000 00000"));
    station.types("q");
}

/// Also one that has much to say: a log that cannot be written ends nothing, least of all in the middle.
#[test]
fn a_lab_and_a_drive_whose_terminal_is_closed_end_in_order() {
    // Started by `nohup`, a lab is to go on.
    if ignores_hangup() {
        return;
    }
    for options in [&["--cubo"][..], &["--fleet", "3"]] {
        let args = [&["lab", "--listen", "127.0.0.1:0", "--log", "info"], options].concat();
        let mut lab = OnTerminal::start("mom", &args, &[]);
        lab.shows("mom watch");
        assert!(ended_by_itself(lab), "{options:?}");
    }
    let (_lab, hub) = Running::lab();
    let user = [
        ("MOM_HUB", hub.as_str()),
        ("MOM_USER", "alice"),
        ("MOM_PASSWORD", "alice"),
    ];
    let mut jog = OnTerminal::start("mom", &["jog"], &user);
    jog.shows("mm/s");
    jog.types("w");
    assert!(ended_by_itself(jog));
    // It has given its token back.
    let mut next = OnTerminal::start("mom", &["jog"], &user);
    next.shows("mm/s");
    assert!(ended_by_itself(next));
}
