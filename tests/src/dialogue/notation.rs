//! The notation of values and fields.

use bytes::Bytes;
use mom_proto::{Map, Time, Value};

/// What stands on a line after its verb.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Terms {
    /// Bare words, in order.
    pub(crate) words: Vec<String>,
    /// The value that is not a bare word: content.
    pub(crate) content: Option<Value>,
    /// `key=value` and `key*=value`.
    pub(crate) fields: Vec<Field>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Field {
    pub(crate) key: String,
    /// Whether the string only has to contain the value.
    pub(crate) part: bool,
    pub(crate) value: Value,
}

impl Terms {
    /// Reads the terms of a line.
    pub(crate) fn parse(text: &str) -> Result<Terms, String> {
        let mut reader = Reader { rest: text };
        let mut terms = Terms::default();
        while let Some(term) = reader.term()? {
            match term {
                Term::Word(word) => terms.words.push(word),
                Term::Field(field) => terms.fields.push(field),
                Term::Value(value) if terms.content.is_none() => terms.content = Some(value),
                Term::Value(_) => return Err("a parcel has one content".to_owned()),
            }
        }
        Ok(terms)
    }

    /// Takes a bare word out if it is there.
    pub(crate) fn take_flag(&mut self, flag: &str) -> bool {
        let place = self.words.iter().position(|word| word == flag);
        place.map(|place| self.words.remove(place)).is_some()
    }

    /// Takes a field out.
    pub(crate) fn take_field(&mut self, key: &str) -> Option<Value> {
        let place = self
            .fields
            .iter()
            .position(|field| field.key == key && !field.part)?;
        Some(self.fields.remove(place).value)
    }

    /// The first bare word.
    pub(crate) fn take_word(&mut self, what: &str) -> Result<String, String> {
        match self.words.is_empty() {
            true => Err(format!("{what} is missing")),
            false => Ok(self.words.remove(0)),
        }
    }

    /// That nothing is left that would be overlooked.
    pub(crate) fn nothing_left(&self) -> Result<(), String> {
        match (self.words.first(), &self.content, self.fields.first()) {
            (Some(word), _, _) => Err(format!("{word:?} says nothing here; strings stand in quotes")),
            (_, Some(_), _) => Err("there is no content here".to_owned()),
            (_, _, Some(field)) => Err(format!("{} says nothing here", field.key)),
            (None, None, None) => Ok(()),
        }
    }
}

enum Term {
    Word(String),
    Value(Value),
    Field(Field),
}

struct Reader<'a> {
    rest: &'a str,
}

