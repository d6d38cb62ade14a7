//! The attackers: processes of their own, so that they share nothing with the canary but the machine.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::SocketAddr;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::{env, io, thread};

use mom_tests::attacks::{Attack, Attackers as Peers};
use tokio::sync::oneshot;

use crate::Error;

/// Said when they are ready.
const READY: &str = "ready";

/// Attackers at work; they end with this.
pub(super) struct Attackers {
    children: Vec<(Child, ChildStdin, BufReader<ChildStdout>)>,
}

impl Attackers {
    /// Starts a process for each attack, and waits until all are ready.
    pub(super) fn start(attacks: &[Attack], address: &str) -> Result<Attackers, Error> {
        let own = env::current_exe().map_err(Error::io("this program"))?;
        let mut attackers = Attackers { children: Vec::new() };
        for attack in attacks {
            let mut command = Command::new(&own);
            command.args(["attack", attack.word(), address]);
            command.stdin(Stdio::piped()).stdout(Stdio::piped());
            let mut child = command.spawn().map_err(Error::io("attackers"))?;
            let (Some(input), Some(output)) = (child.stdin.take(), child.stdout.take()) else {
                return Err(Error::Unexpected("a child without pipes".to_owned()));
            };
            attackers.children.push((child, input, BufReader::new(output)));
        }
        for (_, _, output) in &mut attackers.children {
            let mut line = String::new();
            output.read_line(&mut line).map_err(Error::io("attackers"))?;
            if line.trim() != READY {
                return Err(Error::Unexpected(format!("the attackers said {line:?}")));
            }
        }
        Ok(attackers)
    }

    /// Ends them; gives what they heard.
    pub(super) fn end(mut self) -> Result<Vec<String>, Error> {
        let mut heard = Vec::new();
        for (mut child, input, mut output) in self.children.drain(..) {
            drop(input);
            let mut said = String::new();
            let read = output.read_to_string(&mut said);
            read.map_err(Error::io("attackers"))?;
            heard.extend(said.lines().map(str::to_owned));
            let _ = child.wait();
        }
        Ok(heard)
    }
}

impl Drop for Attackers {
    fn drop(&mut self) {
        for (child, ..) in &mut self.children {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Attacks a broker until standard input ends, then says what was heard: the other side of [`measure`](super::measure).
///
/// # Errors
/// A runtime or a terminal that does not work.
pub fn attack(attack: Attack, address: SocketAddr) -> Result<(), Error> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime.map_err(Error::io("a runtime"))?;
    let (over, mut ended) = oneshot::channel();
    thread::spawn(move || {
        let _ = io::stdin().read_to_end(&mut Vec::new());
        let _ = over.send(());
    });
    runtime.block_on(async {
        let mut peers = Peers::connect(attack, address).await;
        say(READY)?;
        loop {
            tokio::select! {
                _ = &mut ended => break,
                () = peers.round() => {}
            }
        }
        say(&format!("{} rounds", peers.rounds()))?;
        peers
            .heard()
            .iter()
            .try_for_each(|(what, times)| say(&format!("{what} × {times}")))
    })
}

fn say(line: &str) -> Result<(), Error> {
    writeln!(io::stdout(), "{line}").map_err(Error::io("standard output"))
}
