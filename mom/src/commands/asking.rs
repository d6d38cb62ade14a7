//! Questions to a device in its channel, and its answer or refusal.

use mom_client::{Client, Code, Event, Events, Parcel, Value, WireError};

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
                error: refusal(&parcel.value()),
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

/// The device's refusal, `{name, code, text}`, as an error of the wire.
fn refusal(content: &Value) -> WireError {
    let text = |key: &str| {
        let text = content.get(key).and_then(Value::as_str);
        text.unwrap_or_default().to_owned()
    };
    let number = content.get("code").and_then(Value::as_int);
    let number = number.and_then(|code| u16::try_from(code).ok());
    WireError::new(
        Code::from_wire(number.unwrap_or(200), &text("name")),
        text("text"),
    )
}

#[cfg(test)]
mod tests {
    use mom_client::Map;

    use super::*;

    #[test]
    fn a_cameras_refusal() {
        let told = Map::new()
            .with("name", "try-later")
            .with("code", 100)
            .with("text", "64 wait");
        assert_eq!(refusal(&told.into()), WireError::new(Code::TRY_LATER, "64 wait"));
    }
}
