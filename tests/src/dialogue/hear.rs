//! What peers hear: from a line to what a parcel has to be like.

use mom_proto::{Code, Content, Family, Parcel, Path, Value, write_slots};

use super::notation::{Field, Terms};
use super::show;

/// What a peer is to hear next.
#[derive(Debug)]
pub(crate) enum Expected {
    Parcel(Pattern),
    /// Nothing for two round trips.
    Nothing,
    /// The end of the link.
    Closed,
}

/// What a parcel has to be like.
#[derive(Debug)]
pub(crate) struct Pattern {
    family: Family,
    name: String,
    context: Option<Path>,
    content: Option<Value>,
    /// Members of the content; for messages slots.
    fields: Vec<Field>,
}

impl Expected {
    pub(crate) fn parse(text: &str) -> Result<Expected, String> {
        let mut terms = Terms::parse(text)?;
        let word = terms.take_word("what is heard")?;
        let (family, name) = match word.as_str() {
            "nothing" | "closed" => {
                terms.nothing_left()?;
                return Ok(match word == "closed" {
                    true => Expected::Closed,
                    false => Expected::Nothing,
                });
            }
            "ok" => (Family::Reply, word),
            "pong" => (Family::Time, word),
            "error" => (Family::Error, code(&terms.take_word("a code")?)?),
            "event" => (Family::Event, terms.take_word("an event")?),
            "message" => (Family::Message, terms.take_word("a message's name")?),
            "consult" => (Family::Manager, word),
            other => {
                return Err(format!(
                    "nobody hears {other:?}: ok, error, event, message, consult, pong, nothing, closed"
                ));
            }
        };
        let about_context = matches!(family, Family::Event | Family::Manager);
        let path = (about_context && !terms.words.is_empty()).then(|| terms.words.remove(0));
        let context = path.map(|path| Path::parse(&path)).transpose();
        let pattern = Pattern {
            family,
            name,
            context: context.map_err(|error| error.to_string())?,
            content: terms.content.take(),
            fields: std::mem::take(&mut terms.fields),
        };
        terms.nothing_left()?;
        Ok(Expected::Parcel(pattern))
    }
}

fn code(word: &str) -> Result<String, String> {
    match Code::TABLE.iter().any(|code| code.word() == word) {
        true => Ok(word.to_owned()),
        false => Err(format!("{word} is not a code of an error")),
    }
}

impl Pattern {
    /// An `ok`.
    pub(crate) fn ok(fields: Vec<Field>) -> Pattern {
        Pattern {
            family: Family::Reply,
            name: "ok".to_owned(),
            context: None,
            content: None,
            fields,
        }
    }

    /// The answer to a ping.
    pub(crate) fn pong() -> Pattern {
        Pattern {
            family: Family::Time,
            name: "pong".to_owned(),
            ..Pattern::ok(Vec::new())
        }
    }

    /// Whether a parcel is like this, and in what it is not.
    pub(crate) fn matches(&self, parcel: &Parcel) -> Result<(), String> {
        if !parcel.is(self.family, &self.name) {
            return Err("it is another parcel".to_owned());
        }
        if let Some(context) = self
            .context
            .as_ref()
            .filter(|path| parcel.context.as_ref() != Some(path))
        {
            return Err(format!("its context is not {context}"));
        }
        if let Some(content) = &self.content {
            is_like(content, &opened(parcel)?, "the content")?;
        }
        self.fields.iter().try_for_each(|field| {
            let found = match self.family {
                Family::Message => slot(parcel, &field.key),
                // The number of the question, which its verdict names.
                Family::Manager if field.key == "id" => slot(parcel, "id"),
                _ => opened(parcel)?.get(&field.key).cloned(),
            };
            field.matches(found.as_ref())
        })
    }
}

