//! Questions to a device in its channel, and its answer or refusal.

use mom_client::{Client, Event, Events, Map, Parcel, Value, WireError};

use crate::failure::{Doing as _, Failure};

/// Sends a message and gives the device's answer to it; a message `…-refused` is the device's refusal.
pub(super) async fn ask(
    client: &Client,
    events: &mut Events,
    question: Parcel,
    what: &str,
) -> Result<Parcel, Failure> {
    let asked = Asked::of(client, question, what).await?;
    while let Some(event) = events.next().await {
        if let Event::Message(parcel) = event
            && asked.is_answered_by(&parcel, client)
        {
            return asked.answer(parcel);
        }
    }
    Err(closed())
}

/// What there is to say when no more events come.
pub(super) fn closed() -> Failure {
    Failure::plain("the connection to the hub is closed")
}

/// A question that was sent.
pub(super) struct Asked<'a> {
    id: Option<u64>,
    what: &'a str,
}

impl<'a> Asked<'a> {
    /// Sends it.
    pub(super) async fn of(
        client: &Client,
        mut question: Parcel,
        what: &'a str,
    ) -> Result<Asked<'a>, Failure> {
        question.echo = Some(false);
        // The receipt refers to the id that the client has given, and so does the answer.
        question.receipt = Some(true);
        let id = client.request(question).await.doing(what)?.reference;
        Ok(Asked { id, what })
    }

    /// Whether a message answers it.
    pub(super) fn is_answered_by(&self, parcel: &Parcel, client: &Client) -> bool {
        self.id.is_some() && parcel.reference == self.id && is_mine(parcel, client)
    }

    /// The answer, unless it is a refusal.
    pub(super) fn answer(&self, parcel: Parcel) -> Result<Parcel, Failure> {
        if parcel.name().ends_with("-refused") {
            return Err(Failure::Refused {
                what: self.what.to_owned(),
                error: WireError::from_map(parcel.value().as_map().unwrap_or(&Map::new())),
            });
        }
        Ok(parcel)
    }
}

/// Each peer counts its own ids, so an answer that goes to all names whose it refers to.
fn is_mine(parcel: &Parcel, client: &Client) -> bool {
    let content = parcel.value();
    let by = content.get("by").and_then(Value::as_str);
    by.is_none_or(|by| by == client.name())
}
