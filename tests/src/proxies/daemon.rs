//! Proxies that people run, as children of the test: squid and tinyproxy of Debian.

use std::fs::{self, Permissions};
use std::io::{BufRead as _, BufReader, Read};
use std::net::{SocketAddr, TcpListener};
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::{Child, Stdio};
use std::sync::mpsc;

use tempfile::TempDir;

use crate::network::Network;
use crate::programs::PATIENCE;

/// Which proxy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The one of large networks.
    Squid,
    /// A small one, which asks in HTTP/1.0.
    Tinyproxy,
}

impl Kind {
    /// Both.
    pub const ALL: [Kind; 2] = [Kind::Squid, Kind::Tinyproxy];

    fn program(self) -> &'static str {
        match self {
            Kind::Squid => "/usr/sbin/squid",
            Kind::Tinyproxy => "/usr/bin/tinyproxy",
        }
    }

    /// What it says when it is there.
    fn ready(self) -> &'static str {
        match self {
            Kind::Squid => "Accepting HTTP Socket connections",
            Kind::Tinyproxy => "Accepting connections",
        }
    }

    fn config(self, address: SocketAddr, connects: bool, folder: &Path) -> String {
        let (host, port, folder) = (address.ip(), address.port(), folder.display());
        match (self, connects) {
            (Kind::Squid, _) => format!(
                "http_port {address}\n\
                 acl passing method CONNECT\n\
                 http_access {} passing\n\
                 http_access allow all\n\
                 cache deny all\n\
                 access_log none\n\
                 cache_log {folder}/cache.log\n\
                 coredump_dir {folder}\n\
                 netdb_filename none\n\
                 pid_filename none\n\
                 pinger_enable off\n\
                 visible_hostname proxy.example.org\n\
                 shutdown_lifetime 0 seconds\n",
                if connects { "allow" } else { "deny" }
            ),
            (Kind::Tinyproxy, _) => format!(
                "Listen {host}\nPort {port}\nTimeout 600\nMaxClients 100\nLogLevel Info\n{}",
                if connects { "" } else { "ConnectPort 0\n" }
            ),
        }
    }
}

/// A proxy that runs beside the test and is killed with it.
#[derive(Debug)]
pub struct Daemon {
    child: Child,
    address: SocketAddr,
    _folder: TempDir,
}

impl Daemon {
    /// Starts one in this network, on a port that is free there.
    ///
    /// # Panics
    /// If it does not start: `cargo xtask test --install` installs it.
    pub fn start(kind: Kind, network: &Network, connects: bool) -> Daemon {
        assert!(
            Path::new(kind.program()).exists(),
            "{} is missing; install it with: cargo xtask test --install",
            kind.program()
        );
        let mut said = String::new();
        // Another program may take the port before the proxy does.
        for _ in 0..5 {
            match Daemon::try_start(kind, network, connects) {
                Ok(daemon) => return daemon,
                Err(why) => said = why,
            }
        }
        panic!("{kind:?} does not start: {said}")
    }

    fn try_start(kind: Kind, network: &Network, connects: bool) -> Result<Daemon, String> {
        let free = network.within(|| TcpListener::bind((network.host(), 0))?.local_addr());
        let address = free.expect("the network is there").expect("a free port");
        let folder = tempfile::tempdir().expect("a folder");
        // Squid gives up being root, and writes its log then.
        fs::set_permissions(folder.path(), Permissions::from_mode(0o777)).expect("it is ours");
        let file = folder.path().join("proxy.conf");
        fs::write(&file, kind.config(address, connects, folder.path())).expect("written");
        let mut command = network.command(Path::new(kind.program()));
        match kind {
            Kind::Squid => command.args(["-N", "-d", "1", "-f"]).arg(&file),
            Kind::Tinyproxy => command.args(["-d", "-c"]).arg(&file),
        };
        command.stdin(Stdio::null());
        let mut child = command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("it can be started");
        let (lines, said) = mpsc::channel();
        if let Some(stdout) = child.stdout.take() {
            follow(stdout, lines.clone());
        }
        if let Some(stderr) = child.stderr.take() {
            follow(stderr, lines);
        }
        let daemon = Daemon {
            child,
            address,
            _folder: folder,
        };
        let mut heard = Vec::new();
        loop {
            match said.recv_timeout(PATIENCE) {
                Ok(line) if line.contains(kind.ready()) => return Ok(daemon),
                Ok(line) => heard.push(line),
                Err(_) => return Err(heard.join("\n")),
            }
        }
    }

    /// As it stands in `HTTP_PROXY`.
    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

/// Reads what is said to its end, so that nobody waits to say it.
fn follow(from: impl Read + Send + 'static, lines: mpsc::Sender<String>) {
    std::thread::spawn(move || {
        for line in BufReader::new(from).lines().map_while(Result::ok) {
            // Nobody listens any more when it is there.
            let _ = lines.send(line);
        }
    });
}

impl Drop for Daemon {
    fn drop(&mut self) {
        // It may have ended by itself; then there is nothing to kill.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
