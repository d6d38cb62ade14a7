//! What happens in a context, as one line: for people in words, for programs with every slot.

use std::time::SystemTime;

use mom_client::{Content, Event, Map, Parcel, Time, Value};
use serde_json::Value as Json;

use super::event::{event_slots, event_words};
use super::style::{Tone, ink};
use super::{to_json, words};

/// One thing that happened.
#[derive(Debug)]
pub(crate) struct OutputRecord {
    time: Time,
    context: String,
    what: What,
    slots: Map,
}

#[derive(Debug)]
enum What {
    /// A peer said something.
    Message {
        sender: String,
        address: Option<String>,
        name: String,
        content: String,
        /// How old it was when the hub passed it on, or gave it to a late joiner.
        age: Option<String>,
    },
    /// Something happened there, in words.
    Event(String),
    /// Something went wrong, in words.
    Trouble(String),
}

impl OutputRecord {
    /// What an event of the context `context` says, at the time of its arrival.
    pub(crate) fn of(context: &str, event: &Event) -> OutputRecord {
        let now = now();
        match event {
            Event::Message(parcel) => OutputRecord::of_message(context, parcel, now),
            Event::Other(parcel) => OutputRecord {
                what: What::Event(format!(
                    "{} {}",
                    parcel.name(),
                    words::shorten(&words::said(parcel))
                )),
                ..OutputRecord::of_message(context, parcel, now)
            },
            other => {
                let (name, content) = event_slots(other);
                let family = match other {
                    Event::Refused(..) => "error",
                    Event::Lagged(_) | Event::LinkDown | Event::Resumed | Event::Rejoined => "client",
                    _ => "event",
                };
                let words = event_words(other);
                OutputRecord {
                    time: now,
                    context: context.to_owned(),
                    what: match other {
                        Event::Refused(..) | Event::Lagged(_) | Event::LinkDown | Event::Dropped { .. } => {
                            What::Trouble(words)
                        }
                        _ => What::Event(words),
                    },
                    slots: Map::new()
                        .with("context", context)
                        .with("family", family)
                        .with("name", name)
                        .with("received", now)
                        .with("content", content),
                }
            }
        }
    }

    fn of_message(context: &str, parcel: &Parcel, now: Time) -> OutputRecord {
        let address = parcel.address.as_ref().map(|peers| {
            let peers: Vec<String> = peers.iter().map(|peer| words::visible(peer)).collect();
            peers.join(",")
        });
        OutputRecord {
            time: parcel.received.unwrap_or(now),
            context: context.to_owned(),
            what: What::Message {
                sender: words::visible(parcel.sender.as_deref().unwrap_or("?")),
                address,
                name: words::visible(parcel.name()),
                content: words::shorten(&words::said(parcel)),
                age: words::history(parcel).or_else(|| words::age(parcel)),
            },
            slots: parcel_slots(context, parcel),
        }
    }

    /// All slots, one JSON object.
    pub(crate) fn json(&self) -> Json {
        to_json(&self.slots)
    }

    /// One line: `10:00:00.123 /chat alice chat: good morning`, in UTC.
    pub(crate) fn line(&self) -> String {
        let stamp = self.time.to_string();
        // The text form has a fixed width: hours to milliseconds are bytes 11 to 23.
        let clock = stamp.get(11..23).unwrap_or(&stamp);
        let head = format!("{} {}", ink(clock, Tone::Faint), ink(&self.context, Tone::Place));
        match &self.what {
            What::Message {
                sender,
                address,
                name,
                content,
                age,
            } => {
                let to = address
                    .as_ref()
                    .map(|to| format!(" -> {}", ink(to, Tone::Peer)))
                    .unwrap_or_default();
                let end = match content.is_empty() {
                    true => String::new(),
                    false => format!(": {content}"),
                };
                let age = age.as_ref().map(|age| ink(format_args!(" ({age})"), Tone::Faint));
                format!(
                    "{head} {}{to} {}{}{end}",
                    ink(sender, Tone::Peer),
                    ink(name, Tone::Strong),
                    age.unwrap_or_default()
                )
            }
            What::Event(words) => format!("{head} {}", ink(format_args!("* {words}"), Tone::Notice)),
            What::Trouble(words) => format!("{head} {}", ink(format_args!("! {words}"), Tone::Bad)),
        }
    }
}

