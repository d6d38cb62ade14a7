//! The listeners: where they listen, what they take, and which proxies stand before them.

use std::fmt;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::str::FromStr;

use mom_net::{Protocol, TlsUse};
use serde::Deserialize;
use serde::de::value::MapAccessDeserializer;
use serde::de::{Deserializer, Error, MapAccess, Visitor};

/// One entry of `listen`: an address, or a table.
///
/// ```
/// use mom_config::ListenConfig;
/// let listen = ListenConfig::from("127.0.0.1:7666");
/// assert!(listen.proxy.is_empty() && !listen.takes.is_empty());
/// ```
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(remote = "Self", deny_unknown_fields, rename_all = "kebab-case")]
pub struct ListenConfig {
    /// The address with its port.
    pub address: String,
    /// The ways in that are open.
    #[serde(default = "all_protocols")]
    pub takes: Vec<Protocol>,
    /// Whether connections have TLS.
    #[serde(default)]
    pub tls: TlsUse,
    /// The proxies that begin each connection with a PROXY protocol header.
    #[serde(default)]
    pub proxy: Vec<Network>,
}

fn all_protocols() -> Vec<Protocol> {
    Protocol::ALL.to_vec()
}

impl From<String> for ListenConfig {
    fn from(address: String) -> ListenConfig {
        ListenConfig {
            address,
            takes: all_protocols(),
            tls: TlsUse::default(),
            proxy: Vec::new(),
        }
    }
}

impl From<&str> for ListenConfig {
    fn from(address: &str) -> ListenConfig {
        address.to_owned().into()
    }
}

impl From<SocketAddr> for ListenConfig {
    fn from(address: SocketAddr) -> ListenConfig {
        address.to_string().into()
    }
}

impl<'de> Deserialize<'de> for ListenConfig {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<ListenConfig, D::Error> {
        deserializer.deserialize_any(AddressOrTable)
    }
}

/// By hand: what serde makes of two shapes does not say what is wrong inside of one.
struct AddressOrTable;

impl<'de> Visitor<'de> for AddressOrTable {
    type Value = ListenConfig;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("an address with its port, or a table with one")
    }

    fn visit_str<E: Error>(self, address: &str) -> Result<ListenConfig, E> {
        Ok(address.into())
    }

    fn visit_map<A: MapAccess<'de>>(self, table: A) -> Result<ListenConfig, A::Error> {
        // The derived one, which reads the table only.
        ListenConfig::deserialize(MapAccessDeserializer::new(table))
    }
}

impl ListenConfig {
    /// What is wrong with it, each with its key.
    pub(crate) fn faults(&self, certificate: bool) -> Vec<(&'static str, String)> {
        let mut found = Vec::new();
        if let Err(text) = check_address(&self.address) {
            found.push(("address", text));
        }
        if self.takes.is_empty() {
            let all: Vec<&str> = Protocol::ALL.map(Protocol::word).to_vec();
            let text = format!(
                "a listener that takes nothing is of no use; name some of {}, or leave takes out for all",
                all.join(", ")
            );
            found.push(("takes", text));
        }
        if self.tls == TlsUse::Required && !certificate {
            let text = "TLS is required here, and there is no certificate: name one in [tls], or write tls = \"allowed\"";
            found.push(("tls", text.to_owned()));
        }
        found
    }

    /// What to connect to when it listens there.
    pub fn shown(&self, at: SocketAddr) -> String {
        let secure = match self.tls {
            TlsUse::Required => "s",
            TlsUse::Allowed | TlsUse::Refused => "",
        };
        let forms = [
            (Protocol::Xml, "tcp", "XML"),
            (Protocol::Json, "json", "JSON"),
            (Protocol::Binary, "bin", "binary"),
            (Protocol::Websocket, "ws", "WebSocket"),
            (Protocol::Tunnel, "http", "HTTP"),
        ];
        let open: Vec<String> = forms
            .into_iter()
            .filter(|(door, ..)| self.takes.contains(door))
            .map(|(_, scheme, name)| format!("{scheme}{secure}://{at} ({name})"))
            .collect();
        match open.is_empty() {
            true => at.to_string(),
            false => open.join(", "),
        }
    }
}

