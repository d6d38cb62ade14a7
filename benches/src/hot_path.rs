//! A whole broker in one thread, for counting what a parcel costs it.

use mom_broker::{Broker, Config};
use mom_net::{Address, Transceiver};
use mom_proto::codec::Frame;
use mom_proto::{Family, Limits, Map, Parcel, Path, Value};

use crate::{Error, broker_folder};

const CHANNEL: &str = "/bench";

/// One peer that sends small parcels over a socket to some others on theirs, one at a time, all in one thread, so
/// that the same things happen in the same order each time.
pub struct Delivery {
    sender: Transceiver,
    receivers: Vec<Transceiver>,
    message: Parcel,
}

impl Delivery {
    /// Sends so many, each heard by all receivers before the next.
    ///
    /// # Errors
    /// A broker that does not start, refuses, or says what it should not.
    pub fn run(receivers: usize, times: u64) -> Result<(), Error> {
        let folder = broker_folder()?;
        let config = Config::load(&folder.path().join("mom.toml"));
        let config = config.map_err(|error| Error::Unexpected(error.to_string()))?;
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(Error::io("a runtime"))?;
        runtime.block_on(async {
            let broker = Broker::start(config).await;
            let broker = broker.map_err(|error| Error::Unexpected(error.to_string()))?;
            let address = broker.local_addr().to_string();
            let mut delivery = Delivery::connect(&address, receivers).await?;
            for _ in 0..times {
                delivery.once().await?;
            }
            drop(delivery);
            broker.stop().await;
            Ok(())
        })
    }

    async fn connect(address: &str, count: usize) -> Result<Delivery, Error> {
        let sender = enter(address).await?;
        let mut receivers = Vec::new();
        for _ in 0..count {
            receivers.push(enter(address).await?);
        }
        let channel = Path::parse(CHANNEL).map_err(Error::hub("the channel's path"))?;
        let content = Value::Binary(vec![b'.'; 16].into());
        let mut message = Parcel::new(Family::Message, "state")
            .context(channel)
            .content(content);
        message.echo = Some(false);
        Ok(Delivery {
            sender,
            receivers,
            message,
        })
    }

    async fn once(&mut self) -> Result<(), Error> {
        let sent = self.sender.writer.send(self.message.clone()).await;
        sent.map_err(|error| Error::Unexpected(error.to_string()))?;
        for receiver in &mut self.receivers {
            let heard = hear(receiver).await?;
            if !heard.is(Family::Message, "state") {
                return Err(Error::Unexpected(format!("{heard:?}")));
            }
        }
        Ok(())
    }
}

async fn enter(address: &str) -> Result<Transceiver, Error> {
    let address: Address = format!("bin://{address}")
        .parse()
        .map_err(|error| Error::Unexpected(format!("{error}")))?;
    let link = mom_net::connect(&address, &Limits::default(), None).await;
    let mut link = link.map_err(|error| Error::Unexpected(error.to_string()))?;
    let login = Parcel::new(Family::Login, "login").context(Path::root());
    let channel = Path::parse(CHANNEL).map_err(Error::hub("the channel's path"))?;
    let join = Parcel::new(Family::Context, "join").context(channel);
    for request in [login.content(Map::new().with("guest", true)).id(1), join.id(2)] {
        let id = request.id;
        let sent = link.writer.send(request).await;
        sent.map_err(|error| Error::Unexpected(error.to_string()))?;
        let answer = hear(&mut link).await?;
        if answer.family != Family::Reply || answer.reference != id {
            return Err(Error::Unexpected(format!("{answer:?} in place of a reply")));
        }
    }
    Ok(link)
}

async fn hear(link: &mut Transceiver) -> Result<Parcel, Error> {
    match link.reader.next().await {
        Ok(Some(Frame::Parcel(parcel))) => Ok(*parcel),
        other => Err(Error::Unexpected(format!("{other:?} in place of a parcel"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everybody_hears_each_parcel() {
        Delivery::run(3, 5).unwrap();
    }
}
