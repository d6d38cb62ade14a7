//! Addresses of hubs (M21).

use std::fmt;

use mom_proto::codec::Form;
use mom_proto::{BadFingerprint, Fingerprint, Path};

use crate::NetError;

/// The port of the hub where an address names none.
pub const DEFAULT_PORT: u16 = 7666;

/// Where a hub is and how to speak to it: `tcp://host:port/path` for XML, `bin://…` for binary, `json://…`
/// for JSON, `mom://…` for whichever the client prefers, which is binary; with TLS `tcps://…`, `bins://…`, `jsons://…`
/// and `moms://…`, which may end in `?pin=` and the fingerprint of the hub's certificate.
///
/// ```
/// use mom_net::Address;
/// let address: Address = "tcp://127.0.0.1/robot".parse().unwrap();
/// assert_eq!((address.port, address.path.unwrap().as_str()), (7666, "/robot"));
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// The form to speak.
    pub form: Form,
    /// With TLS.
    pub tls: bool,
    /// A name or number of the host.
    pub host: String,
    /// The TCP port.
    pub port: u16,
    /// A context at that hub, if the address names one.
    pub path: Option<Path>,
    /// The certificate that the hub has to show.
    pub pin: Option<Fingerprint>,
}

impl std::str::FromStr for Address {
    type Err = NetError;

    fn from_str(text: &str) -> Result<Address, NetError> {
        read(text).map_err(|why| NetError::Address {
            text: text.to_owned(),
            why,
        })
    }
}

/// Reads an address, or says what is wrong with it.
fn read(text: &str) -> Result<Address, String> {
    let (scheme, rest) = text
        .split_once("://")
        .ok_or("it does not begin with bin:// or tcp://")?;
    let (form, tls) = match scheme {
        "tcp" => (Form::Xml, false),
        "tcps" => (Form::Xml, true),
        "bin" | "mom" => (Form::Binary, false),
        "bins" | "moms" => (Form::Binary, true),
        "json" => (Form::Json, false),
        "jsons" => (Form::Json, true),
        _ => return Err(format!("no hub is spoken to by {scheme}://")),
    };
    let (rest, pin) = match rest.split_once('?') {
        Some((rest, query)) if tls => (rest, Some(read_pin(query)?)),
        Some(_) => return Err(format!("a fingerprint is for TLS: {scheme}s://")),
        None => (rest, None),
    };
    let (authority, path) = match rest.find('/') {
        Some(at) if rest.len() > at + 1 => {
            let path = Path::parse(&rest[at..]);
            let path = path.map_err(|error| format!("its path is none: {}", error.text))?;
            (&rest[..at], Some(path))
        }
        Some(at) => (&rest[..at], None),
        None => (rest, None),
    };
    // A colon inside brackets belongs to an IPv6 address.
    let (host, port) = match authority.rsplit_once(':') {
        Some((host, port)) if !port.ends_with(']') => (host, read_port(port)?),
        _ => (authority, DEFAULT_PORT),
    };
    let inside = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
    let named = |c: char| c.is_alphanumeric() || matches!(c, '-' | '.' | '_');
    match (inside, host) {
        (None, "") => Err("it names no host".to_owned()),
        (None, _) if host.contains(':') => Err("an IPv6 address stands in brackets, as [::1]".to_owned()),
        (None, _) if !host.chars().all(named) => Err(format!("{host:?} is no name of a host")),
        (Some(inside), _) if !inside.contains(':') => {
            Err("brackets are for IPv6 addresses, as [::1]".to_owned())
        }
        _ => Ok(Address {
            form,
            tls,
            host: inside.unwrap_or(host).to_owned(),
            port,
            path,
            pin,
        }),
    }
}

/// Reads `pin=FINGERPRINT`, or says what is wrong with it.
fn read_pin(query: &str) -> Result<Fingerprint, String> {
    let pin = query
        .strip_prefix("pin=")
        .ok_or("after ? comes pin= and a fingerprint")?;
    pin.parse().map_err(|error: BadFingerprint| error.to_string())
}

/// Reads a port, or says what is wrong with it.
fn read_port(text: &str) -> Result<u16, String> {
    match text {
        "" => Err("its port is missing after the colon".to_owned()),
        _ => text
            .parse()
            .map_err(|_| format!("a port is a number from 0 to 65535, not {text:?}")),
    }
}

impl fmt::Display for Address {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = match (self.form, self.tls) {
            (Form::Xml, false) => "tcp",
            (Form::Xml, true) => "tcps",
            (Form::Binary, false) => "bin",
            (Form::Binary, true) => "bins",
            (Form::Json, false) => "json",
            (Form::Json, true) => "jsons",
        };
        match self.host.contains(':') {
            true => write!(formatter, "{scheme}://[{}]:{}", self.host, self.port)?,
            false => write!(formatter, "{scheme}://{}:{}", self.host, self.port)?,
        }
        if let Some(path) = &self.path {
            path.fmt(formatter)?;
        }
        match &self.pin {
            Some(pin) => write!(formatter, "?pin={pin}"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses() {
        for (text, shown) in [
            ("tcp://127.0.0.1:7666", "tcp://127.0.0.1:7666"),
            ("bin://lab", "bin://lab:7666"),
            ("mom://lab:1/robot/arm", "bin://lab:1/robot/arm"),
            ("tcp://[::1]:5/", "tcp://[::1]:5"),
            ("tcp://[::1]", "tcp://[::1]:7666"),
            ("tcps://lab", "tcps://lab:7666"),
            ("moms://lab/robot", "bins://lab:7666/robot"),
            ("json://lab/robot", "json://lab:7666/robot"),
            ("jsons://[::1]:5", "jsons://[::1]:5"),
            (
                "moms://lab/robot?pin=4355a46b19d348dc2f57c046f8ef63d4538ebb936000f3c9ee954a27460dd865",
                "bins://lab:7666/robot?pin=sha256:4355a46b19d348dc2f57c046f8ef63d4538ebb936000f3c9ee954a27460dd865",
            ),
        ] {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), shown);
        }
        for (bad, why) in [
            ("", "begin with"),
            ("lab:7666", "begin with"),
            ("http://lab", "http://"),
            ("tcp://", "no host"),
            ("tcp://:1", "no host"),
            ("tcp://lab:", "port is missing"),
            ("tcp://lab:x", "from 0 to 65535"),
            ("tcp://lab:70000", "from 0 to 65535"),
            ("tcp://l//x", "path"),
            ("bin://no host:1", "no name of a host"),
            ("bin://alice@lab:1", "no name of a host"),
            ("bin://::1:7666", "brackets"),
            ("bin://[lab]:7666", "brackets"),
            ("bins://lab?pin=12", "64 hexadecimal digits"),
            ("bins://lab?name=12", "pin="),
            ("bin://lab?pin=12", "bins://"),
        ] {
            let error = bad.parse::<Address>().unwrap_err().to_string();
            assert!(error.contains(why), "{bad}: {error}");
        }
    }
}