impl Reader<'_> {
    fn term(&mut self) -> Result<Option<Term>, String> {
        self.skip_space();
        if self.rest.is_empty() || self.rest.starts_with('#') {
            return Ok(None);
        }
        if let Some((key, part)) = self.take_key() {
            let value = self.value()?;
            return Ok(Some(Term::Field(Field { key, part, value })));
        }
        match self.rest.starts_with(['"', '[', '{']) {
            true => self.value().map(|value| Some(Term::Value(value))),
            false => {
                let word = self.word()?;
                Ok(Some(match read_word(&word)? {
                    Value::String(word) => Term::Word(word),
                    value => Term::Value(value),
                }))
            }
        }
    }

    /// `key=` or `key*=`, if that is what follows.
    fn take_key(&mut self) -> Option<(String, bool)> {
        let end = self
            .rest
            .find(|c: char| !(c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.')))?;
        let (key, rest) = self.rest.split_at(end);
        let (part, rest) = match rest.strip_prefix("*=") {
            Some(rest) => (true, rest),
            None => (false, rest.strip_prefix('=')?),
        };
        if key.is_empty() {
            return None;
        }
        self.rest = rest;
        Some((key.to_owned(), part))
    }

    fn value(&mut self) -> Result<Value, String> {
        match self.rest.chars().next() {
            Some('"') => self.string().map(Value::String),
            Some('[') => self.list(),
            Some('{') => self.map(),
            _ => self.word().and_then(|word| read_word(&word)),
        }
    }

    fn word(&mut self) -> Result<String, String> {
        let end = self
            .rest
            .find(|c: char| c.is_whitespace() || matches!(c, '[' | ']' | '{' | '}' | '"' | '='))
            .unwrap_or(self.rest.len());
        let (word, rest) = self.rest.split_at(end);
        if word.is_empty() {
            return Err(format!("no value at {:?}", self.rest));
        }
        self.rest = rest;
        Ok(word.to_owned())
    }

    fn string(&mut self) -> Result<String, String> {
        let mut text = String::new();
        let mut chars = self.rest[1..].char_indices();
        while let Some((at, c)) = chars.next() {
            match c {
                '"' => {
                    self.rest = &self.rest[at + 2..];
                    return Ok(text);
                }
                '\\' => match chars.next() {
                    Some((_, 'n')) => text.push('\n'),
                    Some((_, 'r')) => text.push('\r'),
                    Some((_, 't')) => text.push('\t'),
                    Some((_, c @ ('"' | '\\'))) => text.push(c),
                    other => return Err(format!("no escape {other:?}")),
                },
                c => text.push(c),
            }
        }
        Err("a string without its end".to_owned())
    }

    fn list(&mut self) -> Result<Value, String> {
        self.rest = &self.rest[1..];
        let mut list = Vec::new();
        loop {
            self.skip_space();
            if let Some(rest) = self.rest.strip_prefix(']') {
                self.rest = rest;
                return Ok(Value::List(list));
            }
            list.push(self.value()?);
        }
    }

    fn map(&mut self) -> Result<Value, String> {
        self.rest = &self.rest[1..];
        let mut map = Map::new();
        loop {
            self.skip_space();
            if let Some(rest) = self.rest.strip_prefix('}') {
                self.rest = rest;
                return Ok(Value::Map(map));
            }
            let Some((key, false)) = self.take_key() else {
                return Err(format!("no key=value at {:?}", self.rest));
            };
            let value = self.value()?;
            map.insert_new(key, value)
                .map_err(|key| format!("{key} occurs twice"))?;
        }
    }

    fn skip_space(&mut self) {
        self.rest = self.rest.trim_start();
    }
}

fn read_word(word: &str) -> Result<Value, String> {
    match word {
        "null" => return Ok(Value::Null),
        "true" => return Ok(Value::Bool(true)),
        "false" => return Ok(Value::Bool(false)),
        _ => {}
    }
    if let Some(digits) = word.strip_prefix("hex:") {
        return read_hex(digits).map(Value::Binary);
    }
    if let Ok(time) = word.parse::<Time>() {
        return Ok(Value::Time(time));
    }
    let number = word.strip_prefix('-').unwrap_or(word);
    if number.starts_with(|c: char| c.is_ascii_digit()) {
        return match (word.parse::<i64>(), word.parse::<f64>()) {
            (Ok(int), _) => Ok(Value::Int(int)),
            (Err(_), Ok(double)) => Ok(Value::Double(double)),
            _ => Err(format!(
                "{word} is not a number; a string that begins so stands in quotes"
            )),
        };
    }
    Ok(Value::String(word.to_owned()))
}

fn read_hex(digits: &str) -> Result<Bytes, String> {
    let bad = || format!("{digits} is not hex");
    if !digits.is_ascii() || !digits.len().is_multiple_of(2) {
        return Err(bad());
    }
    (0..digits.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&digits[at..at + 2], 16).map_err(|_| bad()))
        .collect::<Result<Vec<u8>, String>>()
        .map(Bytes::from)
}

#[cfg(test)]
mod tests {
    use super::super::show;
    use super::*;

    #[test]
    fn terms_are_told_apart() {
        let terms =
            Terms::parse(r#"/robot/arm receipt "grip open" to=[arm bob~2] text*="a = b" # why"#).unwrap();
        assert_eq!(terms.words, ["/robot/arm", "receipt"]);
        assert_eq!(terms.content, Some(Value::from("grip open")));
        assert_eq!(terms.fields.len(), 2);
        assert_eq!(
            terms.fields[0].value,
            Value::List(vec!["arm".into(), "bob~2".into()])
        );
        assert!(terms.fields[1].part && terms.fields[1].value == Value::from("a = b"));
        for bad in [
            "\"open",
            "[1",
            "{a}",
            "hex:0",
            "1x",
            "\"a\" \"b\"",
            "x=",
            "{a=1 a=2}",
        ] {
            assert!(Terms::parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn every_value_is_shown_as_it_is_written() {
        for text in [
            "null",
            "true",
            "-3",
            "0.5",
            "1e300",
            "word",
            "\"two words\"",
            r#""a \"quote\" \\ \n""#,
            "\"3\"",
            "\"\"",
            "2026-11-21T10:00:00.000000Z",
            "hex:00ff",
            "[1 [] {}]",
            "{a=1 b={c=[x]}}",
        ] {
            let mut reader = Reader { rest: text };
            let value = reader.value().unwrap();
            assert_eq!(reader.rest, "", "{text}");
            let mut again = Reader {
                rest: &show::value(&value),
            };
            assert_eq!(again.value(), Ok(value), "{text}");
        }
    }
}
