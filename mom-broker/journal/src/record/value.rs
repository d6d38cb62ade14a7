//! Values as JSON, without loss: a value without a JSON type becomes a map with one key that begins with `$`.
//!
//! | value | JSON |
//! |---|---|
//! | null, boolean, int, string, list | the same |
//! | double | `{"$double": "0.5"}` |
//! | time | `{"$time": "2026-11-21T10:00:00.000123Z"}` |
//! | binary | `{"$binary": "base64"}` |
//! | map | a map; a key that begins with `$` gets one more |
//!
//! Encoded content that is not a value, or nests deeper than JSON readers allow, becomes `{"$msgpack": "base64"}`.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use mom_proto::{Content, Map, Value};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Map as JsonMap, Value as Json};

/// The reader of JSON gives up at 128, and a value stands inside others.
const DEPTH: usize = 48;

/// A parcel's content in a recording.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Recorded(pub(super) Content);

impl Serialize for Recorded {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let opened = self.0.to_value().ok().and_then(|value| to_json(&value, DEPTH));
        let json = match opened {
            Some(json) => json,
            None => {
                let bytes = self.0.to_msgpack().map_err(serde::ser::Error::custom)?;
                tagged("$msgpack", STANDARD.encode(bytes))
            }
        };
        json.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Recorded {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Recorded, D::Error> {
        let json = Json::deserialize(deserializer)?;
        if let Json::Object(map) = &json
            && let Some(("$msgpack", Json::String(text))) = only(map)
        {
            let bytes = STANDARD.decode(text).map_err(D::Error::custom)?;
            return Ok(Recorded(Content::Encoded(bytes.into())));
        }
        from_json(json)
            .map(|value| Recorded(value.into()))
            .map_err(D::Error::custom)
    }
}

fn tagged(tag: &str, text: String) -> Json {
    Json::Object(JsonMap::from_iter([(tag.to_owned(), Json::String(text))]))
}

fn only(map: &JsonMap<String, Json>) -> Option<(&str, &Json)> {
    let (key, value) = map.iter().next().filter(|_| map.len() == 1)?;
    Some((key.as_str(), value))
}

/// None if it nests too deep.
fn to_json(value: &Value, depth: usize) -> Option<Json> {
    let depth = depth.checked_sub(1)?;
    Some(match value {
        Value::Null => Json::Null,
        Value::Bool(flag) => Json::Bool(*flag),
        Value::Int(number) => (*number).into(),
        // Rust's shortest text of a double reads back as the same, which not every reader of JSON numbers does.
        Value::Double(number) => tagged("$double", number.to_string()),
        Value::String(text) => Json::String(text.clone()),
        Value::Time(time) => tagged("$time", time.to_string()),
        Value::Binary(bytes) => tagged("$binary", STANDARD.encode(bytes)),
        Value::List(list) => {
            let items: Option<Vec<Json>> = list.iter().map(|item| to_json(item, depth)).collect();
            Json::Array(items?)
        }
        Value::Map(map) => {
            let members = map.iter().map(|(key, value)| {
                let key = match key.starts_with('$') {
                    true => format!("${key}"),
                    false => key.to_owned(),
                };
                Some((key, to_json(value, depth)?))
            });
            let members: Option<JsonMap<String, Json>> = members.collect();
            Json::Object(members?)
        }
    })
}

fn from_json(json: Json) -> Result<Value, String> {
    Ok(match json {
        Json::Null => Value::Null,
        Json::Bool(flag) => Value::Bool(flag),
        Json::Number(number) => match number.as_i64() {
            Some(number) => Value::Int(number),
            None => {
                return Err(format!(
                    "{number} is no int; a double is written {{\"$double\": \"…\"}}"
                ));
            }
        },
        Json::String(text) => Value::String(text),
        Json::Array(items) => Value::List(items.into_iter().map(from_json).collect::<Result<_, _>>()?),
        Json::Object(map) => return from_object(map),
    })
}

fn from_object(map: JsonMap<String, Json>) -> Result<Value, String> {
    if let Some((tag, value)) = only(&map).filter(|(key, _)| is_tag(key)) {
        let text = value.as_str().ok_or_else(|| format!("{tag} holds a text"))?;
        return untagged(tag, text).ok_or_else(|| format!("{text:?} is no {tag}"));
    }
    let mut members = Map::new();
    for (key, value) in map {
        if is_tag(&key) {
            return Err(format!("{key} stands alone in its map"));
        }
        let plain = match key.starts_with('$') {
            true => &key[1..],
            false => &key,
        };
        members.set(plain, from_json(value)?);
    }
    Ok(members.into())
}

/// Keys with two of them are plain ones that begin with one.
fn is_tag(key: &str) -> bool {
    key.starts_with('$') && !key.starts_with("$$")
}

fn untagged(tag: &str, text: &str) -> Option<Value> {
    match tag {
        "$double" => text.parse().ok().map(Value::Double),
        "$time" => text.parse().ok().map(Value::Time),
        "$binary" => STANDARD
            .decode(text)
            .ok()
            .map(|bytes| Value::Binary(bytes.into())),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytes::Bytes;
    use mom_proto::Time;

    fn check(content: Content, json: &str) {
        let recorded = Recorded(content);
        let text = serde_json::to_string(&recorded).unwrap();
        assert_eq!(text, json);
        let back: Recorded = serde_json::from_str(&text).unwrap();
        assert_eq!(back, recorded);
        // Contents are equal whatever form they have; here the form is to be the same too.
        assert_eq!(
            matches!(back.0, Content::Encoded(_)),
            text.contains("$msgpack"),
            "{text}"
        );
    }

    #[test]
    fn every_value_comes_back() {
        for (value, json) in [
            (Value::Null, "null"),
            (true.into(), "true"),
            (Value::Int(i64::MIN), "-9223372036854775808"),
            (Value::Int(1), "1"),
            (Value::Double(1.0), r#"{"$double":"1"}"#),
            (Value::Double(-0.0), r#"{"$double":"-0"}"#),
            (Value::Double(0.1 + 0.2), r#"{"$double":"0.30000000000000004"}"#),
            ("a\u{9}\"".into(), r#""a\t\"""#),
            (
                Time::from_micros(123).unwrap().into(),
                r#"{"$time":"1970-01-01T00:00:00.000123Z"}"#,
            ),
            (Bytes::from_static(b"\0\xff").into(), r#"{"$binary":"AP8="}"#),
            (vec![1.into(), Value::List(vec![])].into(), "[1,[]]"),
            (
                Map::new()
                    .with("b", 1)
                    .with("a", Map::new())
                    .with("$time", "now")
                    .with("$", 2)
                    .into(),
                r#"{"b":1,"a":{},"$$time":"now","$$":2}"#,
            ),
            (Map::new().with("$time", "now").into(), r#"{"$$time":"now"}"#),
            (Map::new().with("$$x", "now").into(), r#"{"$$$x":"now"}"#),
        ] {
            check(value.into(), json);
        }
        for huge in [f64::MAX, f64::MIN_POSITIVE, 5e-324, 1e300] {
            let text = serde_json::to_string(&Recorded(Value::Double(huge).into())).unwrap();
            let back: Recorded = serde_json::from_str(&text).unwrap();
            assert_eq!(back.0, Value::Double(huge).into());
        }
    }

    #[test]
    fn what_cannot_be_opened_stays_as_it_is() {
        check(
            Content::Encoded(Bytes::from_static(b"\xc1")),
            r#"{"$msgpack":"wQ=="}"#,
        );
        let deep = (0..100).fold(Value::Null, |inner, _| Value::List(vec![inner]));
        let text = serde_json::to_string(&Recorded(deep.clone().into())).unwrap();
        let back: Recorded = serde_json::from_str(&text).unwrap();
        assert_eq!(back.0, deep.into());
    }

    #[test]
    fn what_nobody_wrote_is_refused() {
        for (text, words) in [
            (r#"{"$time":"yesterday"}"#, "yesterday"),
            (r#"{"$what":"x"}"#, "$what"),
            (r#"{"$time":1}"#, "text"),
            (r#"{"$time":"1970-01-01T00:00:00Z","b":1}"#, "alone"),
            ("1.5", "$double"),
            ("18446744073709551615", "no int"),
            (r#"{"$msgpack":"?"}"#, "nvalid"),
        ] {
            let error = serde_json::from_str::<Recorded>(text).unwrap_err().to_string();
            assert!(error.contains(words), "{text}: {error}");
        }
    }
}
