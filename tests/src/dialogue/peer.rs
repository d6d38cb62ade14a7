//! One end of a link as a dialogue drives it.

use std::collections::BTreeMap;
use std::time::Duration;

use mom_net::Transceiver;
use mom_proto::codec::Frame;
use mom_proto::{Family, Fence, Parcel, STOP, Value};
use tokio::time::timeout;

use super::say::Request;

/// What is to be heard is there at once; this is when a test gives up, not how long it takes.
const PATIENCE: Duration = Duration::from_secs(20);

/// A peer of a dialogue.
#[derive(Debug)]
pub(crate) struct Peer {
    link: Transceiver,
    last_id: u64,
    /// Requests that were not answered yet, and whether they have to be.
    open: BTreeMap<u64, bool>,
}

/// What came over a link.
#[derive(Debug)]
pub(crate) enum Heard {
    Parcel(Box<Parcel>),
    Closed,
}

impl Peer {
    pub(crate) fn new(link: Transceiver) -> Peer {
        Peer {
            link,
            last_id: 0,
            open: BTreeMap::new(),
        }
    }

    /// Says something under the next id.
    pub(crate) async fn say(&mut self, request: &Request, epoch: u64) -> Result<(), String> {
        self.last_id += 1;
        let mut parcel = request.parcel.clone();
        parcel.id = Some(self.last_id);
        parcel.fence = parcel.fence.map(|number| u64::from(Fence::new(epoch, number)));
        if let Some(Value::Int(number)) = parcel.extra.get(STOP) {
            let number = u64::try_from(*number).unwrap_or_default();
            parcel.extra.set(STOP, Fence::new(epoch, number));
        }
        self.open.insert(self.last_id, request.answered);
        self.link
            .writer
            .send(parcel)
            .await
            .map_err(|error| format!("it cannot be said: {error}"))
    }

    /// What comes next, heartbeats aside.
    pub(crate) async fn hear(&mut self) -> Result<Heard, String> {
        loop {
            let frame = timeout(PATIENCE, self.link.reader.next())
                .await
                .map_err(|_| format!("nothing was heard for {} s", PATIENCE.as_secs()))?;
            match frame {
                Ok(Some(Frame::Parcel(parcel))) if parcel.is(Family::Time, "ping") => {}
                Ok(Some(Frame::Parcel(parcel))) => return Ok(Heard::Parcel(parcel)),
                Ok(Some(Frame::Malformed { error, .. })) => {
                    return Err(format!("the hub sent what is not a parcel: {error}"));
                }
                // A link that the hub has closed with something unread is reset.
                Ok(None) | Err(mom_net::NetError::Io(_)) => return Ok(Heard::Closed),
                Err(error) => return Err(format!("the hub sent what is not a frame: {error}")),
            }
        }
    }

    /// Notes that a request was answered: each is answered once.
    pub(crate) fn settle(&mut self, parcel: &Parcel) -> Result<(), String> {
        let answers =
            matches!(parcel.family, Family::Reply | Family::Error) || parcel.is(Family::Time, "pong");
        match parcel.reference {
            _ if !answers => Ok(()),
            None => Ok(()),
            Some(reference) => match self.open.remove(&reference) {
                Some(_) => Ok(()),
                None => Err(format!(
                    "there is no open request {reference} that this would answer"
                )),
            },
        }
    }

    /// That every request was answered.
    pub(crate) fn all_answered(&self) -> Result<(), String> {
        match self.open.iter().find(|(_, answered)| **answered) {
            None => Ok(()),
            Some((id, _)) => Err(format!("its request {id} was never answered")),
        }
    }
}
