//! Links to users of 1999 and of today, each between two network namespaces with a broker at its end.

use std::time::Duration;

use anyhow::{Context as _, Result};
use mom_net::{Address, ServerTls};
use mom_tests::network::{RelayedLink, Shape};
use mom_tests::tls;
use tempfile::TempDir;

use super::Settings;
use mom_benches::{Process, broker_folder};

/// A link, both ways alike. All of it is an input.
#[derive(Clone, Copy, Debug)]
pub(super) struct LinkKind {
    /// As it is called in tables.
    pub(super) name: &'static str,
    /// Bits per second.
    pub(super) rate: f64,
    /// From one end to the other, ms.
    pub(super) delay: u64,
}

/// The rates of the issue; the delays are those of a modem, of ISDN and of lines, each with a way around half the world.
pub(super) const LINKS: [LinkKind; 4] = [
    LinkKind {
        name: "33.6 kbit/s",
        rate: 33.6e3,
        delay: 220,
    },
    LinkKind {
        name: "64 kbit/s",
        rate: 64e3,
        delay: 170,
    },
    LinkKind {
        name: "1.5 Mbit/s",
        rate: 1.5e6,
        delay: 150,
    },
    LinkKind {
        name: "10 Mbit/s",
        rate: 10e6,
        delay: 150,
    },
];

/// What else a link does to packets.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trouble {
    /// Up to so much more delay for each packet, ms.
    pub(super) jitter: u64,
    /// The share of packets that are lost.
    pub(super) loss: f64,
}

/// A link with a broker at its end; both are gone with this.
pub(super) struct Far {
    link: RelayedLink,
    _broker: Process,
    _folder: TempDir,
    /// `HOST:PORT` of the broker.
    pub(super) hub: String,
    /// The fingerprint of its certificate.
    pub(super) pin: String,
}

impl Far {
    /// Makes the link, and starts a broker there. Only root may make links.
    pub(super) fn new(kind: LinkKind, trouble: Trouble, settings: &Settings) -> Result<Far> {
        let shape = Shape {
            rate: kind.rate,
            delay: Duration::from_millis(kind.delay),
            jitter: Duration::from_millis(trouble.jitter),
            loss: trouble.loss,
            // As the modems' own: seconds.
            queue: Duration::from_secs(4),
        };
        let link = RelayedLink::new(shape, shape, settings.seed, "cubic")
            .context("no network namespaces here: only root may make them")?;
        let folder = broker_folder()?;
        let identity = tls::make(folder.path(), "hub");
        let pin = ServerTls::from_files(&identity.certificate, &identity.key)?.fingerprint();
        let config = folder.path().join("mom.toml");
        // What each of four brokers warns of is the same, and nothing about the links.
        let text = std::fs::read_to_string(&config)?.replace("log = \"warn\"", "log = \"error\"");
        let tls = "[tls]\ncertificate = \"hub.crt\"\nkey = \"hub.key\"\n";
        std::fs::write(&config, format!("{text}\n{tls}"))?;
        let mut command = link.ends.hub.command(&settings.broker);
        let listen = format!("{}:0", link.ends.hub.host());
        command.arg("--config").arg(&config).args(["--listen", &listen]);
        // As the programs that it is compared with.
        command.env("MOM_NICENESS", "0");
        let broker = Process::start(command)?;
        Ok(Far {
            hub: broker.address().to_owned(),
            pin: pin.to_string(),
            link,
            _broker: broker,
            _folder: folder,
        })
    }

    /// The address of a door: with TLS it names the certificate.
    pub(super) fn address(&self, scheme: &str) -> String {
        let plain = format!("{scheme}://{}", self.hub);
        match plain.parse::<Address>() {
            Ok(address) if address.tls => format!("{plain}?pin={}", self.pin),
            _ => plain,
        }
    }

    /// Does something at the other end of the link.
    pub(super) fn afar<T: Send>(&self, what: impl Future<Output = Result<T>> + Send) -> Result<T> {
        let run = || -> Result<T> { super::runtime()?.block_on(what) };
        self.link.ends.far.within(run)?
    }
}

/// Does something over all links at once, each with a thread and a broker of its own.
pub(super) fn over_all<T: Send>(
    trouble: Trouble,
    settings: &Settings,
    what: impl Fn(&Far, LinkKind) -> Result<T> + Sync,
) -> Result<Vec<T>> {
    let what = &what;
    std::thread::scope(|scope| {
        let each = LINKS.map(|kind| scope.spawn(move || what(&Far::new(kind, trouble, settings)?, kind)));
        let results = each.into_iter().map(|link| link.join());
        results
            .map(|result| result.map_err(|_| anyhow::anyhow!("a panic at a link"))?)
            .collect()
    })
}

/// The inputs as a table.
pub(super) fn inputs(trouble: Trouble) -> String {
    let rows = LINKS
        .iter()
        .map(|link| format!("{} with {} ms", link.name, link.delay));
    format!(
        "**Inputs:** the links, both ways alike: {}; jitter up to {} ms, {} % of the packets lost; emulated by a packet relay between two \
         network namespaces, with the kernel's TCP at both ends.",
        rows.collect::<Vec<_>>().join(", "),
        trouble.jitter,
        trouble.loss * 100.0,
    )
}
