//! A slow link between a hub and a subscriber, as the kernel's token bucket makes it.

use mom_benches::Error;
use mom_tests::network::{Namespaces, Network, ip};

/// The link of the saturated stop, as `tc` reads it; on the hub's side, towards the subscriber.
const SHAPE: [&str; 7] = ["tbf", "rate", "20mbit", "burst", "32kbit", "latency", "50ms"];
/// Its rate in bits per second, with all headers.
pub(crate) const LINK_RATE: f64 = 20e6;
const DEVICE: &str = "near";

/// Two namespaces and the link between them; gone with this.
#[derive(Debug)]
pub struct SlowLink {
    /// Both ends.
    pub ends: Namespaces,
}

impl SlowLink {
    /// Makes all of it.
    ///
    /// # Errors
    /// Where that is not allowed, or `ip` and `tc` are missing.
    pub fn new() -> Result<SlowLink, Error> {
        let make = || {
            let ends = Namespaces::new()?;
            if let (Network::Namespace(hub, _), Network::Namespace(far, _)) = (&ends.hub, &ends.far) {
                ip(&[
                    "link", "add", DEVICE, "netns", hub, "type", "veth", "peer", "name", DEVICE, "netns", far,
                ])?;
                let shape = ["netns", "exec", hub, "tc", "qdisc", "add", "dev", DEVICE, "root"];
                ends.connect(DEVICE, "cubic")?;
                ip(&[&shape[..], &SHAPE].concat())?;
            }
            Ok(SlowLink { ends })
        };
        make().map_err(Error::io("a slow link"))
    }
}
