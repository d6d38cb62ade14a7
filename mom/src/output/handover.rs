//! What happens about a token before and beside its having an owner, in words and as slots.

use std::time::Duration;

use mom_client::{Event, Map, Path, Value, ordinal};

use super::event::{member, member_words};
use super::words;

/// What owners and those who want to be one say to each other.
pub(super) fn words_of(event: &Event) -> String {
    match event {
        Event::Requested {
            member,
            within,
            text,
            path,
        } => {
            let text = text.as_deref().map(|text| format!(": {}", words::visible(text)));
            format!(
                "{} asks for {path}{}, {} to answer",
                member_words(member),
                text.unwrap_or_default(),
                words::duration(*within)
            )
        }
        Event::Offer {
            by,
            to,
            within,
            time,
            commands,
            path,
            ..
        } => format!(
            "{} offers {path} to {}{}, {} to accept",
            words::visible(by),
            words::visible(to),
            words::extent(*time, *commands),
            words::duration(*within)
        ),
        Event::Lapsed {
            what,
            by,
            to,
            reason,
            path,
        } => format!(
            "the {} of {path} by {} to {} came to nothing: {}",
            words::visible(what),
            words::visible(by),
            words::visible(to),
            words::visible(reason)
        ),
        Event::Queued {
            place,
            expected,
            path,
        } => {
            let expected =
                expected.map(|expected| format!(", your turn is expected in {}", words::duration(expected)));
            format!(
                "you are {} in the queue of {path}{}",
                ordinal(*place),
                expected.unwrap_or_default()
            )
        }
        Event::Inhibited { peer, path, .. } => format!("{} inhibits {path}", words::visible(peer)),
        Event::Uninhibited {
            peer, reason, path, ..
        } => match reason.as_str() {
            "" | "released" => format!("{} no longer inhibits {path}", words::visible(peer)),
            reason => format!(
                "{} no longer inhibits {path}: {}",
                words::visible(peer),
                words::visible(reason)
            ),
        },
        _ => String::new(),
    }
}

/// The content of such an event, as it stood on the wire.
pub(super) fn slots(event: &Event) -> Map {
    match event {
        Event::Requested {
            member: asking,
            within,
            text,
            path,
        } => {
            let mut map = Map::new().with("path", path.as_str());
            for (key, value) in member(asking) {
                map.set(&key, value);
            }
            map.with("within", millis(Some(*within)))
                .with("text", optional(text.as_deref()))
        }
        Event::Offer {
            by,
            to,
            level,
            within,
            fence,
            time,
            commands,
            path,
        } => Map::new()
            .with("path", path.as_str())
            .with("by", by.as_str())
            .with("to", to.as_str())
            .with("level", *level)
            .with("within", millis(Some(*within)))
            .with("fence", number(*fence))
            .with("for", millis(*time))
            .with("commands", commands.map_or(Value::Null, number)),
        Event::Lapsed {
            what,
            by,
            to,
            reason,
            path,
        } => Map::new()
            .with("path", path.as_str())
            .with("what", what.as_str())
            .with("by", by.as_str())
            .with("to", to.as_str())
            .with("reason", reason.as_str()),
        Event::Queued {
            place,
            expected,
            path,
        } => Map::new()
            .with("path", path.as_str())
            .with("place", number(*place))
            .with("expected", millis(*expected)),
        Event::Inhibited { .. } | Event::Uninhibited { .. } => shared(event),
        _ => Map::new(),
    }
}

fn shared(event: &Event) -> Map {
    let of = |path: &Path, peer: &str, holders: &[String]| {
        let holders: Vec<Value> = holders.iter().map(|holder| holder.as_str().into()).collect();
        Map::new()
            .with("path", path.as_str())
            .with("peer", peer)
            .with("holders", holders)
    };
    match event {
        Event::Inhibited { peer, holders, path } => of(path, peer, holders),
        Event::Uninhibited {
            peer,
            holders,
            reason,
            path,
        } => of(path, peer, holders).with("reason", reason.as_str()),
        _ => Map::new(),
    }
}

fn millis(duration: Option<Duration>) -> Value {
    duration.map_or(Value::Null, |duration| number(words::in_millis(duration)))
}

pub(super) fn optional(text: Option<&str>) -> Value {
    text.map_or(Value::Null, Value::from)
}

/// A number as a value; all that come from the wire fit.
pub(super) fn number(number: u64) -> Value {
    Value::Int(i64::try_from(number).unwrap_or(i64::MAX))
}

#[cfg(test)]
mod tests {
    use mom_client::Member;

    use super::*;

    fn check(event: &Event, words: &str, content: &Map) {
        assert_eq!(words_of(event), words);
        assert_eq!(slots(event), *content, "{words}");
    }

    fn path() -> Path {
        Path::parse("/t").unwrap()
    }

    fn at() -> Map {
        Map::new().with("path", "/t")
    }

    #[test]
    fn what_owners_and_others_say() {
        let seconds = Duration::from_secs;
        let text = |text: &str| text.to_owned();
        check(
            &Event::Requested {
                member: Member {
                    peer: text("bob~2"),
                    user: text("bob"),
                    level: 1,
                    device: false,
                },
                within: seconds(30),
                text: Some(text("plea\nse")),
                path: path(),
            },
            "bob~2 (bob, level 1) asks for /t: plea\\nse, 30 s to answer",
            &at()
                .with("peer", "bob~2")
                .with("user", "bob")
                .with("level", 1)
                .with("within", 30_000)
                .with("text", "plea\nse"),
        );
        check(
            &Event::Offer {
                by: text("ally"),
                to: text("bob"),
                level: 5,
                within: seconds(10),
                fence: 7,
                time: None,
                commands: Some(3),
                path: path(),
            },
            "ally offers /t to bob for 3 commands, 10 s to accept",
            &at()
                .with("by", "ally")
                .with("to", "bob")
                .with("level", 5)
                .with("within", 10_000)
                .with("fence", 7)
                .with("for", Value::Null)
                .with("commands", 3),
        );
        check(
            &Event::Lapsed {
                what: text("offer"),
                by: text("ally"),
                to: text("bob"),
                reason: text("declined"),
                path: path(),
            },
            "the offer of /t by ally to bob came to nothing: declined",
            &at()
                .with("what", "offer")
                .with("by", "ally")
                .with("to", "bob")
                .with("reason", "declined"),
        );
        check(
            &Event::Queued {
                place: 2,
                expected: Some(seconds(9)),
                path: path(),
            },
            "you are 2nd in the queue of /t, your turn is expected in 9 s",
            &at().with("place", 2).with("expected", 9000),
        );
    }

    #[test]
    fn shared_holds() {
        let holders = || vec!["bob".to_owned()];
        let content = || at().with("peer", "ally").with("holders", vec!["bob".into()]);
        check(
            &Event::Inhibited {
                peer: "ally".to_owned(),
                holders: holders(),
                path: path(),
            },
            "ally inhibits /t",
            &content(),
        );
        for (reason, words) in [
            ("released", "ally no longer inhibits /t"),
            ("broken", "ally no longer inhibits /t: broken"),
        ] {
            let event = Event::Uninhibited {
                peer: "ally".to_owned(),
                holders: holders(),
                reason: reason.to_owned(),
                path: path(),
            };
            check(&event, words, &content().with("reason", reason));
        }
    }
}
