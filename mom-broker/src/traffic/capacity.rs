//! Channels in which senders wait for receivers that have no capacity (design §7).
//!
//! A message goes to all of its receivers or to none: before it is put into the first outbox, every one has capacity for
//! it. If one has not, the sender's reader waits for it without a lock, and then admits the message again from the start.
//! So the network holds the sender back, and nobody else.

use std::sync::Arc;
use std::time::Duration;

use mom_proto::{Code, Micros, Parcel, Path, Value, WireError};
use mom_system::Clock;

use crate::traffic::outbox::WaiterHandle;

/// Names of slow receivers that a refusal lists at most.
const NAMED: usize = 16;

/// What a message does where a receiver has no capacity.
#[derive(Debug)]
pub(crate) enum WhenFull {
    /// Its sender waits: the place that it has among the waiters so far, and since when it waits.
    Wait(Option<WaiterHandle>, Micros),
    /// It is refused: it comes from the hub, where nobody waits, and may use all of an outbox.
    Refuse,
}

/// A receiver of a message has no capacity for it.
#[derive(Debug)]
pub(crate) struct NoCapacity {
    /// What was to be sent.
    pub(crate) parcel: Box<Parcel>,
    /// Where its sender waits.
    pub(crate) place: WaiterHandle,
    /// The receivers without capacity.
    pub(crate) slow: Vec<Arc<str>>,
}

/// A message that waits for capacity.
#[derive(Debug)]
pub(crate) struct WaitingMessage {
    pub(crate) parcel: Box<Parcel>,
    pub(crate) since: Micros,
    /// When to look again in any case.
    pub(crate) until: Micros,
    pub(crate) place: WaiterHandle,
}

impl WaitingMessage {
    /// Waits until it is worth looking again.
    pub(crate) async fn ready(&self, clock: &Clock) {
        tokio::select! {
            biased;
            () = self.place.called() => {}
            () = clock.reach(self.until) => {}
        }
    }
}

/// `try-later`, with the names of those who have no capacity, and when to try again.
pub(crate) fn no_capacity(
    slow: &[Arc<str>],
    path: &Path,
    waited: Option<Duration>,
    retry: Duration,
) -> WireError {
    let who = slow.first().map_or("a receiver", |name| &**name);
    let others = match slow.len() {
        0 | 1 => String::new(),
        more => format!(" and {} more", more - 1),
    };
    let waited = waited.map_or(String::new(), |waited| {
        format!(" within {} ms", waited.as_millis())
    });
    let text = format!(
        "the outbox of {who}{others} in {path} was full{waited}; the message was not delivered to anyone"
    );
    WireError::new(Code::TRY_LATER, text)
        .detail("slow", names(slow))
        .retry_after(retry)
}

/// When who has too much waiting for a device may try again.
const SPARED: Duration = Duration::from_secs(1);

/// `try-later`, with the names of devices that did not get what needs no token. Others got it.
pub(crate) fn spared(devices: &[Arc<str>], path: &Path) -> WireError {
    let who = devices.first().map_or("a device", |name| &**name);
    let text = format!(
        "{who} in {path} is slower than what is sent to it without a token, and did not get it; others did"
    );
    WireError::new(Code::TRY_LATER, text)
        .detail("slow", names(devices))
        .retry_after(SPARED)
}

/// Some of these names.
pub(crate) fn names(slow: &[Arc<str>]) -> Vec<Value> {
    slow.iter().take(NAMED).map(|name| Value::from(&**name)).collect()
}
