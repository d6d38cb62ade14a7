//! One fact as one line of JSON.

use std::net::IpAddr;

use mom_hub::Audit;
use mom_proto::Time;
use serde_json::{Map, Value as Json};

/// The longest line, with its line end.
pub(super) const LONGEST: usize = 4096;

/// The keys in their fixed order; others follow them.
const ORDER: [&str; 13] = [
    "what", "peer", "user", "level", "verb", "context", "message", "rule", "code", "fence", "reason", "by",
    "text",
];

/// What happened, when, and details that only the broker knows.
#[derive(Clone, Debug)]
pub struct Fact {
    /// When.
    pub at: Time,
    /// The kind of fact, in the hub's words; the broker adds `started`, `stopped` and `audit-lost`.
    pub audit: Audit,
    /// Where a login comes from.
    pub from: Option<IpAddr>,
    /// How many identical facts this line stands for; none = one.
    pub count: Option<u64>,
    /// Further keys.
    pub more: Vec<(&'static str, String)>,
}

impl Fact {
    /// A fact with only the hub's details.
    pub fn new(at: Time, audit: Audit) -> Fact {
        Fact {
            at,
            audit,
            from: None,
            count: None,
            more: Vec::new(),
        }
    }

    /// A fact that the broker adds.
    pub fn of(at: Time, what: &'static str) -> Fact {
        let audit = Audit {
            what,
            ..Audit::default()
        };
        Fact::new(at, audit)
    }

    /// Its line, with the line's end.
    pub(super) fn line(&self, seq: u64) -> Vec<u8> {
        let mut line = self.to_json(seq);
        let mut bytes = line_of(&line);
        // Only texts that peers choose are unbounded: they are cut, the longest first.
        for most in [1024, 256, 64, 16] {
            if bytes.len() <= LONGEST {
                break;
            }
            line.values_mut().for_each(|value| cut(value, most));
            bytes = line_of(&line);
        }
        bytes
    }

    fn to_json(&self, seq: u64) -> Map<String, Json> {
        let mut facts = match serde_json::to_value(self.audit.to_map()) {
            Ok(Json::Object(facts)) => facts,
            // A map of texts and numbers is always an object.
            _ => Map::new(),
        };
        let mut line = Map::new();
        line.insert("at".to_owned(), self.at.to_string().into());
        line.insert("seq".to_owned(), seq.into());
        for key in ORDER {
            if let Some(value) = facts.shift_remove(key) {
                line.insert(key.to_owned(), value);
            }
        }
        line.extend(facts);
        if let Some(from) = self.from {
            line.insert("from".to_owned(), from.to_string().into());
        }
        for (key, value) in &self.more {
            line.insert((*key).to_owned(), value.as_str().into());
        }
        if let Some(count) = self.count {
            line.insert("count".to_owned(), count.into());
        }
        line
    }
}

fn line_of(line: &Map<String, Json>) -> Vec<u8> {
    // Keys are texts, values are texts and numbers: JSON can represent all of them.
    let mut bytes = serde_json::to_vec(line).unwrap_or_default();
    bytes.push(b'\n');
    bytes
}

/// Cuts a text to at most so many bytes and marks the cut.
fn cut(value: &mut Json, most: usize) {
    if let Json::String(text) = value
        && text.len() > most
    {
        let end = text.floor_char_boundary(most - '…'.len_utf8());
        text.truncate(end);
        text.push('…');
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mom_proto::{Code, Path, Verb};

    #[test]
    fn a_line_has_its_keys_in_order() {
        let audit = Audit {
            peer: Some("ally".into()),
            user: Some("alice".into()),
            level: Some(1),
            verb: Some(Verb::Grab),
            context: Path::parse("/robot/token").ok(),
            rule: Some("people look, talk, drive".into()),
            code: Some(Code::HELD),
            fence: Some(7),
            by: Some("bob".into()),
            text: Some("a\n\"b\"\u{7f}".into()),
            ..Audit::new("refused")
        };
        let fact = Fact {
            from: Some(IpAddr::from([127, 0, 0, 1])),
            count: Some(3),
            ..Fact::new("2026-11-21T10:00:00Z".parse().unwrap(), audit)
        };
        assert_eq!(
            String::from_utf8(fact.line(12)).unwrap(),
            "{\"at\":\"2026-11-21T10:00:00.000000Z\",\"seq\":12,\"what\":\"refused\",\"peer\":\"ally\",\
             \"user\":\"alice\",\"level\":1,\"verb\":\"grab\",\"context\":\"/robot/token\",\
             \"rule\":\"people look, talk, drive\",\"code\":\"held\",\"fence\":7,\"by\":\"bob\",\
             \"text\":\"a\\n\\\"b\\\"\u{7f}\",\"from\":\"127.0.0.1\",\"count\":3}\n"
        );
    }

    #[test]
    fn a_long_line_is_cut_where_it_is_long() {
        for long in ["ä".repeat(5000), "\n".repeat(5000), "\"".repeat(100_000)] {
            let audit = Audit {
                peer: Some("alice".into()),
                rule: Some(long.clone().into()),
                message: Some(long.clone().into()),
                by: Some(long.clone().into()),
                text: Some(long),
                ..Audit::new("refused")
            };
            let line = Fact::new(Time::default(), audit).line(1);
            assert!(line.len() <= LONGEST, "{}", line.len());
            let read: Map<String, Json> = serde_json::from_slice(&line).unwrap();
            assert_eq!(read["peer"], "alice");
            assert!(read["text"].as_str().unwrap().ends_with('…'));
        }
    }
}
