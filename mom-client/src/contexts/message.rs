//! A builder of messages.

use std::sync::Arc;
use std::time::Duration;

use mom_proto::{Content, Delivery, Family, MAX_ID, Parcel, Path, TRACE, Value, check_message_name};
use serde::Serialize;

use crate::error::bad_reply;
use crate::words::{map_of, millis, number};
use crate::{BASED_ON, Client, ClientError};

/// A message to a channel, from [`Channel::message`](crate::Channel::message).
///
/// ```no_run
/// # async fn example(arm: mom_client::Channel) -> Result<(), mom_client::ClientError> {
/// use std::time::Duration;
/// let receipt = arm
///     .message("command")
///     .content("grip open")
///     .to(["arm"])
///     .expires(Duration::from_millis(500))
///     .send_acknowledged()
///     .await?;
/// assert_eq!(receipt.delivered, 1);
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
#[must_use = "a message does nothing until it is sent"]
pub struct Message {
    client: Client,
    parcel: Parcel,
}

/// The outcome of an acknowledged message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Receipt {
    /// Receivers whose queue took it.
    pub delivered: u64,
    /// Receivers for which it was dropped.
    pub dropped: Vec<String>,
}

impl Message {
    pub(crate) fn new(client: Client, path: &Path, name: &str) -> Message {
        Message {
            client,
            parcel: Parcel::new(Family::Message, name).context(path.clone()),
        }
    }

    /// Its content.
    pub fn content(mut self, content: impl Into<Content>) -> Message {
        self.parcel.content = Some(content.into());
        self
    }

    /// Its content, as any `serde` type (M14).
    ///
    /// # Errors
    /// `Local` with `not-encodable` and the place that has no form on the wire.
    pub fn object<T: Serialize + ?Sized>(self, object: &T) -> Result<Message, ClientError> {
        let content = Content::of(object)?;
        Ok(self.content(content))
    }

    /// Only to these members (M4). If one is not there, nobody gets it and it is refused with `unknown-peer`.
    pub fn to<N: Into<Arc<str>>>(mut self, names: impl IntoIterator<Item = N>) -> Message {
        self.parcel.address = Some(names.into_iter().map(Into::into).collect());
        self
    }

    /// Higher is more urgent (M7); 0 by default, and the hub clamps it to ±100.
    pub fn priority(mut self, priority: i32) -> Message {
        self.parcel.priority = Some(priority);
        self
    }

    /// Worthless after this time; in whole ms, rounded up.
    pub fn expires(mut self, after: Duration) -> Message {
        self.parcel.expires = u64::try_from(millis(after)).ok();
        self
    }

    /// The delivery class, which decides what happens when a receiver is slow; by default the channel's.
    pub fn delivery(mut self, delivery: Delivery) -> Message {
        self.parcel.delivery = Some(delivery);
        self
    }

    /// Suppresses the echo to this peer.
    pub fn no_echo(mut self) -> Message {
        self.parcel.echo = Some(false);
        self
    }

    /// Valid only under this ownership of the guarding token: refused with `older-fence` if it has ended.
    pub fn fence(mut self, fence: u64) -> Message {
        self.parcel.fence = Some(fence);
        self
    }

    /// Valid only if the device has not moved since this state, by the id of the state's parcel (M35): otherwise the
    /// device refuses it with `stale-state`.
    pub fn based_on(self, state: u64) -> Message {
        let state = i64::try_from(state.min(MAX_ID)).unwrap_or(i64::MAX);
        self.slot(BASED_ON, state)
    }

    /// The id of the message that this one replies to (M9).
    pub fn reference(mut self, id: u64) -> Message {
        self.parcel.reference = Some(id);
        self
    }

    /// The trace that it is part of, as W3C's `traceparent` (`00-TRACE-SPAN-FLAGS`): it goes through the hub unchanged, and both ends
    /// and the hub write spans of it, target `mom::trace`.
    pub fn trace(self, traceparent: &str) -> Message {
        self.slot(TRACE, traceparent)
    }

    /// Any other slot (M3).
    pub fn slot(mut self, key: &str, value: impl Into<Value>) -> Message {
        self.parcel.extra.set(key, value);
        self
    }

    /// Sends it without waiting for an answer. A refusal comes as [`Event::Refused`](crate::Event::Refused) on the
    /// channel.
    ///
    /// # Errors
    /// As [`Client::send`](crate::Client::send); `Local` with `bad-name` for an invalid name.
    pub async fn send(self) -> Result<(), ClientError> {
        check_message_name(self.parcel.name())?;
        self.client.send(self.parcel).await
    }

    /// Sends it and waits until every receiver's queue took or dropped it.
    ///
    /// # Errors
    /// `Refused` with the reason, and as [`Message::send`].
    pub async fn send_acknowledged(mut self) -> Result<Receipt, ClientError> {
        check_message_name(self.parcel.name())?;
        self.parcel.receipt = Some(true);
        Receipt::read(&self.client.request(self.parcel).await?)
    }
}

impl Receipt {
    fn read(reply: &Parcel) -> Result<Receipt, ClientError> {
        let map = map_of(reply);
        let dropped = map.get("dropped").and_then(Value::as_list).unwrap_or_default();
        Ok(Receipt {
            delivered: number(&map, "delivered").ok_or_else(|| bad_reply("delivered"))?,
            dropped: dropped
                .iter()
                .filter_map(Value::as_str)
                .map(str::to_owned)
                .collect(),
        })
    }
}
