//! What carries a dialogue.

use std::fmt;

use mom_broker::Broker;
use mom_net::{Address, ClientTls, Door, Transceiver, Trust};
use mom_proto::Limits;
use mom_proto::codec::Form;

use super::program::Client;

/// How the peers of a dialogue are connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Carrier {
    /// A form through a door, with TLS or without.
    Remote(Form, Door, bool),
    /// Inside the broker's process.
    Local,
    /// Each next peer by the next of them, so that senders and receivers differ.
    Mixed,
    /// The binary form through a door, with TLS or without, by a client in another language.
    Program(Client, Door, bool),
}

const STREAMED: Door = Door::Tunnel { polled: false };
const POLLED: Door = Door::Tunnel { polled: true };

/// What peers are mixed of: each form and each door, beside others that differ in both.
const MIX: [Carrier; 11] = [
    Carrier::Remote(Form::Xml, Door::Stream, false),
    Carrier::Remote(Form::Binary, Door::WebSocket, true),
    Carrier::Local,
    Carrier::Remote(Form::Binary, Door::Stream, false),
    Carrier::Remote(Form::Xml, STREAMED, true),
    Carrier::Remote(Form::Json, Door::WebSocket, false),
    Carrier::Remote(Form::Binary, Door::Stream, true),
    Carrier::Remote(Form::Json, Door::Stream, true),
    Carrier::Remote(Form::Xml, Door::Stream, true),
    Carrier::Remote(Form::Binary, POLLED, false),
    Carrier::Remote(Form::Binary, Door::WebSocket, false),
];

impl Carrier {
    /// Links the peer that comes after `before` others.
    pub(crate) async fn connect(self, broker: &Broker, before: usize) -> Result<Transceiver, String> {
        let (form, door, tls) = match self {
            Carrier::Remote(form, door, tls) => (form, door, tls),
            Carrier::Program(_, door, tls) => (Form::Binary, door, tls),
            Carrier::Local => return Ok(broker.connect_local()),
            Carrier::Mixed => return Box::pin(MIX[before % MIX.len()].connect(broker, before)).await,
        };
        let address = broker.local_addr();
        let address = Address {
            form,
            door,
            tls,
            host: address.ip().to_string(),
            port: address.port(),
            path: None,
            pin: broker.fingerprint().filter(|_| tls),
            any: false,
            port_named: true,
        };
        if let Carrier::Program(client, ..) = self {
            return client.connect(&address).await;
        }
        let trust = broker.fingerprint().map(Trust::Pinned).unwrap_or_default();
        let client = ClientTls::new(&trust, None).map_err(|error| error.to_string())?;
        mom_net::connect(&address, &Limits::default(), Some(&client))
            .await
            .map_err(|error| format!("cannot connect: {error}"))
    }
}

impl fmt::Display for Carrier {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Carrier::Local => formatter.write_str("in process"),
            Carrier::Mixed => formatter.write_str("mixed"),
            Carrier::Remote(form, door, tls) => {
                write!(formatter, "{} over {}", form.word(), way(*door, *tls))
            }
            Carrier::Program(client, door, tls) => {
                write!(formatter, "{} over {}", client.language, way(*door, *tls))
            }
        }
    }
}

fn way(door: Door, tls: bool) -> String {
    let door = match door {
        Door::Stream => "TCP",
        Door::WebSocket => "WebSocket",
        STREAMED => "a tunnel",
        Door::Tunnel { .. } => "a polled tunnel",
    };
    let tls = if tls { " with TLS" } else { "" };
    format!("{door}{tls}")
}
