use std::collections::BTreeMap;
use std::fmt::Debug;

use bytes::Bytes;
use proptest::prelude::*;
use serde::de::{DeserializeOwned, Visitor};
use serde::ser::SerializeSeq;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::{Code, HARD_DEPTH, Map, Time, Value, WireError, arbitrary, from_value, to_value, xml_violation};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Unit;

#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
struct Id(String);

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Pair(u8, bool);

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Block {
    x: f64,
    label: Option<String>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Scene {
    blocks: Vec<Block>,
    stamp: Time,
    any: Value,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Shape {
    Empty,
    Circle(f64),
    Line(i32, i32),
    Box { width: f32 },
}

#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Side {
    Left,
    Right,
}

/// Passes through `serde`'s own buffers, which know nothing of times and binary.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
enum Tagged {
    Moved { at: Time },
    Seen(Inside),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
enum Inside {
    Picture { at: Time, pixels: Value },
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Flat {
    known: u8,
    #[serde(flatten)]
    rest: Map,
}

/// Asks for bytes and nothing else.
#[derive(Clone, Debug, PartialEq)]
struct Blob(Vec<u8>);

impl Serialize for Blob {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(&self.0)
    }
}

impl<'de> Deserialize<'de> for Blob {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Blob, D::Error> {
        struct BlobVisitor;

        impl Visitor<'_> for BlobVisitor {
            type Value = Blob;

            fn expecting(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                formatter.write_str("bytes")
            }

            fn visit_byte_buf<E>(self, bytes: Vec<u8>) -> Result<Blob, E> {
                Ok(Blob(bytes))
            }
        }

        deserializer.deserialize_byte_buf(BlobVisitor)
    }
}

fn time() -> Time {
    Time::from_micros(1_795_255_200_000_123).unwrap()
}

fn list(items: impl IntoIterator<Item = Value>) -> Value {
    Value::List(items.into_iter().collect())
}

fn one(key: &str, value: impl Into<Value>) -> Value {
    Map::new().with(key, value).into()
}

#[track_caller]
fn check<T: Serialize + DeserializeOwned + PartialEq + Debug>(object: T, value: impl Into<Value>) {
    let value = value.into();
    assert_eq!(to_value(&object).as_ref(), Ok(&value));
    assert_eq!(from_value::<T>(value), Ok(object));
}

#[test]
fn scalars_go_in_and_out() {
    check(true, true);
    check(i8::MIN, -128);
    check(u8::MAX, 255);
    check(i64::MIN, i64::MIN);
    check(i64::MAX.unsigned_abs(), i64::MAX);
    check(-5_i128, -5);
    check(5_u128, 5);
    check(0.1_f32, Value::Double(f64::from(0.1_f32)));
    check(-0.5_f64, Value::Double(-0.5));
    check('ü', "ü");
    check("good morning".to_owned(), "good morning");
    check(None::<u8>, Value::Null);
    check(Some(1_u8), 1);
    check((), Value::Null);
    check(Unit, Value::Null);
    check(Id("a".into()), "a");
    check(time(), time());
    check(Blob(vec![0, 255]), Bytes::from_static(&[0, 255]));
    check(
        Value::Binary(Bytes::from_static(b"\0")),
        Bytes::from_static(b"\0"),
    );
}

#[test]
fn compounds_go_in_and_out() {
    check(vec![1_u8, 2], vec![Value::Int(1), Value::Int(2)]);
    check((1_u8, 'a', ()), vec![Value::Int(1), "a".into(), Value::Null]);
    check([true; 2], vec![Value::Bool(true); 2]);
    check(Pair(1, true), vec![Value::Int(1), Value::Bool(true)]);
    check(Shape::Empty, "empty");
    check(Shape::Circle(0.5), one("circle", Value::Double(0.5)));
    check(Shape::Line(1, -1), one("line", list([1.into(), Value::Int(-1)])));
    check(
        Shape::Box { width: 2.0 },
        one("box", one("width", Value::Double(2.0))),
    );
    check(Ok::<Option<u8>, ()>(None), one("Ok", Value::Null));
    let block = Map::new()
        .with("x", Value::Double(1.0))
        .with("label", Value::Null);
    check(
        Scene {
            blocks: vec![Block { x: 1.0, label: None }],
            stamp: time(),
            any: one("a", time()),
        },
        Map::new()
            .with("blocks", vec![block.into()])
            .with("stamp", time())
            .with("any", one("a", time())),
    );
}

#[test]
fn keys_are_text() {
    check(BTreeMap::from([("a".to_owned(), 1)]), one("a", 1));
    check(BTreeMap::from([(Id("a".into()), 1)]), one("a", 1));
    check(BTreeMap::from([('ü', 1)]), one("ü", 1));
    check(BTreeMap::from([(-7_i32, 1)]), one("-7", 1));
    check(BTreeMap::from([(u64::MAX, 1)]), one("18446744073709551615", 1));
    check(BTreeMap::from([(u128::MAX, 1)]), one(&u128::MAX.to_string(), 1));
    check(BTreeMap::from([(i128::MIN, 1)]), one(&i128::MIN.to_string(), 1));
    check(BTreeMap::from([(true, 1)]), one("true", 1));
    check(BTreeMap::from([(Some(Side::Left), 1)]), one("left", 1));
    check(
        BTreeMap::from([(time(), 1)]),
        one("2026-11-21T10:00:00.000123Z", 1),
    );
}

#[test]
fn buffered_types_keep_times_and_binary() {
    let moved = Map::new().with("kind", "moved").with("at", time());
    check(Tagged::Moved { at: time() }, moved);
    let pixels = Value::Binary(Bytes::from_static(b"\xFF\xD8"));
    let picture = Map::new().with("at", time()).with("pixels", pixels.clone());
    let seen = Inside::Picture { at: time(), pixels };
    check(
        Tagged::Seen(seen),
        Map::new().with("kind", "seen").with("Picture", picture),
    );
    let rest = Map::new()
        .with("when", time())
        .with("binary", Bytes::from_static(&[7]))
        .with("list", vec![Value::from(time())]);
    let mut whole = Map::new().with("known", 1);
    for (key, value) in rest.iter() {
        whole.set(key, value.clone());
    }
    check(Flat { known: 1, rest }, whole);
}

#[test]
fn reading_widens_only_without_loss() {
    let read = |value: Value| from_value::<f64>(value).ok();
    assert_eq!(read(Value::Int(3)), Some(3.0));
    assert_eq!(read(Value::Int(-(1 << 53))), Some(-9_007_199_254_740_992.0));
    assert_eq!(read(Value::Int((1 << 53) + 1)), None);
    assert_eq!(from_value::<f32>(Value::Int(1 << 24)), Ok(16_777_216.0));
    assert!(from_value::<f32>(Value::Int((1 << 24) + 1)).is_err());
    assert!(from_value::<f32>(Value::Double(1e300)).is_err());
    assert_eq!(from_value::<String>(time().into()), Ok(time().to_string()));
    assert_eq!(
        from_value::<Time>("1970-01-01T00:00:00Z".into()),
        Ok(Time::default())
    );
    assert_eq!(from_value::<Shape>(one("empty", Value::Null)), Ok(Shape::Empty));
}

#[track_caller]
fn refused<T: Debug>(result: Result<T, WireError>, code: &Code, slot: &str, words: &str) -> WireError {
    let error = result.expect_err("refused");
    assert_eq!(
        (&error.code, error.get("slot")),
        (code, Some(&Value::from(slot))),
        "{error}"
    );
    assert!(error.text.contains(words), "{error}");
    assert_eq!(xml_violation(&error.text), None, "an error has to be encodable");
    error
}

#[track_caller]
fn unencodable(object: impl Serialize, slot: &str, words: &str) {
    refused(to_value(&object), &Code::NOT_ENCODABLE, slot, words);
}

#[test]
fn what_has_no_form_on_the_wire_is_told_with_its_place() {
    unencodable(u64::MAX, "content", "18446744073709551615");
    unencodable(i128::MIN, "content", "2^63");
    unencodable([1.0, f64::INFINITY], "content/1", "finite");
    unencodable(f32::NAN, "content", "finite");
    unencodable("a\0", "content", "'\\0'");
    unencodable('\u{FFFE}', "content", "fffe");
    unencodable(BTreeMap::from([("a\u{1b}", 1)]), "content", "\\u{1b}");
    unencodable(BTreeMap::from([(vec![1], 1)]), "content", "not list");
    unencodable(BTreeMap::from([((), 1)]), "content", "not null");
    unencodable(BTreeMap::from([(1, ["", "\u{1}"])]), "content/1/1", "string");
    unencodable(Shape::Circle(f64::NAN), "content/circle", "finite");
    unencodable(Shape::Box { width: f32::NAN }, "content/box/width", "finite");
    unencodable(Value::Double(f64::NAN), "content", "finite");
    let rest = Map::new().with("known", 2);
    unencodable(Flat { known: 1, rest }, "content/known", "twice");
    let block = |x| Block { x, label: None };
    let scene = Scene {
        blocks: vec![block(0.0), block(1.0), block(f64::NAN)],
        stamp: time(),
        any: Value::Null,
    };
    unencodable(scene, "content/blocks/2/x", "content/blocks/2/x: a double");
}

#[track_caller]
fn unfit<T: DeserializeOwned + Debug>(value: impl Into<Value>, slot: &str, words: &str) -> WireError {
    refused(from_value::<T>(value.into()), &Code::BAD_CONTENT, slot, words)
}

#[test]
fn what_does_not_fit_is_told_with_its_place() {
    unfit::<u8>(300, "content", "int 300 stands where u8 is wanted");
    unfit::<i64>(Value::Double(1.0), "content", "double 1.0");
    unfit::<f64>((1_i64 << 53) + 1, "content", "no exact form as f64");
    unfit::<String>(1, "content", "int 1 stands where a string is wanted");
    unfit::<u8>(time(), "content", "a time stands where u8 is wanted");
    unfit::<Time>(5, "content", "int 5 stands where a time");
    unfit::<Time>("soon", "content", "a time like");
    unfit::<()>(one("a", 1), "content", "a map stands where unit is wanted");
    unfit::<Blob>("text", "content", "bytes is wanted");
    unfit::<[u8; 2]>(
        list([1.into()]),
        "content",
        "1 members stand where an array of length 2",
    );
    unfit::<(u8,)>(
        list([1.into(), 2.into()]),
        "content",
        "2 members stand where 1 are wanted",
    );
    unfit::<Block>(
        list([1.into(), Value::Null]),
        "content",
        "a list stands where struct Block",
    );
    unfit::<Vec<Block>>(list([one("label", "a")]), "content/0/x", "missing");
    unfit::<BTreeMap<u8, u8>>(one("07", 1), "content/07", "string \"07\" stands where u8");
    unfit::<BTreeMap<bool, u8>>(one("yes", 1), "content/yes", "a boolean is wanted");
    unfit::<BTreeMap<Side, u8>>(one("up", 1), "content/up", "known are left, right");
    unfit::<Shape>("circle", "content", "needs content");
    unfit::<Shape>(1, "content", "a variant's name");
    unfit::<Shape>(Map::new(), "content", "a variant's name");
    unfit::<Shape>(
        one("empty", 1),
        "content/empty",
        "int 1 stands where nothing is wanted",
    );
    unfit::<Shape>(one("line", list([1.into(), "a".into()])), "content/line/1", "i32");
    unfit::<Shape>(one("box", Map::new()), "content/box/width", "missing");
    unfit::<Value>(one("a", "\0"), "content/a", "is not allowed in a string");
    unfit::<Value>(one("a", Value::Double(f64::NAN)), "content/a", "a finite double");
    let blocks = [one("x", 1), one("x", 2), one("x", "a")];
    unfit::<Scene>(one("blocks", list(blocks)), "content/blocks/2/x", "string \"a\"");
}

#[test]
fn what_is_unknown_names_the_known_and_the_nearest() {
    let error = unfit::<Vec<Shape>>(
        list(["cirkle".into()]),
        "content/0",
        "known are empty, circle, line, box",
    );
    assert_eq!(error.get("nearest"), Some(&"circle".into()));
    let error = unfit::<Block>(
        Map::new().with("x", 1).with("labl", 2),
        "content/labl",
        "known are x, label",
    );
    assert_eq!(error.get("nearest"), Some(&"label".into()));
    let long = "\0".repeat(100_000);
    let error = unfit::<Block>(
        one(&long, 1),
        &format!("content/{}…", "\u{FFFD}".repeat(64)),
        "known",
    );
    assert!(error.text.len() < 2_000);
}

/// A list that never ends, as a type that serialises itself.
struct Endless;

impl Serialize for Endless {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut list = serializer.serialize_seq(Some(usize::MAX))?;
        list.serialize_element(&Endless)?;
        list.end()
    }
}

