//! A channel: where messages are exchanged (M27).

use mom_proto::{Content, Path, Thinning};

use crate::contexts::membership::Membership;
use crate::{ClientError, Events, FenceGate, GuardState, Message};

/// A channel that this peer has joined, until the last of its clones and its events is dropped.
///
/// ```no_run
/// # async fn example(client: mom_client::Client) -> Result<(), mom_client::ClientError> {
/// use mom_client::{Delivery, Event, Map};
/// let arm = client.channel("/robot/arm").await?;
/// let (gate, mut events) = (arm.gate(), arm.events());
/// arm.message("state").content(Map::new().with("ready", true)).delivery(Delivery::Latest).send().await?;
/// while let Some(event) = events.next().await {
///     match event {
///         Event::Message(parcel) if gate.check(&parcel).is_err() => {} // of an earlier owner
///         Event::Message(parcel) => println!("{}", parcel.name()),
///         _ => {}
///     }
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Channel {
    member: Membership,
    gate: FenceGate,
}

impl Channel {
    pub(crate) fn new(member: Membership) -> Channel {
        let gate = member.shared().lock().places.gate(member.path());
        Channel { member, gate }
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        self.member.path()
    }

    /// Its messages and events from now on, including the events of the guarding token. The first subscriber also
    /// gets the first few since the join.
    pub fn events(&self) -> Events {
        self.member.events()
    }

    /// Asks the hub to thin the messages of others in this channel, from now on and after reconnects: only the newest
    /// of each sender and name, or at most so many per time. Guarded messages, `stop`, `unstop`, `halt` and events
    /// are never thinned. It applies to all proxies of this client; the default value ends it.
    ///
    /// # Errors
    /// `Refused` with `denied` or `unknown-path`, a lost link, a time-out.
    pub async fn thin(&self, thinning: Thinning) -> Result<(), ClientError> {
        self.member.shared().thin(self.path(), thinning).await
    }

    /// Sends a message to all members. A refusal comes as [`Event::Refused`](crate::Event::Refused).
    ///
    /// # Errors
    /// As [`Client::send`](crate::Client::send).
    pub async fn send(&self, name: &str, content: impl Into<Content>) -> Result<(), ClientError> {
        self.message(name).content(content).send().await
    }

    /// Begins a message.
    pub fn message(&self, name: &str) -> Message {
        Message::new(self.member.client(), self.path(), name)
    }

    /// The last known state of the guarding token; none = it is not guarded.
    pub fn guard(&self) -> Option<GuardState> {
        self.gate.guard()
    }

    /// The gate that refuses messages of earlier owners; it stays up to date, after reconnects too.
    pub fn gate(&self) -> FenceGate {
        self.gate.clone()
    }

    /// Leaves it, even if other proxies of it exist.
    ///
    /// # Errors
    /// `Refused` with `not-member`, a lost link, a time-out.
    pub async fn leave(self) -> Result<(), ClientError> {
        self.member.leave().await
    }
}
