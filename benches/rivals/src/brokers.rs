//! The programs that are measured beside each other, and how each is started: on a free port of loopback or of a
//! namespace, without persistence, without authentication, one process of its own.

use std::collections::BTreeMap;
use std::fs;
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use mom_benches::{Driver, Error, Hub, Process, RelayDriver, broker_folder};
use mom_proto::codec::Form;
use mom_tests::network::Network;
use tempfile::TempDir;

use crate::driver::{HOST, MqttDriver, NatsDriver, ROOMS, RedisDriver, XmppDriver, ZenohDriver};

/// A kind of hub.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// The relay that looks at nothing.
    RawRelay,
    /// The relay that parses length prefixes.
    Relay,
    /// Ours, in binary.
    Mom,
    /// Ours, in XML.
    MomXml,
    /// nats-server.
    Nats,
    /// redis-server.
    Redis,
    /// mosquitto.
    Mosquitto,
    /// zenohd.
    Zenoh,
    /// prosody.
    Prosody,
}

impl Kind {
    /// All of them, in the order of tables.
    pub const ALL: [Kind; 9] = [
        Kind::RawRelay,
        Kind::Relay,
        Kind::Mom,
        Kind::MomXml,
        Kind::Nats,
        Kind::Redis,
        Kind::Mosquitto,
        Kind::Zenoh,
        Kind::Prosody,
    ];

    /// Its name in tables and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Kind::RawRelay => "raw relay",
            Kind::Relay => "relay",
            Kind::Mom => "MOM",
            Kind::MomXml => "MOM XML",
            Kind::Nats => "nats",
            Kind::Redis => "redis",
            Kind::Mosquitto => "mosquitto",
            Kind::Zenoh => "zenoh",
            Kind::Prosody => "prosody",
        }
    }

    /// The one with this name.
    pub fn from_name(name: &str) -> Option<Kind> {
        Kind::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Whether it is another project's.
    pub fn is_peer(self) -> bool {
        self.program().is_some()
    }

    /// Whether it is one of ours.
    pub fn is_mom(self) -> bool {
        matches!(self, Kind::Mom | Kind::MomXml)
    }

    /// How many idle peers it is asked to take at most: zenohd looks at all for each one that comes, so that ten
    /// thousand would take an hour.
    pub(crate) fn most_idle(self) -> usize {
        match self {
            Kind::Zenoh => 2000,
            _ => usize::MAX,
        }
    }

    /// A peer's program.
    fn program(self) -> Option<&'static str> {
        match self {
            Kind::RawRelay | Kind::Relay | Kind::Mom | Kind::MomXml => None,
            Kind::Nats => Some("nats-server"),
            Kind::Redis => Some("redis-server"),
            Kind::Mosquitto => Some("mosquitto"),
            Kind::Zenoh => Some("zenohd"),
            Kind::Prosody => Some("prosody"),
        }
    }
}

/// The programs of this machine.
pub struct Programs {
    broker: PathBuf,
    relay: PathBuf,
    peers: BTreeMap<Kind, PathBuf>,
    /// The broker's configuration.
    folder: TempDir,
    /// What the others write and read.
    scratch: TempDir,
}

impl Programs {
    /// Looks for the peers in `kept` (`bin` and `nats/bin` below it), in `PATH` and where Debian puts services.
    ///
    /// # Errors
    /// A folder that cannot be made.
    pub fn find(broker: PathBuf, relay: PathBuf, kept: &Path) -> Result<Programs, Error> {
        let mut places = vec![kept.join("bin"), kept.join("nats/bin")];
        places.extend(std::env::split_paths(
            &std::env::var_os("PATH").unwrap_or_default(),
        ));
        places.extend(["/usr/sbin", "/usr/bin"].map(PathBuf::from));
        let found = |name: &str| {
            places
                .iter()
                .map(|place| place.join(name))
                .find(|path| path.is_file())
        };
        let peers = Kind::ALL
            .into_iter()
            .filter_map(|kind| Some((kind, found(kind.program()?)?)));
        let scratch = tempfile::Builder::new().prefix("mom-bench-").tempdir();
        Ok(Programs {
            broker,
            relay,
            peers: peers.collect(),
            folder: broker_folder()?,
            scratch: scratch.map_err(Error::io("a folder for the peers"))?,
        })
    }

