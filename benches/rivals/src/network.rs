//! The networks in which hubs run and from which peers connect: loopback, or two namespaces with a slow link between them.
#![expect(
    unsafe_code,
    reason = "entering a namespace has no safe wrapper among our libraries"
)]

use std::ffi::OsStr;
use std::fs::File;
use std::io;
use std::os::fd::AsRawFd;
use std::path::Path;
use std::process::Command;
use std::thread;

use mom_benches::Error;

/// The link of the saturated stop, as `tc` reads it; on the hub's side, towards the subscriber.
const SHAPE: [&str; 7] = ["tbf", "rate", "20mbit", "burst", "32kbit", "latency", "50ms"];
/// Its rate in bits per second, with all headers.
pub(crate) const LINK_RATE: f64 = 20e6;

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
    pub fn within<T: Send>(&self, what: impl FnOnce() -> T + Send) -> Result<T, Error> {
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
        let done = done.map_err(|_| Error::Unexpected("a panic in a namespace".to_owned()))?;
        done.map_err(Error::io(format!("enter the namespace {name}")))
    }
}

/// Two namespaces and the link between them; gone with this.
#[derive(Debug)]
pub struct SlowLink {
    /// Where the hub and the senders are.
    pub hub: Network,
    /// Where the subscriber is.
    pub far: Network,
}

impl SlowLink {
    /// Makes both, named after this process.
    ///
    /// # Errors
    /// Where that is not allowed, or `ip` and `tc` are missing.
    pub fn new() -> Result<SlowLink, Error> {
        let id = std::process::id();
        let names = [format!("mom-hub-{id}"), format!("mom-far-{id}")];
        let [hub, far] = &names;
        let addresses = [(hub, "10.66.0.1"), (far, "10.66.0.2")];
        let [hub_network, far_network] =
            addresses.map(|(name, address)| Network::Namespace(name.clone(), address.to_owned()));
        // From here on whatever was made is taken away again.
        let link = SlowLink {
            hub: hub_network,
            far: far_network,
        };
        ip(&["netns", "add", hub])?;
        ip(&["netns", "add", far])?;
        ip(&[
            "link", "add", "near", "netns", hub, "type", "veth", "peer", "name", "near", "netns", far,
        ])?;
        for (name, address) in addresses {
            ip(&["-n", name, "addr", "add", &format!("{address}/24"), "dev", "near"])?;
            ip(&["-n", name, "link", "set", "near", "up"])?;
            ip(&["-n", name, "link", "set", "lo", "up"])?;
        }
        let shape = [
            &["netns", "exec", hub, "tc", "qdisc", "add", "dev", "near", "root"][..],
            &SHAPE,
        ]
        .concat();
        ip(&shape)?;
        Ok(link)
    }
}

impl Drop for SlowLink {
    fn drop(&mut self) {
        for network in [&self.hub, &self.far] {
            if let Network::Namespace(name, _) = network {
                // One that was never made cannot be taken away.
                let _ = ip(&["netns", "del", name]);
            }
        }
    }
}

fn ip<S: AsRef<OsStr>>(words: &[S]) -> Result<(), Error> {
    let output = Command::new("ip").args(words).output().map_err(Error::io("ip"))?;
    match output.status.success() {
        true => Ok(()),
        false => Err(Error::Unexpected(
            String::from_utf8_lossy(&output.stderr).trim().to_owned(),
        )),
    }
}
