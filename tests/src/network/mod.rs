//! Networks for tests and measurements: loopback, or two namespaces with a link between them.
#![expect(
    unsafe_code,
    reason = "entering a namespace has no safe wrapper among our libraries"
)]

mod line;
mod relay;

use std::ffi::OsStr;
use std::fs::File;
use std::io;
use std::os::fd::AsRawFd;
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;

pub use line::{Line, Passed, Shape};
pub use relay::PacketRelay;

/// The device at each end of a link.
const DEVICE: &str = "mom";

/// A network of this machine that programs run in and sockets belong to.
#[derive(Debug)]
pub enum Network {
    /// This machine's loopback.
    Loopback,
    /// A network namespace of this name, with this address.
    Namespace(String, String),
}

impl Network {
    /// The address to listen at here.
    pub fn host(&self) -> &str {
        match self {
            Network::Loopback => "127.0.0.1",
            Network::Namespace(_, address) => address,
        }
    }

    /// A program that will run here.
    pub fn command(&self, program: &Path) -> Command {
        match self {
            Network::Loopback => Command::new(program),
            Network::Namespace(name, _) => {
                let mut command = Command::new("ip");
                command.args(["netns", "exec", name]).arg(program);
                command
            }
        }
    }

    /// Does something with sockets that then belong here.
    ///
    /// # Errors
    /// A namespace that cannot be entered.
    pub fn within<T: Send>(&self, what: impl FnOnce() -> T + Send) -> io::Result<T> {
        let Network::Namespace(name, _) = self else {
            return Ok(what());
        };
        let entered = || -> io::Result<()> {
            let file = File::open(Path::new("/var/run/netns").join(name))?;
            // SAFETY: the descriptor is open for the whole call, and only this thread changes its namespace.
            match unsafe { libc::setns(file.as_raw_fd(), libc::CLONE_NEWNET) } {
                0 => Ok(()),
                _ => Err(io::Error::last_os_error()),
            }
        };
        // A thread of its own, which ends in there, so that no other ever finds itself elsewhere.
        let done = thread::scope(|scope| {
            let inside = scope.spawn(|| entered().map(|()| what()));
            inside.join()
        });
        done.map_err(|_| io::Error::other("a panic in a namespace"))?
    }
}

/// Two namespaces with loopback devices; gone with this.
#[derive(Debug)]
pub struct Namespaces {
    /// Where the hub is.
    pub hub: Network,
    /// Where its peer is.
    pub far: Network,
}

impl Namespaces {
    /// Makes both, named after this process.
    ///
    /// # Errors
    /// Where that is not allowed, or `ip` is missing.
    pub fn new() -> io::Result<Namespaces> {
        static MADE: AtomicU32 = AtomicU32::new(0);
        let id = format!("{}-{}", std::process::id(), MADE.fetch_add(1, Ordering::Relaxed));
        let names = [format!("mom-hub-{id}"), format!("mom-far-{id}")];
        let [hub, far] = &names;
        // From here on whatever was made is taken away again.
        let made = Namespaces {
            hub: Network::Namespace(hub.clone(), "10.66.0.1".to_owned()),
            far: Network::Namespace(far.clone(), "10.66.0.2".to_owned()),
        };
        for name in &names {
            ip(&["netns", "add", name])?;
            ip(&["-n", name, "link", "set", "lo", "up"])?;
        }
        Ok(made)
    }

    /// Gives the devices of this name their addresses, and has TCP find its rate by this algorithm: Linux's default is cubic,
    /// whatever this machine uses.
    ///
    /// # Errors
    /// Where they are missing, or the algorithm.
    pub fn connect(&self, device: &str, congestion: &str) -> io::Result<()> {
        for network in [&self.hub, &self.far] {
            if let Network::Namespace(name, address) = network {
                ip(&["-n", name, "addr", "add", &format!("{address}/24"), "dev", device])?;
                ip(&["-n", name, "link", "set", device, "up"])?;
                let route = [
                    "route",
                    "change",
                    "10.66.0.0/24",
                    "dev",
                    device,
                    "congctl",
                    congestion,
                ];
                ip(&[&["-n", name][..], &route].concat())?;
            }
        }
        Ok(())
    }
}

impl Drop for Namespaces {
    fn drop(&mut self) {
        for network in [&self.hub, &self.far] {
            if let Network::Namespace(name, _) = network {
                // One that was never made cannot be taken away.
                let _ = ip(&["netns", "del", name]);
            }
        }
    }
}

/// A hub's network and a far one, and a packet relay between them.
#[derive(Debug)]
pub struct RelayedLink {
    /// The relay: `there` is the way from the hub to the far side.
    pub relay: PacketRelay,
    /// Both networks.
    pub ends: Namespaces,
}

impl RelayedLink {
    /// Makes both networks, and carries packets between them; the same seed loses the same packets.
    ///
    /// # Errors
    /// Where that is not allowed, or `ip` is missing.
    pub fn new(there: Shape, back: Shape, seed: u64, congestion: &str) -> io::Result<RelayedLink> {
        let ends = Namespaces::new()?;
        let open = |network: &Network| network.within(|| relay::open_tun(DEVICE)).flatten();
        let devices = [open(&ends.hub)?, open(&ends.far)?];
        ends.connect(DEVICE, congestion)?;
        let relay = PacketRelay::start(devices, there, back, seed)?;
        Ok(RelayedLink { relay, ends })
    }
}

/// Runs `ip` with these words.
///
/// # Errors
/// What it says on standard error.
pub fn ip<S: AsRef<OsStr>>(words: &[S]) -> io::Result<()> {
    let output = Command::new("ip").args(words).output()?;
    match output.status.success() {
        true => Ok(()),
        false => Err(io::Error::other(
            String::from_utf8_lossy(&output.stderr).trim().to_owned(),
        )),
    }
}
