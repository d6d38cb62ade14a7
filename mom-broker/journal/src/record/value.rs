//! A parcel's content in a recording: MessagePack in base64.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use mom_proto::Content;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A parcel's content in a recording. It is written as it came, also if it cannot be opened.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Recorded(pub(super) Content);

impl Serialize for Recorded {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let bytes = self.0.to_msgpack().map_err(serde::ser::Error::custom)?;
        STANDARD.encode(bytes).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Recorded {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Recorded, D::Error> {
        let text = String::deserialize(deserializer)?;
        let bytes = STANDARD.decode(text).map_err(D::Error::custom)?;
        Ok(Recorded(Content::Encoded(bytes.into())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytes::Bytes;
    use mom_proto::{Map, Time, Value};

    fn back(content: Content) -> Content {
        let text = serde_json::to_string(&Recorded(content)).unwrap();
        serde_json::from_str::<Recorded>(&text).unwrap().0
    }

    #[test]
    fn every_value_comes_back() {
        let deep = (0..30).fold(Value::Null, |inner, _| Value::List(vec![inner]));
        for value in [
            Value::Null,
            true.into(),
            Value::Int(i64::MIN),
            Value::Int(1),
            Value::Double(1.0),
            Value::Double(-0.0),
            Value::Double(0.1 + 0.2),
            Value::Double(f64::MAX),
            Value::Double(5e-324),
            "a\u{9}\"".into(),
            Time::from_micros(123).unwrap().into(),
            Bytes::from_static(b"\0\xff").into(),
            vec![1.into(), Value::List(vec![])].into(),
            Map::new().with("b", 1).with("a", Map::new()).with("$", 2).into(),
            deep,
        ] {
            assert_eq!(back(value.clone().into()).to_value().unwrap(), value);
        }
    }

    #[test]
    fn what_cannot_be_opened_stays_as_it_is() {
        let broken = Bytes::from_static(b"\xc1");
        let Content::Encoded(same) = back(Content::Encoded(broken.clone())) else {
            panic!("it cannot be opened")
        };
        assert_eq!(same, broken);
    }

    #[test]
    fn what_nobody_wrote_is_refused() {
        for text in ["1.5", r#"{"$time":"1970-01-01T00:00:00Z"}"#, r#""?""#] {
            assert!(serde_json::from_str::<Recorded>(text).is_err(), "{text}");
        }
    }
}