struct EndlessNewtype;

impl Serialize for EndlessNewtype {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_newtype_struct("EndlessNewtype", &EndlessNewtype)
    }
}

/// A key that nests itself without end.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
struct KeyChain(Option<Box<KeyChain>>);

#[derive(Debug, Deserialize)]
struct Chain(#[expect(dead_code, reason = "never comes to an end")] Option<Box<Chain>>);

#[derive(Debug, PartialEq, Serialize, Deserialize)]
enum Nested {
    End,
    More(Box<Nested>),
}

fn nested(levels: usize) -> Value {
    (0..levels).fold(Value::Null, |value, _| list([value]))
}

#[test]
fn nesting_ends_at_the_limit() {
    check(nested(HARD_DEPTH), nested(HARD_DEPTH));
    let deepest = format!("content{}", "/0".repeat(HARD_DEPTH));
    let deep = &Code::TOO_DEEP;
    refused(to_value(&nested(HARD_DEPTH + 1)), deep, &deepest, "128");
    refused(from_value::<Value>(nested(HARD_DEPTH + 1)), deep, &deepest, "128");
    refused(to_value(&Endless), deep, &deepest, "128");
    refused(to_value(&EndlessNewtype), deep, "content", "nests itself");
    refused(from_value::<Chain>(1.into()), deep, "content", "nests itself");
    refused(
        from_value::<BTreeMap<KeyChain, i32>>(one("7", 1)),
        deep,
        "content/7",
        "nests itself",
    );
    refused(
        from_value::<BTreeMap<i32, Chain>>(one("7", 1)),
        deep,
        "content/7",
        "nests itself",
    );
    let variants = |levels| (0..levels).fold(Nested::End, |inner, _| Nested::More(Box::new(inner)));
    let value = to_value(&variants(HARD_DEPTH)).unwrap();
    assert_eq!(from_value(value), Ok(variants(HARD_DEPTH)));
    let deepest = format!("content{}", "/More".repeat(HARD_DEPTH));
    refused(to_value(&variants(HARD_DEPTH + 1)), deep, &deepest, "128");
}

#[test]
fn json_shows_values_as_text() {
    let value = Map::new()
        .with("z", Value::Null)
        .with("a", vec![Value::Int(-1), Value::Double(1.0), Value::Bool(true)])
        .with("time", time())
        .with("binary", Bytes::from_static(b"\0\xFF"));
    let json = r#"{"z":null,"a":[-1,1.0,true],"time":"2026-11-21T10:00:00.000123Z","binary":"AP8="}"#;
    assert_eq!(serde_json::to_string(&value).unwrap(), json);
    let back: Value = serde_json::from_str(json).unwrap();
    let text = value.with("time", time().to_string()).with("binary", "AP8=");
    assert_eq!(back, text.into(), "in order; what JSON has no type for is text");
    let time: Time = serde_json::from_str(r#""2026-11-21T10:00:00.000123Z""#).unwrap();
    assert_eq!(time, self::time());
    assert_eq!(serde_json::from_str::<Time>("5").ok(), Time::from_micros(5));
    for bad in [
        "18446744073709551615",
        r#""\u0000""#,
        r#"{"\u0001":1}"#,
        r#"{"a":1,"a":2}"#,
    ] {
        assert!(serde_json::from_str::<Value>(bad).is_err(), "{bad}");
    }
}

#[test]
fn toml_becomes_a_map_in_its_order() {
    let text = "zeta = 1\nalpha = [1.5, 'x']\n[rule.lab]\nlease = 3\nfrom = 2026-11-21T10:00:00.000123Z\n[rule.an]\n";
    let lab = Map::new().with("lease", 3).with("from", time());
    let rules = Map::new().with("lab", lab).with("an", Map::new());
    let map = Map::new()
        .with("zeta", 1)
        .with("alpha", vec![Value::Double(1.5), "x".into()])
        .with("rule", rules);
    assert_eq!(toml::from_str::<Map>(text), Ok(map.clone()));
    assert_eq!(toml::from_str::<Value>(text), Ok(map.into()));
    #[derive(Debug, Deserialize)]
    struct When {
        at: Time,
    }
    assert_eq!(
        toml::from_str::<When>("at = 2026-11-21 10:00:00.000123Z")
            .unwrap()
            .at,
        time()
    );
    for bad in [
        "a = nan",
        "a = 10:00:00",
        "a = 2026-11-21",
        "a = 2026-11-21T10:00:00",
    ] {
        assert!(toml::from_str::<Map>(bad).is_err(), "{bad}");
        assert!(toml::from_str::<When>(&bad.replace('a', "at")).is_err(), "{bad}");
    }
}

proptest! {
    #[test]
    fn values_are_themselves(value in arbitrary::value(5)) {
        prop_assert_eq!(to_value(&value), Ok(value.clone()));
        prop_assert_eq!(from_value::<Value>(value.clone()), Ok(value));
    }

    /// What is read as some type and does not fit is refused, never a panic.
    #[test]
    fn nothing_panics(value in arbitrary::value(3)) {
        let _ = from_value::<Scene>(value.clone());
        let _ = from_value::<Tagged>(value.clone());
        let _ = from_value::<BTreeMap<i32, Shape>>(value.clone());
        if let Ok(block) = from_value::<Block>(value) {
            prop_assert!(to_value(&block).is_ok());
        }
    }
}
