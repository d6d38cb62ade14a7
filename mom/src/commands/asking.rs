//! Questions to a device in its channel, and its answer or refusal.

use mom_client::{Client, Event, Events, Map, Parcel, Value, WireError};

use crate::failure::{Doing as _, Failure};

/// Sends a message and gives the device's answer to it; a message `…-refused` is the device's refusal.
pub(super) async fn ask(
    client: &Client,
    events: &mut Events,
    mut question: Parcel,
    what: &str,
) -> Result<Parcel, Failure> {
    question.echo = Some(false);
    // The receipt refers to the id that the client has given, and so does the answer.
    question.receipt = Some(true);
    let id = client.request(question).await.doing(what)?.reference;
    while let Some(event) = events.next().await {
        let Event::Message(parcel) = event else { continue };
        if id.is_none() || parcel.reference != id || !is_mine(&parcel, client) {
            continue;
        }
        if parcel.name().ends_with("-refused") {
            return Err(Failure::Refused {
                what: what.to_owned(),
                error: WireError::from_map(parcel.value().as_map().unwrap_or(&Map::new())),
            });
        }
        return Ok(parcel);
    }
    Err(Failure::plain("the connection to the hub is closed"))
}

/// Each peer counts its own ids, so an answer that goes to all names whose it refers to.
fn is_mine(parcel: &Parcel, client: &Client) -> bool {
    let content = parcel.value();
    let by = content.get("by").and_then(Value::as_str);
    by.is_none_or(|by| by == client.name())
}
