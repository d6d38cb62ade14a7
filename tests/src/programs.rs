//! The real programs as processes: built once, started on free ports, ended with the test.

use std::io::{BufRead, BufReader};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::OnceLock;
use std::sync::mpsc;
use std::time::{Duration, Instant};

/// How long anything may take before a test gives up; no test waits so long when all is well.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// The programs that are links to `mom-device`, and what each is.
const LINKS: &[(&str, &str)] = &include!("../../mom-robot/names.rs");

/// The folder of the project.
pub fn project() -> PathBuf {
    let here = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    here.parent().map(PathBuf::from).unwrap_or(here)
}

/// The path of a program of this workspace, built with the tests' own settings.
///
/// # Panics
/// If it cannot be built.
pub fn program(name: &str) -> PathBuf {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| {
        let folder = build(&["mom", "mom-broker", "mom-robot"]);
        LINKS.iter().for_each(|(name, _)| link(&folder, name));
        folder
    });
    folder.join(name)
}

/// Makes a link of this name to `mom-device`, as the packages have it.
fn link(folder: &Path, name: &str) {
    let link = folder.join(name);
    if link.read_link().is_ok_and(|to| to == Path::new("mom-device")) {
        return;
    }
    // In one step: other test programs start it, and may make it too.
    let made = tempfile::tempdir_in(folder).expect("a folder beside the programs");
    let new = made.path().join(name);
    symlink("mom-device", &new).expect("a link");
    std::fs::rename(new, link).expect("it is moved");
}

/// Builds the programs of these packages with the tests' own settings: `cargo test` builds those of a package only for
/// that package's own tests. Gives the folder that they are in.
///
/// # Panics
/// If they cannot be built.
pub fn build(packages: &[&str]) -> PathBuf {
    let packages = packages.iter().flat_map(|package| ["-p", package]);
    cargo_build("", ["--bins"].into_iter().chain(packages))
}

/// The path of a program of the measurements, which are a workspace of their own.
///
/// # Panics
/// If it cannot be built.
pub fn measuring(package: &str, name: &str) -> PathBuf {
    cargo_build("benches", ["-p", package, "--bin", name]).join(name)
}

/// The path of an example of a package, built with the tests' own settings.
///
/// # Panics
/// If it cannot be built.
pub fn example(package: &str, name: &str) -> PathBuf {
    let folder = cargo_build("", ["-p", package, "--example", name]);
    folder.join("examples").join(name)
}

/// Builds this in the workspace of this folder.
fn cargo_build<'a>(workspace: &str, what: impl IntoIterator<Item = &'a str>) -> PathBuf {
    // `cargo xtask test` has built them all.
    if let Some(folder) = std::env::var_os("MOM_PROGRAMS") {
        return folder.into();
    }
    let test = std::env::current_exe().expect("a test knows its own program");
    let folder = test
        .ancestors()
        .nth(2)
        .expect("tests lie in deps below the programs")
        .to_path_buf();
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut command = Command::new(cargo);
    command.args(["build", "--quiet", "--locked"]).args(what);
    // Those of this package: ring's build script watches them, and it and all above it would be built again each time.
    for (name, _) in std::env::vars_os() {
        let text = name.to_string_lossy();
        if text.starts_with("CARGO_PKG_") || text.starts_with("CARGO_MANIFEST_") {
            command.env_remove(name);
        }
    }
    command.current_dir(project().join(workspace));
    if folder.ends_with("release") {
        command.arg("--release");
    }
    if let Some(target) = folder.parent() {
        command.arg("--target-dir").arg(target);
    }
    let status = command.status().expect("cargo can be run");
    assert!(status.success(), "the programs are built");
    folder
}

/// A program that runs beside the test and is killed with it.
#[derive(Debug)]
pub struct Running {
    name: String,
    /// None once it was waited for.
    child: Option<Child>,
    /// Where it keeps its state, unless its environment says otherwise.
    _state: Option<tempfile::TempDir>,
    lines: mpsc::Receiver<String>,
}

/// The turn of a test whose agent drives by the images of a whole lab: two labs at once draw them so seldom on two cores that it needs more
/// commands than it is lent.
pub fn turn() -> &'static tokio::sync::Mutex<()> {
    static TURN: tokio::sync::Mutex<()> = tokio::sync::Mutex::const_new(());
    &TURN
}

impl Running {
    /// Starts a program; its output is read line by line.
    ///
    /// # Panics
    /// If it cannot be started.
    pub fn start(name: &str, args: &[&str], environment: &[(&str, &str)]) -> Running {
        Running::start_with(name, args, environment, Stdio::inherit())
    }

    /// The same, with its log to somewhere.
    ///
    /// # Panics
    /// If it cannot be started.
    pub fn start_with(name: &str, args: &[&str], environment: &[(&str, &str)], log: Stdio) -> Running {
        let mut command = Command::new(program(name));
        let state = tempfile::tempdir().expect("a folder");
        command
            .env_remove("STATE_DIRECTORY")
            .env("XDG_STATE_HOME", state.path());
        command.args(args).envs(environment.iter().copied()).stderr(log);
        let mut running = Running::of(name, &mut command);
        running._state = Some(state);
        running
    }

