//! What carries a dialogue.

use std::fmt;

use mom_broker::Broker;
use mom_net::{Address, Transceiver};
use mom_proto::Limits;
use mom_proto::codec::Form;

/// How the peers of a dialogue are connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Carrier {
    /// XML over TCP.
    Xml,
    /// Binary over TCP.
    Binary,
    /// Inside the broker's process.
    Local,
    /// Each next peer by the next of them, so that senders and receivers differ.
    Mixed,
}

impl Carrier {
    /// All of them.
    pub const ALL: [Carrier; 4] = [Carrier::Xml, Carrier::Binary, Carrier::Local, Carrier::Mixed];

    /// Links the peer that comes after `before` others.
    pub(crate) async fn connect(self, broker: &Broker, before: usize) -> Result<Transceiver, String> {
        let form = match self {
            Carrier::Xml => Form::Xml,
            Carrier::Binary => Form::Binary,
            Carrier::Local => return Ok(broker.connect_local()),
            Carrier::Mixed => {
                let one = [Carrier::Xml, Carrier::Binary, Carrier::Local][before % 3];
                return Box::pin(one.connect(broker, before)).await;
            }
        };
        let address = broker.local_addr();
        let address = Address {
            form,
            host: address.ip().to_string(),
            port: address.port(),
            path: None,
        };
        mom_net::connect(&address, &Limits::default())
            .await
            .map_err(|error| format!("cannot connect: {error}"))
    }
}

impl fmt::Display for Carrier {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Carrier::Xml => "over XML",
            Carrier::Binary => "over binary",
            Carrier::Local => "in process",
            Carrier::Mixed => "mixed",
        })
    }
}
