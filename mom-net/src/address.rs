//! Addresses of hubs (M21).

use std::fmt;

use mom_proto::Path;
use mom_proto::codec::Form;

use crate::NetError;

/// The port of the hub where an address names none.
pub const DEFAULT_PORT: u16 = 7666;

/// Where a hub is and how to speak to it: `tcp://host:port/path` for XML, `bin://…` for binary, `mom://…`
/// for whichever the client prefers, which is binary.
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
    /// A name or number of the host.
    pub host: String,
    /// The TCP port.
    pub port: u16,
    /// A context at that hub, if the address names one.
    pub path: Option<Path>,
}

impl std::str::FromStr for Address {
    type Err = NetError;

    fn from_str(text: &str) -> Result<Address, NetError> {
        let bad = || NetError::Address(text.to_owned());
        let (scheme, rest) = text.split_once("://").ok_or_else(bad)?;
        let form = match scheme {
            "tcp" => Form::Xml,
            "bin" | "mom" => Form::Binary,
            _ => return Err(bad()),
        };
        let (authority, path) = match rest.find('/') {
            Some(at) if rest.len() > at + 1 => (&rest[..at], Some(Path::parse(&rest[at..])?)),
            Some(at) => (&rest[..at], None),
            None => (rest, None),
        };
        // A colon inside brackets belongs to an IPv6 address.
        let (host, port) = match authority.rsplit_once(':') {
            Some((host, port)) if !port.ends_with(']') => (host, port.parse().map_err(|_| bad())?),
            _ => (authority, DEFAULT_PORT),
        };
        let host = host.trim_start_matches('[').trim_end_matches(']');
        if host.is_empty() {
            return Err(bad());
        }
        Ok(Address {
            form,
            host: host.to_owned(),
            port,
            path,
        })
    }
}

impl fmt::Display for Address {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = match self.form {
            Form::Xml => "tcp",
            Form::Binary => "bin",
        };
        match self.host.contains(':') {
            true => write!(formatter, "{scheme}://[{}]:{}", self.host, self.port)?,
            false => write!(formatter, "{scheme}://{}:{}", self.host, self.port)?,
        }
        match &self.path {
            Some(path) => path.fmt(formatter),
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
        ] {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), shown);
        }
        for bad in [
            "",
            "lab:7666",
            "http://lab",
            "tcp://",
            "tcp://:1",
            "tcp://lab:x",
            "tcp://lab:70000",
            "tcp://l//x",
        ] {
            assert!(bad.parse::<Address>().is_err(), "{bad}");
        }
    }
}
