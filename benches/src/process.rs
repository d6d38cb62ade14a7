//! Programs under measurement: started as children, killed at the end whatever the end is.
#![expect(
    unsafe_code,
    reason = "a child that ends with its parent, however that ends, is asked for between fork and exec"
)]

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::Error;

/// A program that listens nowhere by then does not start.
const START: Duration = Duration::from_secs(10);

/// A running child. It is killed when this is dropped or when the thread that started it ends.
#[derive(Debug)]
pub struct Process {
    child: Child,
    /// The address that it said it listens at.
    address: String,
}

impl Process {
    /// Starts a program that says `listening at tcp://ADDRESS` on its first line.
    ///
    /// # Errors
    /// A program that cannot be started or says something else.
    pub fn start(mut command: Command) -> Result<Process, Error> {
        let what = format!("start {}", command.get_program().display());
        command.stdin(Stdio::null()).stdout(Stdio::piped());
        end_with_parent(&mut command);
        let mut child = command.spawn().map_err(Error::io(what.clone()))?;
        let output = child.stdout.take();
        let mut process = Process {
            child,
            address: String::new(),
        };
        let mut line = String::new();
        if let Some(output) = output {
            BufReader::new(output)
                .read_line(&mut line)
                .map_err(Error::io(what.clone()))?;
        }
        let address = line.split_once("tcp://").map(|(_, rest)| rest.split_whitespace());
        match address.and_then(|mut words| words.next()) {
            Some(address) => process.address = address.to_owned(),
            None => return Err(Error::Unexpected(format!("{what}: it said {line:?}"))),
        }
        Ok(process)
    }

    /// Starts a program that says nothing, and waits until `address` accepts connections; `connect` tries.
    ///
    /// # Errors
    /// A program that cannot be started, ends, or listens nowhere after some seconds; with the end of what it said.
    pub fn start_at(
        mut command: Command,
        address: &str,
        log: &Path,
        connect: impl Fn(&str) -> bool,
    ) -> Result<Process, Error> {
        let what = format!("start {}", command.get_program().display());
        let file = File::create(log).map_err(Error::io(what.clone()))?;
        let both = file.try_clone().map_err(Error::io(what.clone()))?;
        command.stdin(Stdio::null()).stdout(file).stderr(both);
        end_with_parent(&mut command);
        let child = command.spawn().map_err(Error::io(what.clone()))?;
        let mut process = Process {
            child,
            address: address.to_owned(),
        };
        let start = Instant::now();
        while !connect(address) {
            let ended = process.child.try_wait().map_err(Error::io(what.clone()))?;
            if ended.is_some() || start.elapsed() > START {
                let said = std::fs::read_to_string(log).unwrap_or_default();
                let last: Vec<_> = said.lines().rev().take(5).collect();
                let last: Vec<_> = last.into_iter().rev().collect();
                return Err(Error::Unexpected(format!(
                    "{what}: nobody listens: {}",
                    last.join(" | ")
                )));
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        Ok(process)
    }

    /// Where it listens.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Its number.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Ends it in its own way, so that it says on standard error what it has to say; one that does not end is killed.
    pub fn end(mut self) {
        if let Ok(id) = i32::try_from(self.child.id()) {
            // SAFETY: a call with two numbers; the child has not been waited for, so its number is its own.
            unsafe { libc::kill(id, libc::SIGTERM) };
        }
        let start = Instant::now();
        while start.elapsed() < START && matches!(self.child.try_wait(), Ok(None)) {
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// The processor time that it has used, in steps of 10 ms; none where the system does not say.
    pub fn cpu(&self) -> Option<Duration> {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.child.id())).ok()?;
        cpu_of(&stat)
    }

    /// The most memory in bytes that it ever had in use; none where the system does not say.
    pub fn most_memory(&self) -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).ok()?;
        kib_of(&status, "VmHWM:")
    }

    /// The bytes of memory that it has in use; none where the system does not say.
    pub fn memory(&self) -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).ok()?;
        memory_of(&status)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // A child that has ended by itself cannot be killed, and need not be.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// User and system time in a line of `/proc/PID/stat`, counted in hundredths of a second.
fn cpu_of(stat: &str) -> Option<Duration> {
    // The program's name may hold anything, also spaces and brackets.
    let (_, rest) = stat.rsplit_once(')')?;
    let mut fields = rest.split_whitespace().skip(11);
    let user: u64 = fields.next()?.parse().ok()?;
    let system: u64 = fields.next()?.parse().ok()?;
    Some(Duration::from_millis(10 * (user + system)))
}

/// The resident memory in `/proc/PID/status`, counted in KiB.
fn memory_of(status: &str) -> Option<u64> {
    kib_of(status, "VmRSS:")
}

fn kib_of(status: &str, key: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix(key))?;
    let kib: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(1024 * kib)
}

#[cfg(target_os = "linux")]
fn end_with_parent(command: &mut Command) {
    // SAFETY: the closure runs in the child between fork and exec, where only calls that are safe in a signal
    // handler are allowed: prctl is one, takes no pointer here, and nothing is allocated.
    unsafe {
        command.pre_exec(|| match libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL) {
            0 => Ok(()),
            _ => Err(std::io::Error::last_os_error()),
        });
    }
}

#[cfg(not(target_os = "linux"))]
fn end_with_parent(_command: &mut Command) {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processor_time_is_read_behind_any_name() {
        let line = "7 (a) b (c)) S 1 7 7 0 -1 4194560 99 0 0 0 250 150 3 4 20 0 1 0 5 6 7";
        assert_eq!(cpu_of(line), Some(Duration::from_secs(4)));
        assert_eq!(cpu_of("7 (a) S 1"), None);
    }

    #[test]
    fn memory_is_counted_in_bytes() {
        assert_eq!(memory_of("Name:\tx\nVmRSS:\t    1234 kB\n"), Some(1_263_616));
        assert_eq!(memory_of("Name:\tx\n"), None);
    }

    #[test]
    fn a_program_that_ends_says_why() {
        let folder = tempfile::tempdir().unwrap();
        let mut command = Command::new("sh");
        command.args(["-c", "echo no such luck; exit 1"]);
        let log = folder.path().join("log");
        let started = Process::start_at(command, "127.0.0.1:1", &log, |_| false);
        assert!(matches!(started, Err(Error::Unexpected(said)) if said.contains("no such luck")));
    }

    #[test]
    fn a_program_that_listens_nowhere_is_refused() {
        let mut command = Command::new("echo");
        command.arg("nothing to tell");
        assert!(matches!(Process::start(command), Err(Error::Unexpected(said)) if said.contains("nothing")));
    }
}