/// Addresses that begin alike: `10.0.0.0/8`, or one address.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub struct Network {
    address: IpAddr,
    prefix: u8,
}

impl Network {
    /// Whether an address is in it.
    ///
    /// ```
    /// # use mom_config::Network;
    /// let network: Network = "10.0.0.0/8".parse().unwrap();
    /// assert!(network.contains("10.1.2.3".parse().unwrap()));
    /// assert!(network.contains("::ffff:10.1.2.3".parse().unwrap()), "as a listener for both sees it");
    /// assert!(!network.contains("11.1.2.3".parse().unwrap()));
    /// ```
    pub fn contains(&self, address: IpAddr) -> bool {
        let address = address.to_canonical();
        address.is_ipv4() == self.address.is_ipv4() && masked(address, self.prefix) == self.address
    }
}

/// An address with all behind the prefix set to 0.
fn masked(address: IpAddr, prefix: u8) -> IpAddr {
    let prefix = u32::from(prefix);
    match address {
        IpAddr::V4(address) => {
            let mask = u32::MAX.checked_shl(32 - prefix).unwrap_or(0);
            IpAddr::V4(Ipv4Addr::from_bits(address.to_bits() & mask))
        }
        IpAddr::V6(address) => {
            let mask = u128::MAX.checked_shl(128 - prefix).unwrap_or(0);
            IpAddr::V6(Ipv6Addr::from_bits(address.to_bits() & mask))
        }
    }
}

impl FromStr for Network {
    type Err = String;

    fn from_str(text: &str) -> Result<Network, String> {
        let wrong =
            || format!("{text:?} is not an IP address or network, such as 10.0.0.7, 10.0.0.0/8 or fd00::/8");
        let (address, prefix) = match text.split_once('/') {
            Some((address, prefix)) => (address, Some(prefix)),
            None => (text, None),
        };
        let address: IpAddr = address.parse().map_err(|_| wrong())?;
        if address.to_canonical() != address {
            return Err(format!(
                "{text:?} is an IPv4 address; write it as {}",
                address.to_canonical()
            ));
        }
        let bits = if address.is_ipv4() { 32 } else { 128 };
        let prefix = match prefix {
            Some(prefix) => prefix
                .parse()
                .ok()
                .filter(|prefix| *prefix <= bits)
                .ok_or_else(wrong)?,
            None => bits,
        };
        if prefix == 0 {
            return Err(format!(
                "{text} is every address, and a trusted proxy names the client; name the proxies' own addresses"
            ));
        }
        let network = masked(address, prefix);
        match network == address {
            true => Ok(Network { address, prefix }),
            false => Err(format!(
                "{text} has bits behind its prefix; did you mean `{network}/{prefix}`?"
            )),
        }
    }
}

impl TryFrom<String> for Network {
    type Error = String;

    fn try_from(text: String) -> Result<Network, String> {
        text.parse()
    }
}

/// Checks an address to listen at.
///
/// # Errors
/// What is wrong with it.
pub fn check_address(address: &str) -> Result<(), String> {
    let example = "write it as 127.0.0.1:7666, or [::1]:7666";
    let Some((host, port)) = address.rsplit_once(':') else {
        return Err(format!("{address:?} has no port; {example}"));
    };
    if port.parse::<u16>().is_err() {
        return Err(format!(
            "a port is a whole number from 0 to 65535, not {port:?}; 0 takes any free one"
        ));
    }
    let named = |c: char| c.is_alphanumeric() || matches!(c, '-' | '.' | '_');
    let right = match host.strip_prefix('[').and_then(|host| host.strip_suffix(']')) {
        Some(inside) => inside.parse::<Ipv6Addr>().is_ok(),
        None if host.chars().all(|c| c.is_ascii_digit() || c == '.') => host.parse::<Ipv4Addr>().is_ok(),
        None => host.chars().all(named),
    };
    match right {
        true => Ok(()),
        false => Err(format!("{host:?} is not an address of this machine; {example}")),
    }
}
