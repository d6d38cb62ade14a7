//! Questions of the hub to this peer, as manager or chair of contexts (M24).

use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant};

use mom_proto::{Family, MAX_ID, Map, Parcel, Path, Value};

use crate::peer::subscribers::EventQueue;
use crate::words::{level, map_of, millis_of, name_list, number, owned, text};
use crate::{Age, Client, ClientError, Event};

/// The questions of the hub, from [`Client::consults`] on. They keep the connection alive.
///
/// Questions wait in a bounded queue. When it is full the oldest are dropped, and the hub, which gets no answer,
/// refuses the requests; [`Consults::missed`] counts them.
///
/// ```no_run
/// # async fn example(client: mom_client::Client) -> Result<(), mom_client::ClientError> {
/// let mut consults = client.consults();
/// while let Some(consult) = consults.next().await {
///     match consult.user.as_str() {
///         "bob" => consult.deny("not while the arm is being repaired").await?,
///         _ => consult.allow().await?,
///     }
/// }
/// # Ok(())
/// # }
/// ```
pub struct Consults {
    client: Client,
    queue: Arc<EventQueue>,
    missed: u64,
}

/// One question: may that peer do this? The first answer counts; without one in time the hub refuses.
///
/// An answer that comes too late, or after that of another peer, is refused with `too-late` and has no effect.
#[derive(Clone)]
#[must_use = "without an answer the hub says no"]
#[non_exhaustive]
pub struct Consult {
    /// The hub's number of it.
    pub number: u64,
    /// The requested verb: `join`, `grab`, `send`.
    pub verb: String,
    /// The context that it is about.
    pub context: Path,
    /// The peer that asks.
    pub peer: String,
    /// Its user.
    pub user: String,
    /// Its user's level.
    pub level: i32,
    /// Its user's groups.
    pub groups: Vec<String>,
    /// The name of the message, if it is a send.
    pub message: Option<String>,
    /// The bytes of its content, if it is a send.
    pub size: Option<u64>,
    /// The age of the message when it reached the hub, if known.
    pub age: Option<Age>,
    /// The kind of the context, or of the one to be made.
    pub kind: Option<String>,
    /// How long the hub waits for an answer, from the question on.
    pub within: Duration,
    /// The rule that asks.
    pub rule: Option<String>,
    client: Client,
    arrived: Instant,
}

impl Consults {
    pub(crate) fn new(client: Client, queue: Arc<EventQueue>) -> Consults {
        Consults {
            client,
            queue,
            missed: 0,
        }
    }

    /// The next question; `None` once the client is closed. Safe to cancel.
    pub async fn next(&mut self) -> Option<Consult> {
        loop {
            match self.queue.next().await? {
                Event::Other(parcel) => match Consult::read(&parcel, &self.client) {
                    Some(consult) => return Some(consult),
                    None => tracing::warn!(id = parcel.id, "malformed question from the hub"),
                },
                Event::Lagged(missed) => self.missed += missed,
                // Not needed here: after a lost link the hub asks again.
                _ => {}
            }
        }
    }

    /// How many questions were dropped because they were not taken in time.
    pub fn missed(&self) -> u64 {
        self.missed
    }
}

impl Drop for Consults {
    fn drop(&mut self) {
        self.client.handle.shared.unsubscribe(&self.queue);
    }
}

impl fmt::Debug for Consults {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Consults")
            .field("missed", &self.missed)
            .finish_non_exhaustive()
    }
}

impl Consult {
    fn read(parcel: &Parcel, client: &Client) -> Option<Consult> {
        let map = map_of(parcel);
        Some(Consult {
            number: parcel.id.filter(|id| *id <= MAX_ID)?,
            verb: owned(&map, "verb")?,
            context: parcel.context.clone()?,
            peer: text(&map, "peer")?.to_owned(),
            user: owned(&map, "user").unwrap_or_default(),
            level: level(&map, "level").unwrap_or_default(),
            groups: name_list(&map, "groups"),
            message: owned(&map, "message"),
            size: number(&map, "size"),
            age: age(&map),
            kind: owned(&map, "kind"),
            within: millis_of(&map, "within").unwrap_or_default(),
            rule: owned(&map, "rule"),
            client: client.clone(),
            arrived: Instant::now(),
        })
    }

    /// The remainder of [`Consult::within`], if the question was taken as soon as it came.
    pub fn left(&self) -> Duration {
        self.within.saturating_sub(self.arrived.elapsed())
    }

    /// Yes, this once.
    ///
    /// # Errors
    /// `Refused` with `too-late`, a lost link, a time-out.
    pub async fn allow(self) -> Result<(), ClientError> {
        self.answer(Map::new().with("allow", true)).await
    }

    /// Yes, and the same for this peer from now on without asking.
    ///
    /// # Errors
    /// As [`Consult::allow`].
    pub async fn allow_from_now_on(self) -> Result<(), ClientError> {
        self.answer(Map::new().with("allow", true).with("stands", true))
            .await
    }

    /// No; `text` tells the peer why and may be empty.
    ///
    /// # Errors
    /// As [`Consult::allow`].
    pub async fn deny(self, text: &str) -> Result<(), ClientError> {
        let mut content = Map::new().with("allow", false);
        if !text.is_empty() {
            content.set("text", text);
        }
        self.answer(content).await
    }

    async fn answer(self, content: Map) -> Result<(), ClientError> {
        let number = i64::try_from(self.number).unwrap_or(i64::MAX);
        let mut verdict = Map::new().with("consult", Value::Int(number));
        for (key, value) in content {
            verdict.set(&key, value);
        }
        // The number identifies the question, so no context is needed.
        let parcel = Parcel::new(Family::Manager, "verdict").content(verdict);
        self.client.request(parcel).await.map(drop)
    }
}

impl fmt::Debug for Consult {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Consult")
            .field("number", &self.number)
            .field("verb", &self.verb)
            .field("context", &self.context)
            .field("peer", &self.peer)
            .finish_non_exhaustive()
    }
}

/// The age of a message and its error, if the hub reports them.
fn age(map: &Map) -> Option<Age> {
    Some(Age {
        micros: map.get("age").and_then(Value::as_int)?,
        error_micros: number(map, "age-error"),
    })
}
