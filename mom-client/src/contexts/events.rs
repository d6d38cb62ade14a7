//! The events of a context, as a subscriber receives them.

use std::sync::Arc;

use crate::Event;
use crate::contexts::membership::Membership;
use crate::peer::shared::Shared;
use crate::peer::subscribers::EventQueue;

/// The events of one context, or all that no other subscription takes.
///
/// Events wait in a bounded queue. When it is full the oldest are dropped, and the next event is [`Event::Lagged`]
/// with their number. What stops a device or lets it go is never dropped: `stop`, `unstop`, `halt`, [`Event::Stops`] and
/// [`Event::LinkDown`]; of many only the newest of each sender waits. A message that has expired by the hub's clock is
/// not delivered, only counted ([`HubClock::expired`](crate::HubClock::expired)). A context's events keep its
/// membership and the connection alive.
///
/// ```no_run
/// # async fn example(client: mom_client::Client) -> Result<(), mom_client::ClientError> {
/// use mom_client::Event;
/// let mut events = client.channel("/robot/arm").await?.events();
/// while let Some(event) = events.next().await {
///     match event {
///         Event::Message(parcel) => println!("{}", parcel.name()),
///         Event::Lagged(lost) => eprintln!("{lost} events came too fast"),
///         _ => {}
///     }
/// }
/// # Ok(())
/// # }
/// ```
pub struct Events {
    queue: Arc<EventQueue>,
    shared: Arc<Shared>,
    _member: Option<Membership>,
    /// Whether expired messages are delivered too.
    expired: bool,
}

impl Events {
    pub(crate) fn new(queue: Arc<EventQueue>, shared: Arc<Shared>, member: Option<Membership>) -> Events {
        Events {
            queue,
            shared,
            _member: member,
            expired: false,
        }
    }

    /// The same with messages that have expired, for who wants to say that they came too late
    /// ([`HubClock::age`](crate::HubClock::age) tells how old one is).
    #[must_use]
    pub fn with_expired(mut self) -> Events {
        self.expired = true;
        self
    }

    /// The next event; `None` once the context is left or deleted or the client is closed. Safe to cancel.
    pub async fn next(&mut self) -> Option<Event> {
        loop {
            let event = self.queue.next().await?;
            if !self.is_over(&event) {
                return Some(event);
            }
        }
    }

    /// The next event, if one waits.
    pub fn try_next(&mut self) -> Option<Event> {
        loop {
            let event = self.queue.try_next()?;
            if !self.is_over(&event) {
                return Some(event);
            }
        }
    }

    /// Whether this is an expired message, which is counted and not delivered.
    fn is_over(&self, event: &Event) -> bool {
        let Event::Message(parcel) = event else {
            return false;
        };
        let over = !self.expired && self.shared.clock.is_expired(parcel);
        if over {
            self.shared.clock.note_expired();
        }
        over
    }
}

impl std::fmt::Debug for Events {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("Events")
            .field("queue", &self.queue)
            .finish_non_exhaustive()
    }
}

impl Drop for Events {
    fn drop(&mut self) {
        self.shared.unsubscribe(&self.queue);
    }
}
