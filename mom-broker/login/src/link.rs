//! How a peer that logs in has come.

use std::net::IpAddr;

use mom_proto::Fingerprint;

/// How a peer that logs in has come.
#[derive(Clone, Copy, Debug, Default)]
pub struct LoginLink {
    /// From where, none inside this process.
    pub from: Option<IpAddr>,
    /// A proxy says so: even if that is this machine, the way from the proxy to here is not known.
    pub relayed: bool,
    /// Nobody between can read along, however far that is.
    pub private: bool,
    /// The certificate that it has shown and proved to have the key of.
    pub certificate: Option<Fingerprint>,
}

impl LoginLink {
    /// Whether nobody else can read what is said on it.
    pub fn is_private(&self) -> bool {
        // A dual-stack listener sees IPv4 loopback as an IPv4-mapped IPv6 address.
        let local = |from: IpAddr| from.to_canonical().is_loopback() && !self.relayed;
        self.private || self.from.is_none_or(local)
    }
}
