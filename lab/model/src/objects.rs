//! All objects: how they lie to each other, and which one may be meant.

use std::collections::BTreeMap;

use mom_client::{Time, Value};

use crate::Object;
use crate::object::changed;

/// A block that lies on another is at most so far beside its middle, as a part of the size.
const BESIDE: f64 = 0.75;
/// The height of what lies on another is wrong by less than this, mm.
const LEVEL: f64 = 12.0;

/// Longer names are no object's, bytes: comparing costs the square of the length.
pub(crate) const LONGEST_NAME: usize = 64;

/// The objects of a model, by their names.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Objects {
    all: BTreeMap<String, Object>,
}

impl FromIterator<Object> for Objects {
    fn from_iter<I: IntoIterator<Item = Object>>(objects: I) -> Objects {
        Objects {
            all: objects
                .into_iter()
                .map(|object| (object.name.clone(), object))
                .collect(),
        }
    }
}

impl Objects {
    /// Reads those of a message `objects`; what cannot be read is left out.
    #[must_use]
    pub fn of(content: &Value) -> Objects {
        let list = content
            .get("objects")
            .and_then(Value::as_list)
            .unwrap_or_default();
        list.iter().filter_map(Object::of).collect()
    }

    /// Applies the content of a message `objects-changed`.
    pub fn apply(&mut self, content: &Value) {
        let list = content
            .get("objects")
            .and_then(Value::as_list)
            .unwrap_or_default();
        for change in list.iter().filter_map(Value::as_map) {
            let Some(name) = change.get("name").and_then(Value::as_str) else {
                continue;
            };
            let before = self.all.get(name).map(Object::to_map).unwrap_or_default();
            if let Some(after) = Object::of(&changed(&before, change).into()) {
                self.all.insert(name.to_owned(), after);
            }
        }
        let gone = content.get("gone").and_then(Value::as_list).unwrap_or_default();
        for name in gone.iter().filter_map(Value::as_str) {
            self.all.remove(name);
        }
    }

    /// In the order of their names.
    pub fn iter(&self) -> impl Iterator<Item = &Object> {
        self.all.values()
    }

    /// How many there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.all.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// The one of this name.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&Object> {
        self.all.get(name)
    }

    pub(crate) fn get_mut(&mut self, name: &str) -> Option<&mut Object> {
        self.all.get_mut(name)
    }

    pub(crate) fn insert(&mut self, object: Object) {
        self.all.insert(object.name.clone(), object);
    }

    pub(crate) fn remove(&mut self, name: &str) -> Option<Object> {
        self.all.remove(name)
    }

    /// What an object lies on, if not on the table.
    #[must_use]
    pub fn under(&self, object: &Object) -> Option<&Object> {
        self.iter().find(|other| lies_on(object, other))
    }

    /// What lies on an object.
    #[must_use]
    pub fn upon(&self, object: &Object) -> Option<&Object> {
        self.iter().find(|other| lies_on(other, object))
    }

    /// The height of an object's middle if everything lies flat on what it lies on, mm: better than what is measured.
    #[must_use]
    pub fn level(&self, object: &Object) -> f64 {
        let mut level = object.size / 2.0;
        let mut lowest = object;
        // No tower is higher than all objects.
        for _ in 0..self.len() {
            match self.under(lowest) {
                Some(under) => {
                    level += under.size;
                    lowest = under;
                }
                None => break,
            }
        }
        match (level - object.z).abs() < LEVEL {
            true => level,
            false => object.z,
        }
    }

    /// The object nearest to a place on the table, without those left out.
    pub fn nearest<'a>(&'a self, [x, y]: [f64; 2], without: &str) -> Option<&'a Object> {
        let distance = |object: &Object| (object.x - x).hypot(object.y - y);
        let others = self.iter().filter(|object| object.name != without);
        others.min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }

    /// The object whose name is most like this one, if any is like it.
    #[must_use]
    pub fn meant(&self, name: &str) -> Option<&Object> {
        let names: Vec<String> = self.iter().map(|object| object.name.to_lowercase()).collect();
        let meant = mom_nearest::nearest(&name.to_lowercase(), names.iter().map(String::as_str))?;
        self.iter()
            .zip(&names)
            .find_map(|(object, name)| (name == meant).then_some(object))
    }

    /// That there is no such object, with the one that may be meant, or all names, and ages.
    #[must_use]
    pub fn no_such(&self, name: &str, now: Time) -> String {
        if name.len() > LONGEST_NAME {
            return format!("there is no object with a name of {} bytes", name.len());
        }
        if self.is_empty() {
            return format!("there is no object {name:?}; the model knows none yet");
        }
        if let Some(meant) = self.meant(name) {
            return format!("there is no object {name:?}; did you mean {}?", known(meant, now));
        }
        let all: Vec<String> = self.iter().map(|object| known(object, now)).collect();
        format!("there is no object {name:?}; there are {}", all.join(", "))
    }

    /// That an object was not seen lately, with the nearest other one.
    #[must_use]
    pub fn too_old(&self, object: &Object, now: Time) -> String {
        let Some(age) = object.age_at(now) else {
            return match object.since() {
                Some(_) => format!("the time at which {} was seen is yet to come", object.name),
                None => format!("no camera has seen {}", object.name),
            };
        };
        let seconds = age as f64 / 1000.0;
        let age = match &object.written_by {
            Some(by) => format!(
                "no camera has seen {} since {by} wrote its place {seconds:.1} s ago",
                object.name
            ),
            None => format!("no camera has seen {} for {seconds:.1} s", object.name),
        };
        match self.nearest([object.x, object.y], &object.name) {
            Some(near) => format!("{age}; nearest to where it was is {}", known(near, now)),
            None => age,
        }
    }
}

/// `red (seen 0.3 s ago)`.
#[must_use]
pub(crate) fn known(object: &Object, now: Time) -> String {
    format!("{} ({})", object.name, since_words(object, now))
}

/// Since when its place is known, in words.
#[must_use]
pub(crate) fn since_words(object: &Object, now: Time) -> String {
    let seconds = object.age_at(now).unwrap_or_default() as f64 / 1000.0;
    match (&object.written_by, object.seen) {
        (Some(by), _) => format!("written by {by} {seconds:.1} s ago"),
        (None, Some(_)) => format!("seen {seconds:.1} s ago"),
        (None, None) => "never seen".to_owned(),
    }
}

fn lies_on(upper: &Object, lower: &Object) -> bool {
    let beside = (upper.x - lower.x).hypot(upper.y - lower.y);
    let gap = upper.z - upper.size / 2.0 - lower.top();
    upper.name != lower.name && beside < BESIDE * upper.size.max(lower.size) && gap.abs() < LEVEL
}
