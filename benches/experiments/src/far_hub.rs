//! A broker with a configuration of the experiment's own, and a link of any rate and delay to a far user, or none.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context as _, Result};
use mom_net::ServerTls;
use mom_tests::network::{Network, RelayedLink, Shape};
use mom_tests::tls;
use tempfile::TempDir;

use super::Settings;
use mom_benches::Process;

/// What may wait at the bottleneck, as the time in which it leaves: a sender that fills it has filled it for seconds.
const QUEUE: Duration = Duration::from_secs(4);

/// A broker, and where its near and its far peers are; all of it is gone with this.
pub(super) struct FarHub {
    // Ends before the networks that it is in.
    broker: Process,
    link: Option<RelayedLink>,
    pin: String,
    /// Its configuration, and the logs of the programs beside it.
    folder: TempDir,
}

/// A shape that loses nothing and has no jitter.
pub(super) fn shape(rate: f64, delay: Duration) -> Shape {
    Shape {
        rate,
        queue: QUEUE,
        ..Shape::mbit(1.0, delay)
    }
}

impl FarHub {
    /// Starts the broker of the `mom.toml` in a folder, behind a link of this shape both ways; without one all is on loopback.
    /// Only root may make links.
    pub(super) fn new(shape: Option<Shape>, folder: TempDir, settings: &Settings) -> Result<FarHub> {
        let link = shape
            .map(|shape| RelayedLink::new(shape, shape, settings.seed, "cubic"))
            .transpose()
            .context("no network namespaces here: only root may make them")?;
        let identity = tls::make(folder.path(), "hub");
        let pin = ServerTls::from_files(&identity.certificate, &identity.key)?.fingerprint();
        let config = folder.path().join("mom.toml");
        let text = std::fs::read_to_string(&config)?;
        let tls = "[tls]\ncertificate = \"hub.crt\"\nkey = \"hub.key\"\n";
        std::fs::write(&config, format!("{text}\n{tls}"))?;
        let near = link.as_ref().map_or(&Network::Loopback, |link| &link.ends.hub);
        let mut command = near.command(&settings.broker);
        // Its own state, not this machine's.
        command
            .env_remove("STATE_DIRECTORY")
            .env("XDG_STATE_HOME", folder.path())
            // As the programs that it is compared with.
            .env("MOM_NICENESS", "0");
        let listen = format!("{}:0", near.host());
        command.arg("--config").arg(&config).args(["--listen", &listen]);
        Ok(FarHub {
            broker: Process::start(command)?,
            link,
            pin: pin.to_string(),
            folder,
        })
    }

    /// The network that the broker is in.
    pub(super) fn near(&self) -> &Network {
        self.link
            .as_ref()
            .map_or(&Network::Loopback, |link| &link.ends.hub)
    }

    /// The network at the other end of the link.
    fn far(&self) -> &Network {
        self.link
            .as_ref()
            .map_or(&Network::Loopback, |link| &link.ends.far)
    }

    /// The address of a door; one with TLS (`bins`) names the certificate.
    pub(super) fn address(&self, scheme: &str) -> String {
        let plain = format!("{scheme}://{}", self.broker.address());
        match scheme.ends_with('s') {
            true => format!("{plain}?pin={}", self.pin),
            false => plain,
        }
    }

    /// Starts a program beside the broker, and waits until its log says that it is ready.
    pub(super) fn start_near(
        &self,
        program: &Path,
        password: &str,
        args: &[&str],
        ready: &str,
    ) -> Result<Process> {
        let name = format!("{password}{}.log", args.concat());
        let log = self.folder.path().join(name);
        let mut command = self.near().command(program);
        command
            .args(args)
            .env("MOM_HUB", self.address("bins"))
            .env("MOM_PASSWORD", password);
        let said = |_: &str| std::fs::read_to_string(&log).is_ok_and(|text| text.contains(ready));
        Ok(Process::start_at(command, "", &log, said)?)
    }

    /// Does something at both ends at once, each with a runtime of its own.
    pub(super) fn at_both<A: Send, B: Send>(
        &self,
        near: impl Future<Output = Result<A>> + Send,
        far: impl Future<Output = Result<B>> + Send,
    ) -> Result<(A, B)> {
        std::thread::scope(|scope| {
            let far = scope.spawn(|| run_in(self.far(), far));
            let near = run_in(self.near(), near);
            let far = far
                .join()
                .map_err(|_| anyhow::anyhow!("a panic at the far end"))?;
            // The far end fails for want of the near one more often than the other way round.
            Ok((near?, far?))
        })
    }
}

fn run_in<T: Send>(network: &Network, what: impl Future<Output = Result<T>> + Send) -> Result<T> {
    network.within(|| super::runtime()?.block_on(what))?
}
