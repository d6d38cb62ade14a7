//! One object, as the model tells of it.

use mom_client::{Map, Time, Value};

/// A cube of the model; its place is that of its middle.
///
/// ```
/// use mom_model::Object;
///
/// let red = Object { x: 100.0, y: 50.0, z: 20.0, ..Object::new("red", 40.0, [200, 40, 40]) };
/// assert_eq!(Object::of(&red.to_map().into()), Some(red));
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Object {
    /// What it is called.
    pub name: String,
    /// mm of its edges.
    pub size: f64,
    /// Red, green and blue.
    pub colour: [u8; 3],
    /// mm.
    pub x: f64,
    /// mm.
    pub y: f64,
    /// mm; half its size when it lies on the table.
    pub z: f64,
    /// Degrees about the vertical, 0 to 90: a cube has no front.
    pub yaw: f64,
    /// How far the place may be wrong, mm (one standard deviation); 0 where it was written.
    pub error: f64,
    /// When the newest image was taken that showed it, by the hub's clock.
    pub seen: Option<Time>,
    /// The cameras by which its place was found.
    pub cameras: Vec<String>,
    /// Whether the arm says that it holds it.
    pub held: bool,
    /// Who wrote the place, if no camera has seen it since.
    pub written_by: Option<String>,
    /// When that was.
    pub written: Option<Time>,
    /// How old the place was when it was told, ms; only in answers.
    pub age: Option<i64>,
}

impl Object {
    /// An object at the middle of the table, of which nothing is known.
    #[must_use]
    pub fn new(name: &str, size: f64, colour: [u8; 3]) -> Object {
        Object {
            name: name.to_owned(),
            size,
            colour,
            x: 0.0,
            y: 0.0,
            z: size / 2.0,
            yaw: 0.0,
            error: 0.0,
            seen: None,
            cameras: Vec::new(),
            held: false,
            written_by: None,
            written: None,
            age: None,
        }
    }

    /// Since when the place is known: it was seen then, or written.
    #[must_use]
    pub fn since(&self) -> Option<Time> {
        self.seen.max(self.written)
    }

    /// How old the place is at a time of the hub's clock, ms. Two clocks differ a little, but what is said to be known
    /// since a time that is yet to come has no known age.
    #[must_use]
    pub fn age_at(&self, now: Time) -> Option<i64> {
        const AHEAD: i64 = -1000;
        let age = (now.micros() - self.since()?.micros()) / 1000;
        (age >= AHEAD).then_some(age.max(0))
    }

    /// The height of its top, mm.
    #[must_use]
    pub fn top(&self) -> f64 {
        self.z + self.size / 2.0
    }

    /// Its content on the wire; what is not known is left out.
    #[must_use]
    pub fn to_map(&self) -> Map {
        let number = |value: f64| Value::Double((value * 10.0).round() / 10.0 + 0.0);
        let colour: Vec<Value> = self.colour.iter().map(|&part| i64::from(part).into()).collect();
        let cameras: Vec<Value> = self.cameras.iter().map(|name| name.as_str().into()).collect();
        let mut map = Map::new()
            .with("name", self.name.as_str())
            .with("size", number(self.size))
            .with("colour", colour)
            .with("x", number(self.x))
            .with("y", number(self.y))
            .with("z", number(self.z))
            .with("yaw", number(self.yaw))
            .with("error", number(self.error))
            .with("cameras", cameras)
            .with("held", self.held);
        if let Some(seen) = self.seen {
            map.set("seen", seen);
        }
        if let Some(by) = &self.written_by {
            map.set("written-by", by.as_str());
        }
        if let Some(written) = self.written {
            map.set("written", written);
        }
        if let Some(age) = self.age {
            map.set("age", age);
        }
        map
    }

    /// Reads one; none if it has no name or no place.
    #[must_use]
    pub fn of(content: &Value) -> Option<Object> {
        let number = |key: &str| content.get(key).and_then(as_number);
        let words = |key: &str| content.get(key).and_then(Value::as_str);
        let colour = content.get("colour").and_then(colour_of).unwrap_or_default();
        let cameras = content
            .get("cameras")
            .and_then(Value::as_list)
            .unwrap_or_default();
        Some(Object {
            x: number("x")?,
            y: number("y")?,
            z: number("z")?,
            yaw: number("yaw")?,
            error: number("error").unwrap_or_default(),
            seen: content.get("seen").and_then(Value::as_time),
            cameras: cameras
                .iter()
                .filter_map(Value::as_str)
                .map(str::to_owned)
                .collect(),
            held: content.get("held").and_then(Value::as_bool) == Some(true),
            written_by: words("written-by").map(str::to_owned),
            written: content.get("written").and_then(Value::as_time),
            age: content.get("age").and_then(Value::as_int),
            ..Object::new(words("name")?, number("size")?, colour)
        })
    }
}

/// A finite number of either type.
pub(crate) fn as_number(value: &Value) -> Option<f64> {
    match value {
        Value::Double(number) => Some(*number).filter(|number| number.is_finite()),
        Value::Int(number) => Some(*number as f64),
        _ => None,
    }
}

/// Three numbers from 0 to 255.
pub(crate) fn colour_of(value: &Value) -> Option<[u8; 3]> {
    let parts = value.as_list()?;
    let parts: Vec<u8> = parts
        .iter()
        .filter_map(Value::as_int)
        .filter_map(|part| u8::try_from(part).ok())
        .collect();
    parts.try_into().ok()
}

/// What of an object is different, with its name; a key that is gone is null.
pub(crate) fn difference(before: &Map, after: &Map) -> Map {
    let mut changed = Map::new();
    for (key, value) in after.iter() {
        if key == "name" || before.get(key) != Some(value) {
            changed.set(key, value.clone());
        }
    }
    for key in before.keys().filter(|key| !after.contains_key(key)) {
        changed.set(key, Value::Null);
    }
    changed
}

/// An object with a difference applied.
pub(crate) fn changed(before: &Map, change: &Map) -> Map {
    let mut after = before.clone();
    for (key, value) in change.iter() {
        match value {
            Value::Null => {
                after.remove(key);
            }
            value => after.set(key, value.clone()),
        }
    }
    after
}
