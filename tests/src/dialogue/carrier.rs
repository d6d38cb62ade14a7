//! What carries a dialogue.

use std::fmt;

use mom_broker::Broker;
use mom_net::{Address, ClientTls, Transceiver, Trust};
use mom_proto::Limits;
use mom_proto::codec::Form;

/// How the peers of a dialogue are connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Carrier {
    /// XML over TCP.
    Xml,
    /// Binary over TCP.
    Binary,
    /// JSON over TCP.
    Json,
    /// XML over TLS.
    XmlTls,
    /// Binary over TLS.
    BinaryTls,
    /// JSON over TLS.
    JsonTls,
    /// Inside the broker's process.
    Local,
    /// Each next peer by the next of them, so that senders and receivers differ.
    Mixed,
}

impl Carrier {
    /// All of them.
    pub const ALL: [Carrier; 8] = [
        Carrier::Xml,
        Carrier::Binary,
        Carrier::Json,
        Carrier::XmlTls,
        Carrier::BinaryTls,
        Carrier::JsonTls,
        Carrier::Local,
        Carrier::Mixed,
    ];

    /// Links the peer that comes after `before` others.
    pub(crate) async fn connect(self, broker: &Broker, before: usize) -> Result<Transceiver, String> {
        let (form, tls) = match self {
            Carrier::Xml => (Form::Xml, false),
            Carrier::Binary => (Form::Binary, false),
            Carrier::Json => (Form::Json, false),
            Carrier::XmlTls => (Form::Xml, true),
            Carrier::BinaryTls => (Form::Binary, true),
            Carrier::JsonTls => (Form::Json, true),
            Carrier::Local => return Ok(broker.connect_local()),
            Carrier::Mixed => {
                let one = [
                    Carrier::Xml,
                    Carrier::BinaryTls,
                    Carrier::Json,
                    Carrier::Local,
                    Carrier::Binary,
                    Carrier::JsonTls,
                    Carrier::XmlTls,
                ][before % 7];
                return Box::pin(one.connect(broker, before)).await;
            }
        };
        let address = broker.local_addr();
        let address = Address {
            form,
            tls,
            host: address.ip().to_string(),
            port: address.port(),
            path: None,
            pin: None,
        };
        let trust = broker.fingerprint().map(Trust::Pinned).unwrap_or_default();
        let client = ClientTls::new(&trust, None).map_err(|error| error.to_string())?;
        mom_net::connect(&address, &Limits::default(), Some(&client))
            .await
            .map_err(|error| format!("cannot connect: {error}"))
    }
}

impl fmt::Display for Carrier {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Carrier::Xml => "over XML",
            Carrier::Binary => "over binary",
            Carrier::Json => "over JSON",
            Carrier::XmlTls => "over XML and TLS",
            Carrier::BinaryTls => "over binary and TLS",
            Carrier::JsonTls => "over JSON and TLS",
            Carrier::Local => "in process",
            Carrier::Mixed => "mixed",
        })
    }
}
