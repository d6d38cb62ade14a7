//! The doors of a hub: ways to speak to it.

use mom_client::{Address, Fingerprint};

use crate::failure::Failure;

/// One way to speak to a hub.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct DoorTried {
    /// What people call it.
    pub(crate) name: &'static str,
    /// How addresses of it begin.
    pub(crate) scheme: &'static str,
    /// The first bytes of who comes through it without TLS, and an end of line, to hear what another server says to them.
    pub(crate) hello: &'static [u8],
}

/// All doors, each with TLS and without it.
pub(crate) const DOORS: &[DoorTried] = &[
    DoorTried {
        name: "binary",
        scheme: "bin",
        hello: b"\x8fMOM\r\n\r\n",
    },
    DoorTried {
        name: "XML",
        scheme: "tcp",
        hello: b"Content-\r\n\r\n",
    },
    DoorTried {
        name: "binary, TLS",
        scheme: "bins",
        hello: TLS,
    },
    DoorTried {
        name: "XML, TLS",
        scheme: "tcps",
        hello: TLS,
    },
    DoorTried {
        name: "WebSocket",
        scheme: "ws",
        hello: HTTP,
    },
    DoorTried {
        name: "WebSocket, TLS",
        scheme: "wss",
        hello: TLS,
    },
    DoorTried {
        name: "tunnel",
        scheme: "http",
        hello: HTTP,
    },
    DoorTried {
        name: "tunnel, TLS",
        scheme: "https",
        hello: TLS,
    },
];

const HTTP: &[u8] = b"GET / HTTP/1.0\r\n\r\n";

/// The beginning of a handshake.
const TLS: &[u8] = b"\x16\x03\x01\r\n\r\n";

/// A hub whose doors are tried.
#[derive(Clone, Debug)]
pub(crate) struct Target {
    /// Its name or number.
    pub(crate) host: String,
    /// The port of all doors.
    pub(crate) port: u16,
    /// The certificate that it has to show, regardless of its issuer.
    pub(crate) pin: Option<Fingerprint>,
}

impl Target {
    /// Reads `HOST`, `HOST:PORT`, either with `?pin=FINGERPRINT`, or a whole address, of which the scheme does not count.
    pub(crate) fn read(text: &str) -> Result<Target, Failure> {
        let rest = text.split_once("://").map_or(text, |(_, rest)| rest);
        // With TLS, so that it may have a fingerprint.
        let address: Address = format!("bins://{rest}").parse().map_err(|error| {
            Failure::usage(
                format!("wrong host: {error}"),
                "name it as mom doctor HOST, HOST:PORT or 'HOST:PORT?pin=FINGERPRINT'",
            )
        })?;
        Ok(Target {
            host: address.host,
            port: address.port,
            pin: address.pin,
        })
    }

    /// As people write it.
    pub(crate) fn name(&self) -> String {
        match self.host.contains(':') {
            true => format!("[{}]:{}", self.host, self.port),
            false => format!("{}:{}", self.host, self.port),
        }
    }

    /// The address of one of its doors.
    pub(crate) fn address(&self, door: &DoorTried) -> Result<Address, Failure> {
        let plain = format!("{}://{}", door.scheme, self.name());
        let mut address: Address = plain
            .parse()
            .map_err(|error| Failure::plain(format!("{plain} cannot be tried: {error}")))?;
        address.pin = self.pin.filter(|_| address.tls);
        Ok(address)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_door_has_an_address() {
        for (text, name) in [
            ("lab", "lab:7666"),
            ("lab:1", "lab:1"),
            ("tcp://lab:1/robot", "lab:1"),
            ("[::1]:5", "[::1]:5"),
        ] {
            let target = Target::read(text).unwrap();
            assert_eq!(target.name(), name);
            for door in DOORS {
                let address = target.address(door).unwrap();
                assert_eq!(address.to_string(), format!("{}://{name}", door.scheme));
                assert_eq!(address.tls, door.name.ends_with("TLS"), "{}", door.name);
            }
        }
        let pin = "0".repeat(64);
        let target = Target::read(&format!("lab?pin={pin}")).unwrap();
        let pins = DOORS
            .iter()
            .map(|door| target.address(door).unwrap().pin.is_some());
        assert_eq!(
            pins.collect::<Vec<_>>(),
            [false, false, true, true, false, true, false, true]
        );
        assert!(Target::read("no host").is_err() && Target::read("lab:x").is_err());
    }
}
