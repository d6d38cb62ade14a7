//! What a listener takes (M14).

use mom_proto::codec::Form;
use mom_proto::{Code, WireError};
use serde::Deserialize;

/// A way in, by the word that the configuration has for it. All of them share a port, and the first bytes tell them apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Protocol {
    /// Parcels in XML.
    Xml,
    /// Parcels in the binary form.
    Binary,
    /// Parcels in JSON.
    Json,
    /// Pages, health and figures.
    Http,
    /// Parcels in WebSocket.
    Websocket,
    /// Parcels in HTTP's requests and responses.
    Tunnel,
}

impl Protocol {
    /// All of them.
    pub const ALL: [Protocol; 6] = [
        Protocol::Xml,
        Protocol::Binary,
        Protocol::Json,
        Protocol::Http,
        Protocol::Websocket,
        Protocol::Tunnel,
    ];

    /// Its word in the configuration.
    pub fn word(self) -> &'static str {
        match self {
            Protocol::Xml => "xml",
            Protocol::Binary => "binary",
            Protocol::Json => "json",
            Protocol::Http => "http",
            Protocol::Websocket => "websocket",
            Protocol::Tunnel => "tunnel",
        }
    }

    fn bit(self) -> u8 {
        1 << self as u8
    }
}

impl From<Form> for Protocol {
    fn from(form: Form) -> Protocol {
        match form {
            Form::Xml => Protocol::Xml,
            Form::Binary | Form::Packed => Protocol::Binary,
            Form::Json => Protocol::Json,
        }
    }
}

/// Whether the connections of a listener have TLS.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TlsUse {
    /// Those that begin with it have it.
    #[default]
    Allowed,
    /// All have it.
    Required,
    /// None has it.
    Refused,
}

impl TlsUse {
    /// The words of the configuration.
    pub const WORDS: [&str; 3] = ["allowed", "required", "refused"];
}

/// What a listener takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Takes {
    protocols: u8,
    tls: TlsUse,
}

impl Default for Takes {
    fn default() -> Takes {
        Takes::new(&Protocol::ALL, TlsUse::Allowed)
    }
}

impl Takes {
    /// These ways in, with TLS or without.
    pub fn new(protocols: &[Protocol], tls: TlsUse) -> Takes {
        Takes {
            protocols: protocols.iter().fold(0, |all, protocol| all | protocol.bit()),
            tls,
        }
    }

    /// Whether this way in is open.
    pub fn has(self, protocol: Protocol) -> bool {
        self.protocols & protocol.bit() != 0
    }

    /// Checks a way in.
    ///
    /// # Errors
    /// `not-taken`, with what is taken.
    pub fn check(self, protocol: Protocol) -> Result<(), WireError> {
        if self.has(protocol) {
            return Ok(());
        }
        let taken: Vec<&str> = Protocol::ALL
            .into_iter()
            .filter(|protocol| self.has(*protocol))
            .map(Protocol::word)
            .collect();
        let text = format!(
            "this listener accepts {1}, not {0}; use one of these, or another address of this hub",
            protocol.word(),
            taken.join(", ")
        );
        Err(WireError::new(Code::NOT_TAKEN, text))
    }

    /// Checks whether requests of HTTP may come at all; for each of them its path tells what it is.
    pub(crate) fn check_http(self) -> Result<(), WireError> {
        let some = [Protocol::Websocket, Protocol::Tunnel]
            .into_iter()
            .any(|protocol| self.has(protocol));
        if some { Ok(()) } else { self.check(Protocol::Http) }
    }

    /// Checks whether a connection may go on with TLS, or without.
    pub(crate) fn check_tls(self, with: bool) -> Result<(), WireError> {
        let text = match (self.tls, with) {
            (TlsUse::Required, false) => {
                "this listener takes connections with TLS only; write the address with tcps:// or bins://, or use \
                 another address of this hub"
            }
            (TlsUse::Refused, true) => {
                "this listener takes connections without TLS only; use another address of this hub"
            }
            _ => return Ok(()),
        };
        Err(WireError::new(Code::NOT_TAKEN, text))
    }
}
