//! A robot of `robot.py`, as a process of its own.

use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::thread;
use std::time::Duration;

use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};
use tokio::time::timeout;

/// Longer than anything takes, however busy the machine is.
pub(crate) const PATIENCE: Duration = Duration::from_secs(30);

pub(crate) struct Robot {
    child: Child,
    stdin: ChildStdin,
    lines: UnboundedReceiver<String>,
    pub(crate) port: u16,
}

impl Robot {
    pub(crate) async fn start() -> Robot {
        let mut child = Command::new("python3")
            // Its text, as packages of other folders use it too.
            .args(["-c", include_str!("../robot.py")])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("python3 is installed by `cargo xtask test --install`");
        let stdin = child.stdin.take().expect("it is piped");
        let stdout = BufReader::new(child.stdout.take().expect("it is piped"));
        let (sender, lines) = unbounded_channel();
        thread::spawn(move || {
            stdout
                .lines()
                .map_while(Result::ok)
                .try_for_each(|line| sender.send(line))
        });
        let mut robot = Robot {
            child,
            stdin,
            lines,
            port: 0,
        };
        let line = robot.line().await;
        robot.port = line.trim_start_matches("port ").parse().expect("a port");
        robot
    }

    /// The next thing that happened.
    pub(crate) async fn line(&mut self) -> String {
        let line = timeout(PATIENCE, self.lines.recv()).await;
        line.expect("something should have happened")
            .expect("the robot should still be there")
    }

    /// Passes over what happens until this does.
    pub(crate) async fn until(&mut self, expected: &str) {
        let seen = timeout(PATIENCE, async { while self.line().await != expected {} });
        assert!(seen.await.is_ok(), "{expected} should have happened");
    }

    /// The next command that is not NULL.
    pub(crate) async fn command(&mut self) -> String {
        let command = timeout(PATIENCE, async {
            loop {
                if let Some(frame) = self.line().await.strip_prefix("got ")
                    && frame != "00"
                {
                    return frame.to_owned();
                }
            }
        });
        command.await.expect("a command should have come")
    }

    /// Has it do something.
    pub(crate) fn ask(&mut self, command: &str) {
        writeln!(self.stdin, "{command}").expect("the robot should still be there");
    }

    /// Has it do something, and waits until it is done.
    pub(crate) async fn tell(&mut self, command: &str) {
        self.ask(command);
        let word = command.split(' ').next().unwrap_or_default();
        self.until(&format!("did {word}")).await;
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The file of a fleet of these ports of this machine, from unit 1 on.
pub(crate) fn fleet(ports: &[u16]) -> String {
    let robot =
        |(at, port): (usize, &u16)| format!("[[robot]]\nunit = {}\naddress = \"127.0.0.1:{port}\"\n", at + 1);
    ports.iter().enumerate().map(robot).collect()
}
