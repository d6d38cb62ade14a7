//! Which base stations a robot takes (W23).

use std::net::IpAddr;

/// The addresses of base stations that may drive a robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Access(Vec<IpAddr>);

impl Access {
    /// These, and no others.
    #[must_use]
    pub fn only(addresses: impl IntoIterator<Item = IpAddr>) -> Self {
        Self(
            addresses
                .into_iter()
                .map(|address| address.to_canonical())
                .collect(),
        )
    }

    /// Whether a base station of this address may drive the robot. An IPv4 address is the same when it comes over IPv6.
    #[must_use]
    pub fn admits(&self, address: IpAddr) -> bool {
        self.0.contains(&address.to_canonical())
    }
}

impl Default for Access {
    /// Those of the robot's own machine.
    fn default() -> Self {
        Self::only([
            IpAddr::V4(std::net::Ipv4Addr::LOCALHOST),
            IpAddr::V6(std::net::Ipv6Addr::LOCALHOST),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_those_listed_are_admitted() {
        let address = |text: &str| text.parse::<IpAddr>().expect("an address");
        let access = Access::only([address("192.168.1.5"), address("fd00::5")]);
        for (who, admitted) in [
            ("192.168.1.5", true),
            ("::ffff:192.168.1.5", true),
            ("fd00::5", true),
            ("192.168.1.6", false),
            ("127.0.0.1", false),
        ] {
            assert_eq!(access.admits(address(who)), admitted, "{who}");
        }
        assert!(Access::default().admits(address("127.0.0.1")));
        assert!(!Access::only([]).admits(address("127.0.0.1")));
    }
}
