//! The broker as a program of its own.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use crate::lab::Lab;

/// A broker of the lab that runs, and is killed with the test.
pub(crate) struct Running {
    child: Child,
    /// Where it listens.
    pub(crate) address: String,
}

impl Running {
    /// Starts it; its log is `log.txt`.
    pub(crate) fn start(lab: &Lab, args: &[&str]) -> Running {
        let log = File::create(lab.path("log.txt")).expect("a file");
        let mut child = Command::new(env!("CARGO_BIN_EXE_mom-broker"))
            .env("XDG_STATE_HOME", env!("CARGO_TARGET_TMPDIR"))
            .env_remove("STATE_DIRECTORY")
            .env_remove("MOM_CONFIG")
            .current_dir(lab.folder())
            .args(["--config", "lab.toml"])
            .args(args)
            .stdout(Stdio::piped())
            .stderr(log)
            .spawn()
            .expect("the program runs");
        let mut line = String::new();
        let out = child.stdout.as_mut().expect("piped");
        BufReader::new(out)
            .read_line(&mut line)
            .expect("where it listens");
        let address = line
            .split("tcp://")
            .nth(1)
            .and_then(|rest| rest.split(' ').next());
        let address = address.unwrap_or_else(|| panic!("{line:?}")).to_owned();
        Running { child, address }
    }

    /// Stops it in order.
    pub(crate) fn stop(mut self) {
        let pid = self.child.id().to_string();
        let killed = Command::new("kill").args(["-TERM", &pid]).status();
        assert!(killed.expect("kill runs").success());
        assert!(self.child.wait().expect("it ends").success());
    }

    /// Ends it as a failure of power would.
    pub(crate) fn kill(mut self) {
        self.child.kill().expect("it runs");
        self.child.wait().expect("it ends");
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