    /// Whether it can be started.
    pub fn has(&self, kind: Kind) -> bool {
        !kind.is_peer() || self.peers.contains_key(&kind)
    }

    /// Its version as it says it itself; empty for ours and where it does not say.
    pub fn version(&self, kind: Kind) -> String {
        let Some(program) = self.peers.get(&kind) else {
            return String::new();
        };
        let flag = match kind {
            Kind::Mosquitto => "-h",
            Kind::Prosody => return debian_version("prosody"),
            _ => "--version",
        };
        let output = Command::new(program).arg(flag).output();
        let text = output.map_or_else(
            |_| String::new(),
            |output| String::from_utf8_lossy(&output.stdout).into_owned(),
        );
        let looks = |word: &&str| {
            let digits = word.trim_start_matches(['v', '=']);
            digits.starts_with(|first: char| first.is_ascii_digit()) && digits.contains('.')
        };
        let word = text.split([' ', '\n', ',']).find(looks).unwrap_or_default();
        word.trim_start_matches(['v', '=']).to_owned()
    }

    /// Starts one that hears its own only where `echo` says so, as far as it leaves the choice.
    ///
    /// # Errors
    /// A program that is not there or does not start.
    pub fn start(&self, kind: Kind, network: &Network, echo: bool) -> Result<Hub, Error> {
        let port = network.within(|| {
            let listener = TcpListener::bind((network.host(), 0))?;
            listener.local_addr()
        });
        let port = port.flatten().map_err(Error::io("a free port"))?.port();
        let address = format!("{}:{port}", network.host());
        let mut command = self.command(kind, network, port)?;
        if echo && matches!(kind, Kind::Relay | Kind::RawRelay) {
            command.arg("--echo");
        }
        let log = self.scratch.path().join(format!("{}.log", kind.name()));
        let connects = |address: &str| {
            network
                .within(|| TcpStream::connect(address).is_ok())
                .unwrap_or(false)
        };
        let process = Arc::new(Process::start_at(command, &address, &log, connects)?);
        let driver: Box<dyn Driver> = match kind {
            Kind::RawRelay | Kind::Relay => Box::new(RelayDriver::new(&address)),
            Kind::Mom | Kind::MomXml => {
                let form = if kind == Kind::Mom {
                    Form::Binary
                } else {
                    Form::Xml
                };
                let hub = network.within(|| Hub::broker(&address, form));
                hub.map_err(Error::io("the hub's network"))??.driver
            }
            Kind::Nats => Box::new(NatsDriver::new(&address)),
            Kind::Redis => Box::new(RedisDriver::new(&address)),
            Kind::Mosquitto => Box::new(MqttDriver::new(&address)),
            Kind::Zenoh => Box::new(ZenohDriver::new(&address)),
            Kind::Prosody => Box::new(XmppDriver::new(&address)),
        };
        Ok(Hub {
            name: kind.name().to_owned(),
            driver,
            process: Some(process),
        })
    }