/// Every slot that a parcel has, under its key of the wire.
fn parcel_slots(context: &str, parcel: &Parcel) -> Map {
    let number = |number: u64| Value::Int(i64::try_from(number).unwrap_or(i64::MAX));
    let mut slots = Map::new()
        .with("context", context)
        .with("family", parcel.family.word())
        .with("name", parcel.name());
    let mut slot = |key: &str, value: Option<Value>| {
        if let Some(value) = value {
            slots.set(key, value);
        }
    };
    slot("id", parcel.id.map(number));
    slot("reference", parcel.reference.map(number));
    slot("sender", parcel.sender.as_deref().map(Value::from));
    let address = parcel.address.as_ref();
    slot(
        "address",
        address.map(|peers| Value::List(peers.iter().map(|peer| Value::from(&**peer)).collect())),
    );
    slot("timestamp", parcel.timestamp.map(Value::from));
    slot("priority", parcel.priority.map(Value::from));
    slot("expires", parcel.expires.map(number));
    slot("delivery", parcel.delivery.map(|delivery| delivery.word().into()));
    slot("fence", parcel.fence.map(number));
    slot("received", parcel.received.map(Value::from));
    slot("age", parcel.age.map(Value::from));
    slot("age-error", parcel.age_error.map(number));
    match parcel.content.as_ref().map(Content::to_value) {
        Some(Ok(content)) => slot("content", Some(content)),
        Some(Err(error)) => slot("content-error", Some(error.to_string().into())),
        None => {}
    }
    for (key, value) in parcel.extra.iter() {
        slot(key, Some(value.clone()));
    }
    slots
}

