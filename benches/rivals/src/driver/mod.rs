//! The drivers of other brokers: how their peers connect, what they send, how they find parcels in what they receive.

mod mqtt;
mod nats;
mod redis;
mod xmpp;
mod zenoh;

use std::time::Instant;

use mom_benches::{Error, Link, PATIENCE};

pub use mqtt::MqttDriver;
pub use nats::NatsDriver;
pub use redis::RedisDriver;
pub use xmpp::XmppDriver;
pub(crate) use xmpp::{HOST, ROOMS};
pub use zenoh::ZenohDriver;

/// Reads until what was received holds `mark`; takes away everything up to its end, and gives it.
fn until(link: &mut Link, mark: &[u8]) -> Result<Vec<u8>, Error> {
    let start = Instant::now();
    while start.elapsed() < PATIENCE {
        let found = memchr::memmem::find(&link.received, mark);
        if let Some(at) = found {
            return Ok(link.received.drain(..at + mark.len()).collect());
        }
        link.receive()?;
    }
    Err(Error::Stalled {
        what: format!("{:?}", String::from_utf8_lossy(mark)),
        after: PATIENCE,
    })
}
