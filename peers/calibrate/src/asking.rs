//! Questions to a device in its channel.

use std::time::Duration;

use mom_client::{Channel, Client, Event, Events, Family, Map, Parcel, Path, Value, WireError};
use tokio::time::timeout;

use crate::VerbFailure;
use crate::failure::Doing as _;

/// How long a device may take for an answer.
pub(crate) const ANSWER: Duration = Duration::from_secs(10);

/// A channel with a device in it.
pub(crate) struct DeviceChannel {
    pub(crate) client: Client,
    pub(crate) events: Events,
    path: Path,
    /// It keeps the membership.
    _channel: Channel,
}

impl DeviceChannel {
    pub(crate) async fn join(client: &Client, path: &str) -> Result<DeviceChannel, VerbFailure> {
        let channel = client.channel(path).await.doing(format!("join {path}"))?;
        Ok(DeviceChannel {
            client: client.clone(),
            events: channel.events(),
            path: channel.path().clone(),
            _channel: channel,
        })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Sends a message and gives the id by which answers refer to it; none is here to take it = an error.
    pub(crate) async fn send(&self, mut message: Parcel, what: &str) -> Result<u64, VerbFailure> {
        message.context = Some(self.path.clone());
        message.echo = Some(false);
        // The receipt refers to the id that the client has given.
        message.receipt = Some(true);
        let receipt = self.client.request(message).await.doing(what)?;
        let delivered = receipt.value().get("delivered").and_then(Value::as_int);
        match receipt.reference.filter(|_| delivered != Some(0)) {
            Some(id) => Ok(id),
            None => Err(self.nobody()),
        }
    }

    /// Sends a message and gives the content of the device's answer to it; a message `…-refused` is its refusal.
    pub(crate) async fn ask(&mut self, name: &str, content: Map, what: &str) -> Result<Value, VerbFailure> {
        let question = Parcel::new(Family::Message, name).content(content);
        let id = self.send(question, what).await?;
        let answer = async {
            while let Some(event) = self.events.next().await {
                if let Event::Message(parcel) = event
                    && parcel.reference == Some(id)
                    && is_mine(&parcel, &self.client)
                {
                    return Ok(parcel);
                }
            }
            Err(closed())
        };
        let answer = match timeout(ANSWER, answer).await {
            Ok(answer) => answer?,
            Err(_) => return Err(self.nobody()),
        };
        match answer.name().ends_with("-refused") {
            true => Err(VerbFailure::Refused {
                what: what.to_owned(),
                error: refusal(&answer.value()),
            }),
            false => Ok(answer.value()),
        }
    }

    pub(crate) fn nobody(&self) -> VerbFailure {
        let text = format!("no device answers in {} within {} s", self.path, ANSWER.as_secs());
        VerbFailure::new(text, "see who is there: mom tree")
    }
}

pub(crate) fn closed() -> VerbFailure {
    VerbFailure::plain("the connection to the hub is closed")
}

/// Each peer counts its own ids, so an answer that goes to all names whose it refers to.
fn is_mine(parcel: &Parcel, client: &Client) -> bool {
    let content = parcel.value();
    let by = content.get("by").and_then(Value::as_str);
    by.is_none_or(|by| by == client.name())
}

/// A device's refusal.
pub(crate) fn refusal(content: &Value) -> WireError {
    WireError::from_map(content.as_map().unwrap_or(&Map::new()))
}
