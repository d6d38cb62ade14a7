//! The real broker program with a configuration of the test's own.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};

use crate::programs::{Running, program, project};

const CONFIG: &str = "mom.toml";
const USERS: &str = "lab-users.toml";
const LOG: &str = "mom.log";

/// A folder with the configuration of the demonstration lab, to be changed: where a broker can be started again.
#[derive(Debug)]
pub struct Home {
    folder: tempfile::TempDir,
}

impl Home {
    /// The lab's configuration with further tables, such as `[limits]` or `[[contexts]]`.
    ///
    /// # Panics
    /// If it cannot be written.
    pub fn new(more: &str) -> Home {
        let home = Home {
            folder: tempfile::tempdir().expect("a folder"),
        };
        let lab = read(&project().join("config/lab.toml"));
        // Read again when the test says so, and not a moment before.
        home.write_config(&format!("reload = \"signal\"\n{lab}\n{more}\n"));
        home.write_users(&read(&project().join("config").join(USERS)));
        home
    }

    /// Where its files lie.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// The configuration's text.
    pub fn config(&self) -> String {
        read(&self.file(CONFIG))
    }

    /// Writes the configuration anew; a broker that runs does not know of it yet.
    pub fn write_config(&self, text: &str) {
        std::fs::write(self.file(CONFIG), text).expect("a file");
    }

    /// The users file's text.
    pub fn users(&self) -> String {
        read(&self.file(USERS))
    }

    /// Writes the users file anew.
    pub fn write_users(&self, text: &str) {
        std::fs::write(self.file(USERS), text).expect("a file");
    }

    /// Starts a broker here, on a free port of loopback.
    pub async fn start(&self) -> Service {
        self.start_in(&[]).await
    }

    /// The same with these variables in its environment.
    ///
    /// # Panics
    /// If it does not start.
    pub async fn start_in(&self, environment: &[(&str, &str)]) -> Service {
        self.start_logging(environment, append(&self.file(LOG))).await
    }

    /// The same with its log to somewhere else.
    ///
    /// # Panics
    /// If it does not start.
    pub async fn start_logging(&self, environment: &[(&str, &str)], stderr: Stdio) -> Service {
        let (config, log) = (self.file(CONFIG).display().to_string(), self.file(LOG));
        let state = self.file("state-home").display().to_string();
        let environment: Vec<(String, String)> = [("XDG_STATE_HOME", &*state)]
            .iter()
            .chain(environment)
            .map(|(key, value)| ((*key).to_owned(), (*value).to_owned()))
            .collect();
        let started = tokio::task::spawn_blocking(move || start(&config, &environment, log, stderr));
        started.await.expect("the broker starts")
    }

    /// What the brokers here have logged.
    pub fn log(&self) -> String {
        read(&self.file(LOG))
    }

    /// The path of a file here.
    pub fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
}

fn read(file: &Path) -> String {
    std::fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()))
}

fn start(config: &str, environment: &[(String, String)], log: PathBuf, stderr: Stdio) -> Service {
    let environment: Vec<(&str, &str)> = environment
        .iter()
        .map(|(key, value)| (&**key, &**value))
        .collect();
    // Before it is started: what the environment is for must not befall the compiler.
    assert!(program("mom-broker").exists());
    let args = ["--config", config, "--listen", "127.0.0.1:0"];
    let running = Running::start_with("mom-broker", &args, &environment, stderr);
    let address = running.listening().parse();
    Service {
        address: address.expect("it is an address"),
        running: Some(running),
        log,
    }
}

fn append(log: &Path) -> Stdio {
    let file: std::io::Result<File> = OpenOptions::new().create(true).append(true).open(log);
    file.expect("a file").into()
}

/// A broker that runs as a process of its own, and is killed with the test.
#[derive(Debug)]
pub struct Service {
    /// None once it was ended.
    running: Option<Running>,
    address: SocketAddr,
    log: PathBuf,
}

impl Service {
    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Sends a signal by its name, such as `HUP`.
    ///
    /// # Panics
    /// If it cannot be sent.
    pub fn signal(&self, name: &str) {
        self.running
            .as_ref()
            .expect("it runs until it is ended")
            .signal(name);
    }

    /// Kills it as a power cut does, and waits until it has ended.
    pub async fn kill(self) {
        self.end("KILL").await;
    }

    /// Ends it in order, and gives how it ended.
    pub async fn terminate(self) -> ExitStatus {
        self.end("TERM").await
    }

    async fn end(mut self, signal: &str) -> ExitStatus {
        self.signal(signal);
        let running = self.running.take().expect("it is ended once");
        let ended = tokio::task::spawn_blocking(move || running.wait());
        ended.await.expect("waited for")
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        if std::thread::panicking() {
            // The folder goes with the test, and with it what would tell why it failed.
            let log = std::fs::read_to_string(&self.log).unwrap_or_default();
            let _ = writeln!(std::io::stderr(), "the broker's log:\n{log}");
        }
    }
}