    /// The same of a command that knows all but where its output goes.
    ///
    /// # Panics
    /// If it cannot be started.
    pub fn of(name: &str, command: &mut Command) -> Running {
        command.stdin(Stdio::null()).stdout(Stdio::piped());
        let mut child = command.spawn().expect("the program starts");
        let stdout = child.stdout.take().expect("its output is piped");
        let (sender, lines) = mpsc::channel();
        std::thread::spawn(move || {
            for line in BufReader::new(stdout).lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    break;
                }
            }
        });
        Running {
            name: name.to_owned(),
            child: Some(child),
            _state: None,
            lines,
        }
    }

    /// Starts the broker with a configuration file on a free port of loopback; also its `HOST:PORT`.
    ///
    /// # Panics
    /// If it does not start.
    pub fn broker(config: &Path) -> (Running, String) {
        let config = config.to_str().expect("a path in text");
        let broker = Running::start(
            "mom-broker",
            &["--config", config, "--listen", "127.0.0.1:0"],
            &[],
        );
        let address = broker.listening();
        (broker, address)
    }

    /// Starts the demonstration lab on a free port of loopback; also the address of its hub.
    ///
    /// # Panics
    /// If it does not start.
    pub fn lab() -> (Running, String) {
        Running::lab_with(&[])
    }

    /// The same with more options.
    ///
    /// # Panics
    /// If it does not start.
    pub fn lab_with(options: &[&str]) -> (Running, String) {
        let lab = Running::start(
            "mom",
            &[&["lab", "--listen", "127.0.0.1:0"], options].concat(),
            &[],
        );
        let line = lab.line_with("bin://");
        let hub = line.split_whitespace().find(|word| word.starts_with("bin://"));
        (lab, hub.expect("the hub's address").to_owned())
    }

    /// The `HOST:PORT` where a broker says that it listens.
    ///
    /// # Panics
    /// If it does not say so in time.
    pub fn listening(&self) -> String {
        let line = self.line_with("listening at");
        let address = line.split("tcp://").nth(1);
        let address = address.and_then(|rest| rest.split_whitespace().next());
        address.expect("the broker says where it listens").to_owned()
    }

    /// The next line that contains `text`.
    ///
    /// # Panics
    /// If none comes in time.
    pub fn line_with(&self, text: &str) -> String {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.lines.recv_timeout(left) {
                Ok(line) if line.contains(text) => return line,
                Ok(_) => {}
                Err(error) => panic!("{} never said {text:?}: {error}", self.name),
            }
        }
    }

    /// The number of its process.
    ///
    /// # Panics
    /// Never: it runs until it is waited for.
    pub fn id(&self) -> u32 {
        let child = self.child.as_ref();
        child.map(Child::id).expect("it runs until it is waited for")
    }

    /// Sends a signal by its name, such as `TERM`.
    ///
    /// # Panics
    /// If it cannot be sent.
    pub fn signal(&self, name: &str) {
        let id = self.id().to_string();
        let status = Command::new("kill").args([&format!("-{name}"), &id]).status();
        assert!(
            status.is_ok_and(|status| status.success()),
            "{name} reaches {}",
            self.name
        );
        // On a busy machine its threads run on until each has had a turn.
        while name == "STOP" && !is_stopped(&id) {
            std::thread::yield_now();
        }
    }

    /// Waits for the program's own end.
    ///
    /// # Panics
    /// If it does not end in time.
    pub fn wait(mut self) -> ExitStatus {
        let mut child = self.child.take().expect("it is waited for once");
        let id = child.id();
        let (sender, ended) = mpsc::channel();
        std::thread::spawn(move || sender.send(child.wait()));
        match ended.recv_timeout(PATIENCE) {
            Ok(status) => status.expect("a child can be waited for"),
            Err(_) => {
                // It is still ours and running, so the number is still its own.
                let _ = Command::new("kill").args(["-KILL", &id.to_string()]).status();
                panic!("{} does not end", self.name)
            }
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            // It may have ended by itself; then there is nothing to kill.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Runs a program to its end.
///
/// # Panics
/// If it cannot be started.
pub fn run(name: &str, args: &[&str], environment: &[(&str, &str)]) -> Output {
    let mut command = Command::new(program(name));
    command
        .args(args)
        .envs(environment.iter().copied())
        .stdin(Stdio::null());
    command.output().expect("the program runs")
}

/// An output as a person would read it.
pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Whether all threads of a program stand still, or have ended.
fn is_stopped(id: &str) -> bool {
    let Ok(threads) = std::fs::read_dir(format!("/proc/{id}/task")) else {
        return true;
    };
    threads.flatten().all(|thread| {
        let stat = std::fs::read_to_string(thread.path().join("stat")).unwrap_or_default();
        // After the name, which stands in brackets and may be anything.
        stat.rsplit_once(") ")
            .is_none_or(|(_, state)| state.starts_with(['T', 'Z', 'X']))
    })
}
