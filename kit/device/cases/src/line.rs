//! What a device says, as one line of a dialogue.

use std::fmt::Write as _;

use mom_client::{Delivery, Parcel, Value};
use mom_device::STATE;

/// A parcel of a device as a line; none of a state while it carries something out and moves.
pub(crate) fn line_of(parcel: &Parcel) -> Option<String> {
    match parcel.name() {
        STATE => state(parcel),
        "stop" => Some(format!("stop{}", addressees(parcel))),
        _ => Some(status(parcel)),
    }
}

fn state(parcel: &Parcel) -> Option<String> {
    assert_eq!(
        (parcel.delivery, parcel.echo),
        (Some(Delivery::Latest), Some(false))
    );
    let content = parcel.value();
    let word = |key: &str| content.get(key).and_then(Value::as_bool).unwrap();
    if word("moving") && content.get("executing").is_some() {
        return None;
    }
    let stands = if word("stopped") { "stopped" } else { "free" };
    // Until it is known that it rests, it is not said to stand.
    let rests = match (word("moving"), content.get("rest").is_some()) {
        (true, _) => " moving",
        (false, true) => " at rest",
        (false, false) => "",
    };
    let estop = match content.get("estop").and_then(Value::as_bool) {
        Some(true) => " estop",
        _ => "",
    };
    Some(format!("state{} {stands}{estop}{rests}", addressees(parcel)))
}

fn status(parcel: &Parcel) -> String {
    let content = parcel.value();
    let text = |key: &str| content.get(key).and_then(Value::as_str).unwrap().to_owned();
    let number = |key: &str| content.get(key).and_then(Value::as_int);
    assert_eq!((parcel.delivery, parcel.echo), (None, Some(false)));
    assert_eq!(
        parcel.reference.map(|id| id as i64),
        number("id"),
        "it answers the command"
    );
    let id = number("id").map_or("-".to_owned(), |id| id.to_string());
    let (statement, of) = (number("statement").unwrap(), number("of").unwrap());
    let mut line = format!("status {}/{id} {} {statement}/{of}", text("peer"), text("state"));
    if let Some(error) = content.get("error") {
        assert!(!error.get("text").and_then(Value::as_str).unwrap().is_empty());
        let (name, code) = (error.get("name").unwrap(), error.get("code").unwrap());
        write!(line, " {} {}", name.as_str().unwrap(), code.as_int().unwrap()).unwrap();
    }
    line
}

fn addressees(parcel: &Parcel) -> String {
    parcel
        .address
        .iter()
        .flatten()
        .map(|peer| format!(" to {peer}"))
        .collect()
}
