//! What is measured: a program and its driver.

use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

use mom_proto::codec::Form;
use tempfile::TempDir;

use crate::{Driver, Error, MomDriver, Process, RelayDriver};

/// The one user of a broker under measurement; its password is its name.
pub const USER: &str = "peer";

// Peers here only listen or only send, for as long as it takes: heartbeats would be noise.
const CONFIG: &str = r#"
listen = ["127.0.0.1:0"]
connections = 20000
connections-before-login = 20000
connections-per-address = 20000
connections-per-user = 20000
log = "warn"
users = "users.toml"
root = "open"

[store]
state = "state"

[login]
guests = true

[limits]
heartbeat = 600000
gone = 1200000
requests = "unlimited"

[managers.driving]
kind = "chain"
of = ["who", { kind = "quota", limits = [{ parcels = 100000000, burst = 100000000 }] }]

[managers.who]
kind = "roles"

[[managers.who.rules]]
name = "looking"
allow = ["join", "lookup", "info", "stop", "unstop"]

[[managers.who.rules]]
name = "driving"
messages = ["command"]
allow = ["send"]

[[contexts]]
path = "/bench"
kind = "channel"
presence = "none"

[[contexts]]
path = "/back"
kind = "channel"
presence = "none"

[[contexts]]
path = "/bulk"
kind = "channel"
presence = "none"
overflow = "wait"

[[contexts]]
path = "/camera"
kind = "channel"
presence = "none"

[[contexts]]
path = "/stop"
kind = "channel"
presence = "none"

[[contexts]]
path = "/cell"
kind = "session"
presence = "none"

[[contexts]]
path = "/cell/token"
kind = "token"

[[contexts]]
path = "/cell/arm"
kind = "channel"
presence = "none"
manager = "driving"
guard = { token = "/cell/token", names = ["command"] }
"#;

/// A hub under measurement.
pub struct Hub {
    /// Its name in tables.
    pub name: String,
    /// Speaks with it.
    pub driver: Box<dyn Driver>,
    /// Its process; none for one inside this process.
    pub process: Option<Arc<Process>>,
}

impl Hub {
    /// A broker that listens at this address, spoken to in this form.
    ///
    /// # Errors
    /// A broker without the configuration of [`broker_folder`].
    pub fn broker(address: &str, form: Form) -> Result<Hub, Error> {
        let name = match form {
            Form::Binary | Form::Packed => "MOM",
            Form::Xml => "MOM XML",
            Form::Json => "MOM JSON",
        };
        Ok(Hub {
            name: name.to_owned(),
            driver: Box::new(MomDriver::new(address, form)?),
            process: None,
        })
    }

    /// A relay that listens at this address.
    pub fn relay(address: &str) -> Hub {
        Hub {
            name: "relay".to_owned(),
            driver: Box::new(RelayDriver::new(address)),
            process: None,
        }
    }

    /// The same in a process of its own.
    #[must_use]
    pub fn in_process(mut self, process: &Arc<Process>) -> Hub {
        self.process = Some(Arc::clone(process));
        self
    }

    /// The processor time of its process so far.
    pub fn cpu(&self) -> Option<Duration> {
        self.process.as_ref().and_then(|process| process.cpu())
    }
}

/// A folder with `mom.toml` and `users.toml` for a broker under measurement: an open root, one channel.
///
/// # Errors
/// A folder that cannot be made.
pub fn broker_folder() -> Result<TempDir, Error> {
    let failed = || Error::io("a folder for the broker's configuration");
    let folder = tempfile::tempdir().map_err(failed())?;
    let hash = mom_broker::hash(USER).map_err(Error::Unexpected)?;
    let users = format!("[[users]]\nname = \"{USER}\"\npassword = \"{hash}\"\n");
    std::fs::write(folder.path().join("users.toml"), users).map_err(failed())?;
    std::fs::write(folder.path().join("mom.toml"), CONFIG).map_err(failed())?;
    Ok(folder)
}

/// Starts the broker's program.
///
/// # Errors
/// A program that does not start.
pub fn start_broker(program: &Path, folder: &TempDir) -> Result<Process, Error> {
    let mut command = Command::new(program);
    command.arg("--config").arg(folder.path().join("mom.toml"));
    // As those that it is compared with.
    command.env("MOM_NICENESS", "0");
    Process::start(command)
}

/// Starts the relay's program.
///
/// # Errors
/// A program that does not start.
pub fn start_relay(program: &Path) -> Result<Process, Error> {
    Process::start(Command::new(program))
}