impl Field {
    fn matches(&self, found: Option<&Value>) -> Result<(), String> {
        let key = &self.key;
        let Some(found) = found else {
            return Err(format!("it has no {key}"));
        };
        match (found, &self.value) {
            (Value::String(whole), Value::String(part)) if self.part => match whole.contains(part.as_str()) {
                true => Ok(()),
                false => Err(format!("its {key} does not contain {part:?}")),
            },
            (Value::Int(fence), Value::Int(number)) if show::HAS_EPOCH.contains(&key.as_str()) => {
                match show::number_of(*fence) == *number {
                    true => Ok(()),
                    false => Err(format!("its {key} is {}, not {number}", show::number_of(*fence))),
                }
            }
            _ => is_like(&self.value, found, key),
        }
    }
}

/// Whether a value has all that is written: maps may have more members.
fn is_like(written: &Value, found: &Value, place: &str) -> Result<(), String> {
    match (written, found) {
        (Value::Map(written), Value::Map(found)) => written.iter().try_for_each(|(key, value)| {
            let field = Field {
                key: key.to_owned(),
                part: false,
                value: value.clone(),
            };
            field
                .matches(found.get(key))
                .map_err(|why| format!("in {place}: {why}"))
        }),
        (Value::List(written), Value::List(found)) if written.len() == found.len() => written
            .iter()
            .zip(found)
            .try_for_each(|(written, found)| is_like(written, found, place)),
        _ if written == found => Ok(()),
        _ => Err(format!(
            "{place} is {}, not {}",
            show::value(found),
            show::value(written)
        )),
    }
}

fn slot(parcel: &Parcel, key: &str) -> Option<Value> {
    let mut found = None;
    write_slots(parcel, |slot, value| {
        if show::slot_word(slot) == key {
            found = Some(value.into_value());
        }
    });
    found
}

fn opened(parcel: &Parcel) -> Result<Value, String> {
    let value = parcel.content.as_ref().map(Content::to_value).transpose();
    value
        .map(Option::unwrap_or_default)
        .map_err(|error| format!("its content cannot be opened: {error}"))
}

#[cfg(test)]
mod tests {
    use mom_proto::Map;

    use super::*;

    fn check(line: &str, parcel: &Parcel, matches: bool) {
        let Ok(Expected::Parcel(pattern)) = Expected::parse(line) else {
            panic!("{line}");
        };
        assert_eq!(
            pattern.matches(parcel).is_ok(),
            matches,
            "{line}: {:?}",
            pattern.matches(parcel)
        );
    }

    #[test]
    fn only_what_is_written_is_compared() {
        let content = Map::new()
            .with("owner", "alice")
            .with("fence", (7_i64 << 20) + 2)
            .with("text", "alice drives")
            .with("list", vec![Value::Map(Map::new().with("a", 1).with("b", 2))]);
        let path = Path::parse("/robot/token").unwrap();
        let parcel = Parcel::new(Family::Event, "released")
            .context(path)
            .content(content);
        for (line, matches) in [
            ("event released", true),
            ("event released /robot/token owner=alice fence=2", true),
            ("event released text*=drives list=[{b=2}]", true),
            ("event grabbed", false),
            ("event released /robot", false),
            ("event released owner=bob", false),
            ("event released fence=3", false),
            ("event released text*=sleeps", false),
            ("event released text=drives", false),
            ("event released list=[]", false),
            ("event released list=[{c=2}]", false),
            ("event released by=bob", false),
            ("ok owner=alice", false),
        ] {
            check(line, &parcel, matches);
        }
    }

    #[test]
    fn messages_are_compared_by_slots() {
        let mut parcel = Parcel::new(Family::Message, "say").content("hello");
        parcel.sender = Some("alice".into());
        parcel.extra.set("colour", "red");
        for (line, matches) in [
            ("message say", true),
            ("message say \"hello\" from=alice colour=red", true),
            ("message say \"hell\"", false),
            ("message say from=bob", false),
            ("message say colour=blue", false),
            ("message say to=[bob]", false),
        ] {
            check(line, &parcel, matches);
        }
    }
}
