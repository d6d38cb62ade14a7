//! Questions to a device in its channel.

use std::time::Duration;

use mom_client::{Channel, Client, ClientError, Event, Events, Family, Map, Parcel, Path, Value, WireError};
use tokio::time::timeout;

use crate::VerbFailure;
use crate::failure::Doing as _;

/// What to do where nobody answers.
const SEE: &str = "see who is there: mom tree";

/// How long a device may take for an answer.
pub const ANSWER: Duration = Duration::from_secs(10);

/// A channel with a device in it.
#[derive(Debug, Clone)]
pub struct DeviceChannel {
    client: Client,
    channel: Channel,
}

impl DeviceChannel {
    /// Joins it.
    ///
    /// # Errors
    /// The hub's refusal, a lost connection.
    pub async fn join(client: &Client, path: &str) -> Result<DeviceChannel, VerbFailure> {
        let channel = client.channel(path).await.doing(format!("join {path}"))?;
        Ok(DeviceChannel::of(client, channel))
    }

    /// One that is joined.
    #[must_use]
    pub fn of(client: &Client, channel: Channel) -> DeviceChannel {
        DeviceChannel {
            client: client.clone(),
            channel,
        }
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.channel.path()
    }

    /// The name that its peers know us by.
    #[must_use]
    pub fn me(&self) -> String {
        self.client.name()
    }

    /// The token that guards what is said here, as this is told by the hub.
    ///
    /// # Errors
    /// There is none, so that nobody can own the device.
    pub fn token(&self) -> Result<Path, VerbFailure> {
        let guard = self.channel.guard();
        guard.map(|guard| guard.token).ok_or_else(|| {
            let text = format!("no token guards {}, so it cannot be owned", self.path());
            VerbFailure::plain(text)
        })
    }

    /// What is said here from now on.
    #[must_use]
    pub fn events(&self) -> Events {
        self.channel.events()
    }

    /// Sends a message and gives the id by which answers refer to it.
    ///
    /// # Errors
    /// The hub's refusal, a lost connection; nobody is here to take it.
    pub async fn send(&self, message: Parcel, what: &str) -> Result<u64, VerbFailure> {
        let id = self.request(message).await.doing(what)?;
        id.ok_or_else(|| self.nobody())
    }

    /// Sends a message and gives its id by the hub's receipt; none if nobody is here to take it.
    ///
    /// # Errors
    /// The client's.
    pub async fn request(&self, mut message: Parcel) -> Result<Option<u64>, ClientError> {
        message.context = Some(self.path().clone());
        message.echo = Some(false);
        // The receipt refers to the id that the client has given.
        message.receipt = Some(true);
        let receipt = self.client.request(message).await?;
        let delivered = receipt.value().get("delivered").and_then(Value::as_int);
        Ok(receipt.reference.filter(|_| delivered != Some(0)))
    }

    /// Asks the hub about the token, which says first all that it had to say before.
    pub(crate) async fn ask_token(&self) {
        if let Ok(token) = self.token() {
            let _info = self.client.info(token.as_str()).await;
        }
    }

    /// Sends a message and gives the content of the device's answer to it.
    ///
    /// # Errors
    /// As [`send`](Self::send); the device's refusal, which is a message `…-refused`; no answer within 10 s.
    pub async fn ask(&self, name: &str, content: Map, what: &str) -> Result<Value, VerbFailure> {
        let question = Parcel::new(Family::Message, name).content(content);
        // Before it is sent, so that no answer is missed; and no longer than for it, so that nothing piles up meanwhile.
        let mut events = self.events();
        let id = self.send(question, what).await?;
        let answer = async {
            while let Some(event) = events.next().await {
                if let Event::Message(parcel) = event
                    && parcel.reference == Some(id)
                    && is_mine(&parcel, &self.me())
                {
                    return Ok(parcel);
                }
            }
            Err(closed())
        };
        let answer = match timeout(ANSWER, answer).await {
            Ok(answer) => answer?,
            Err(_) => {
                let text = format!(
                    "nobody in {} answers to `{name}` within {} s",
                    self.path(),
                    ANSWER.as_secs()
                );
                return Err(VerbFailure::new(text, SEE));
            }
        };
        match answer.name().ends_with("-refused") {
            true => Err(VerbFailure::Refused {
                what: what.to_owned(),
                error: refusal(&answer.value()),
            }),
            false => Ok(answer.value()),
        }
    }

    fn nobody(&self) -> VerbFailure {
        VerbFailure::new(format!("nobody is in {} to take it", self.path()), SEE)
    }
}

/// Why there are no more events.
#[must_use]
pub fn closed() -> VerbFailure {
    VerbFailure::plain("the connection to the hub is closed")
}

/// Each peer counts its own ids, so an answer that goes to all names whose it refers to.
fn is_mine(parcel: &Parcel, me: &str) -> bool {
    let content = parcel.value();
    let by = content.get("by").and_then(Value::as_str);
    by.is_none_or(|by| by == me)
}

/// A device's refusal.
#[must_use]
pub fn refusal(content: &Value) -> WireError {
    WireError::from_map(content.as_map().unwrap_or(&Map::new()))
}
