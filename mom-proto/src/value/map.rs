//! The ordered map of values.

use indexmap::IndexMap;
use indexmap::map::Entry;

use super::Value;

/// String keys to values: in order, without duplicates.
///
/// Two maps are equal if they hold the same members in the same order.
///
/// ```
/// use mom_proto::{Map, Value};
/// let map = Map::new().with("place", 2).with("rule", "lab");
/// assert_eq!(map.get("place"), Some(&Value::Int(2)));
/// ```
#[derive(Clone, Debug, Default)]
pub struct Map(IndexMap<String, Value>);

impl Map {
    /// An empty map.
    pub fn new() -> Map {
        Map::default()
    }

    /// This map with one member more (or replaced, in its old place).
    #[must_use]
    pub fn with(mut self, key: &str, value: impl Into<Value>) -> Map {
        self.set(key, value);
        self
    }

    /// Sets a member; an existing one keeps its place.
    pub fn set(&mut self, key: &str, value: impl Into<Value>) {
        self.0.insert(key.to_owned(), value.into());
    }

    /// Adds a member, or gives it back if the key is there already. For decoders.
    ///
    /// # Errors
    /// The key, if the map holds it.
    pub fn insert_new(&mut self, key: String, value: Value) -> Result<(), String> {
        match self.0.entry(key) {
            Entry::Occupied(entry) => Err(entry.key().clone()),
            Entry::Vacant(entry) => {
                entry.insert(value);
                Ok(())
            }
        }
    }

    /// The member of this key.
    pub fn get(&self, key: &str) -> Option<&Value> {
        self.0.get(key)
    }

    /// Takes a member out; the others keep their order.
    pub fn remove(&mut self, key: &str) -> Option<Value> {
        self.0.shift_remove(key)
    }

    /// Whether the key is there.
    pub fn contains_key(&self, key: &str) -> bool {
        self.0.contains_key(key)
    }

    /// The number of members.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there is no member.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The members in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (&str, &Value)> {
        self.0.iter().map(|(key, value)| (key.as_str(), value))
    }

    /// The keys in order.
    pub fn keys(&self) -> impl ExactSizeIterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }
}

impl PartialEq for Map {
    fn eq(&self, other: &Map) -> bool {
        self.len() == other.len() && self.iter().eq(other.iter())
    }
}

impl IntoIterator for Map {
    type Item = (String, Value);
    type IntoIter = indexmap::map::IntoIter<String, Value>;

    fn into_iter(self) -> Self::IntoIter {
        self.0.into_iter()
    }
}

impl FromIterator<(String, Value)> for Map {
    fn from_iter<T: IntoIterator<Item = (String, Value)>>(members: T) -> Map {
        Map(members.into_iter().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equality_sees_the_order() {
        let forth = Map::new().with("a", 1).with("b", 2);
        let back = Map::new().with("b", 2).with("a", 1);
        assert_ne!(forth, back);
        assert_eq!(forth, Map::new().with("a", 1).with("b", 2));
    }

    #[test]
    fn duplicates_are_given_back() {
        let mut map = Map::new().with("a", 1);
        assert_eq!(map.insert_new("a".into(), Value::Null), Err("a".into()));
        assert_eq!(map.get("a"), Some(&Value::Int(1)));
    }
}