fn now() -> Time {
    let micros = SystemTime::now()
        .duration_since(SystemTime::UNIX_EPOCH)
        .map_or(0, |since| since.as_micros());
    i64::try_from(micros)
        .ok()
        .and_then(Time::from_micros)
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use bytes::Bytes;
    use mom_client::{Code, ContextInfo, ContextKind, Family, Member, Path, WireError};

    use super::*;

    fn path(text: &str) -> Path {
        Path::parse(text).unwrap()
    }

    fn check(event: &Event, words: &str, name: &str, content: &str) {
        let record = OutputRecord::of("/robot", event);
        let line = anstream::adapter::strip_str(&record.line()).to_string();
        assert_eq!(
            line.split_once(' ').map(|(_, rest)| rest),
            Some(words),
            "after the time of day"
        );
        let json = record.json();
        assert_eq!(json["context"], "/robot");
        assert_eq!(json["name"], name, "{words}");
        assert_eq!(json["content"].to_string(), content, "{words}");
    }

    #[test]
    fn what_happens_in_words_and_as_json() {
        let bob = || Member {
            peer: "bob~2".to_owned(),
            user: "bob".to_owned(),
            level: 1,
            device: false,
        };
        let bob_json = r#"{"peer":"bob~2","user":"bob","level":1}"#;
        check(
            &Event::Joined(bob()),
            "/robot * bob~2 joined (level 1)",
            "joined",
            bob_json,
        );
        check(&Event::Left(bob()), "/robot * bob~2 left", "left", bob_json);
        check(
            &Event::Count(201),
            "/robot * 201 members",
            "count",
            r#"{"count":201}"#,
        );
        check(
            &Event::Created(ContextInfo {
                path: path("/robot/x"),
                kind: ContextKind::Channel,
                number: 9,
                members: None,
                stop: None,
            }),
            "/robot * channel /robot/x was created",
            "created",
            r#"{"path":"/robot/x","kind":"channel","number":9}"#,
        );
        check(
            &Event::Grabbed {
                owner: "alice".to_owned(),
                level: 1,
                fence: (1 << 20) + 5,
                lease: Some(Duration::from_secs(180)),
                path: path("/robot/token"),
            },
            "/robot * alice grabbed /robot/token (level 1, fence 1048581, lease 3 min)",
            "grabbed",
            r#"{"path":"/robot/token","owner":"alice","fence":1048581,"level":1,"lease":180000}"#,
        );
        check(
            &Event::Refused(WireError::new(Code::NOT_OWNER, "no owner"), Some(3)),
            "/robot ! refused: not-owner: no owner",
            "refused",
            r#"{"code":204,"name":"not-owner","text":"no owner","reference":3}"#,
        );
        check(
            &Event::Lagged(2),
            "/robot ! 2 parcels not shown: more came than could be written",
            "lagged",
            r#"{"count":2}"#,
        );
    }

    #[test]
    fn what_was_dropped_says_its_class() {
        let dropped = |content: Map| Event::Dropped {
            reason: "queue-full".to_owned(),
            count: 2,
            parcel: Parcel::new(Family::Event, "dropped").content(content),
        };
        check(
            &dropped(Map::new().with("delivery", "fleeting")),
            "/robot ! 2 fleeting parcels dropped on the way: queue-full",
            "dropped",
            r#"{"reason":"queue-full","count":2,"delivery":"fleeting"}"#,
        );
        check(
            &dropped(Map::new()),
            "/robot ! 2 parcels dropped on the way: queue-full",
            "dropped",
            r#"{"reason":"queue-full","count":2,"delivery":null}"#,
        );
    }

    #[test]
    fn messages_tell_their_age_and_history_says_so() {
        for (age, error, history, words) in [
            (12_345_678, Some(400), true, " (history, 12 s old)"),
            (61_000_000, None, true, " (history, at least 1 min 1 s old)"),
            (45_600, Some(400), true, " (history, 45 ms old)"),
            (45_600, Some(400), false, " (45 ms old)"),
            (45_600, Some(9_100), false, " (45 ms ± 10 ms old)"),
            (300, Some(400), false, " (under 1 ms old)"),
            (-700, Some(1_400), false, " (0 ms ± 2 ms old)"),
            (300_000_000, Some(1_400), false, " (5 min old)"),
            (0, None, false, ""),
        ] {
            let mut parcel = Parcel::new(Family::Message, "state").content("up");
            parcel.sender = Some("arm".into());
            (parcel.age, parcel.age_error) = (Some(age), error);
            parcel.extra.set(mom_client::HISTORY, history);
            let record = OutputRecord::of("/robot", &Event::Message(parcel));
            let line = anstream::adapter::strip_str(&record.line()).to_string();
            assert!(line.ends_with(&format!(" /robot arm state{words}: up")), "{line}");
            let json = record.json();
            assert_eq!((&json["history"], &json["age"]), (&history.into(), &age.into()));
        }
    }

    #[test]
    fn content_that_cannot_be_read_is_not_passed_over() {
        // MessagePack of a string with an escape character, which no string may hold.
        let parcel = Parcel::new(Family::Message, "x").content(Value::Null);
        let parcel = Parcel {
            content: Some(Content::Encoded(Bytes::from_static(b"\xa1\x1b"))),
            ..parcel
        };
        let record = OutputRecord::of("/chat", &Event::Message(parcel));
        let line = anstream::adapter::strip_str(&record.line()).to_string();
        assert!(line.contains("? x: (content that cannot be read: "), "{line}");
        let json = record.json();
        assert!(
            json.get("content").is_none() && json["content-error"].is_string(),
            "{json}"
        );
    }

    #[test]
    fn a_message_keeps_every_slot() {
        let mut parcel = Parcel::new(Family::Message, "command")
            .id(7)
            .content("grip\nopen");
        parcel.sender = Some("alice".into());
        parcel.address = Some(vec!["arm".into()]);
        parcel.received = "2026-11-21T10:00:00.123456Z".parse().ok();
        parcel.fence = Some(5);
        parcel.extra.set("colour", "red");
        let record = OutputRecord::of("/robot/arm", &Event::Message(parcel));
        assert_eq!(
            anstream::adapter::strip_str(&record.line()).to_string(),
            "10:00:00.123 /robot/arm alice -> arm command: grip\\nopen"
        );
        assert_eq!(
            record.json().to_string(),
            r#"{"context":"/robot/arm","family":"message","name":"command","id":7,"sender":"alice","address":["arm"],"fence":5,"received":"2026-11-21T10:00:00.123456Z","content":"grip\nopen","colour":"red"}"#
        );
    }
}