    fn command(&self, kind: Kind, network: &Network, port: u16) -> Result<Command, Error> {
        let host = network.host();
        let listen = format!("{host}:{port}");
        let mut command = network.command(self.program(kind)?);
        match kind {
            Kind::Relay => command.args(["--listen", &listen]),
            Kind::RawRelay => command.args(["--listen", &listen, "--raw"]),
            Kind::Mom | Kind::MomXml => {
                command.arg("--config").arg(self.folder.path().join("mom.toml"));
                command.args(["--listen", &listen])
            }
            Kind::Nats => command.args(["--addr", host, "--port", &port.to_string()]),
            Kind::Redis => {
                command.args(["--bind", host, "--port", &port.to_string()]);
                command.args(["--save", "", "--appendonly", "no", "--protected-mode", "no"]);
                command
                    .args(["--maxclients", "12000", "--dir"])
                    .arg(self.scratch.path())
            }
            Kind::Mosquitto => {
                let text = format!(
                    "listener {port} {host}\nallow_anonymous true\npersistence false\nset_tcp_nodelay true\n\
                     max_queued_messages 0\nlog_dest none\nuser root\n"
                );
                command.arg("-c").arg(self.file("mosquitto.conf", &text)?)
            }
            Kind::Zenoh => {
                command.args(["--listen", &format!("tcp/{listen}"), "--no-multicast-scouting"]);
                command.args(["--rest-http-port", "none", "--cfg", "timestamping/enabled:false"]);
                command.args(["--cfg", "transport/unicast/max_sessions:20000"])
            }
            Kind::Prosody => {
                let text = prosody(host, port, self.scratch.path());
                command
                    .arg("--config")
                    .arg(self.file("prosody.cfg.lua", &text)?)
                    .arg("-F")
            }
        };
        Ok(command)
    }

    /// What is started.
    pub(crate) fn program(&self, kind: Kind) -> Result<&Path, Error> {
        let absent = || Error::Unexpected(format!("{} is not there", kind.name()));
        match kind {
            Kind::RawRelay | Kind::Relay => Ok(&self.relay),
            Kind::Mom | Kind::MomXml => Ok(&self.broker),
            _ => self.peers.get(&kind).map(PathBuf::as_path).ok_or_else(absent),
        }
    }

    /// Where peers' files go.
    pub(crate) fn scratch(&self) -> &Path {
        self.scratch.path()
    }

    /// The broker's configuration.
    pub(crate) fn broker_config(&self) -> Result<String, Error> {
        fs::read_to_string(self.folder.path().join("mom.toml")).map_err(Error::io("read mom.toml"))
    }

    /// A file beside it.
    pub(crate) fn broker_file(&self, name: &str, text: &str) -> Result<PathBuf, Error> {
        let path = self.folder.path().join(name);
        fs::write(&path, text).map_err(Error::io(format!("write {name}")))?;
        Ok(path)
    }

    pub(crate) fn file(&self, name: &str, text: &str) -> Result<PathBuf, Error> {
        let path = self.scratch.path().join(name);
        fs::write(&path, text).map_err(Error::io(format!("write {name}")))?;
        Ok(path)
    }
}

fn prosody(host: &str, port: u16, scratch: &Path) -> String {
    let scratch = scratch.display();
    format!(
        "run_as_root = true\npidfile = \"{scratch}/prosody.pid\"\ndata_path = \"{scratch}\"\n\
         network_backend = \"epoll\"\nlog = {{ {{ levels = {{ min = \"error\" }}, to = \"console\" }} }}\n\
         modules_enabled = {{ \"saslauth\" }}\nmodules_disabled = {{ \"s2s\", \"offline\", \"posix\" }}\n\
         c2s_require_encryption = false\nallow_unencrypted_plain_auth = true\nstorage = \"memory\"\n\
         c2s_interfaces = {{ \"{host}\" }}\nc2s_ports = {{ {port} }}\ns2s_ports = {{}}\nhttp_ports = {{}}\n\
         https_ports = {{}}\n\
         VirtualHost \"{HOST}\"\nauthentication = \"anonymous\"\n\
         Component \"{ROOMS}\" \"muc\"\nmuc_room_locking = false\nmuc_room_default_history_length = 0\n"
    )
}

/// The version of an installed package, without what Debian adds.
fn debian_version(package: &str) -> String {
    let output = Command::new("dpkg-query")
        .args(["-W", "-f", "${Version}", package])
        .output();
    let text = output.map_or_else(
        |_| String::new(),
        |output| String::from_utf8_lossy(&output.stdout).into_owned(),
    );
    text.split(['-', '+']).next().unwrap_or_default().to_owned()
}
