//! What a listener takes (M14).

use mom_proto::codec::Form;
use mom_proto::{Code, WireError};
use serde::Deserialize;

/// A way in, by the word that the configuration has for it. All of them share a port, and the first bytes tell them apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Door {
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

impl Door {
    /// All of them.
    pub const ALL: [Door; 6] = [
        Door::Xml,
        Door::Binary,
        Door::Json,
        Door::Http,
        Door::Websocket,
        Door::Tunnel,
    ];

    /// Its word in the configuration.
    pub fn word(self) -> &'static str {
        match self {
            Door::Xml => "xml",
            Door::Binary => "binary",
            Door::Json => "json",
            Door::Http => "http",
            Door::Websocket => "websocket",
            Door::Tunnel => "tunnel",
        }
    }

    fn bit(self) -> u8 {
        1 << self as u8
    }
}

impl From<Form> for Door {
    fn from(form: Form) -> Door {
        match form {
            Form::Xml => Door::Xml,
            Form::Binary => Door::Binary,
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
    doors: u8,
    tls: TlsUse,
}

impl Default for Takes {
    fn default() -> Takes {
        Takes::new(&Door::ALL, TlsUse::Allowed)
    }
}

impl Takes {
    /// These ways in, with TLS or without.
    pub fn new(doors: &[Door], tls: TlsUse) -> Takes {
        Takes {
            doors: doors.iter().fold(0, |all, door| all | door.bit()),
            tls,
        }
    }

    /// Whether this way in is open.
    pub fn has(self, door: Door) -> bool {
        self.doors & door.bit() != 0
    }

    /// Checks a way in.
    ///
    /// # Errors
    /// `not-taken`, with what is taken.
    pub fn check(self, door: Door) -> Result<(), WireError> {
        if self.has(door) {
            return Ok(());
        }
        let taken: Vec<&str> = Door::ALL
            .into_iter()
            .filter(|door| self.has(*door))
            .map(Door::word)
            .collect();
        let text = format!(
            "this listener does not take {} but {}; use one of these, or another address of this hub",
            door.word(),
            taken.join(", ")
        );
        Err(WireError::new(Code::NOT_TAKEN, text))
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
