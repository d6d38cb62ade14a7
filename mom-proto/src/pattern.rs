//! Patterns that rules match paths with.

use std::fmt;

use serde::{Deserialize, Deserializer};

use crate::{Code, Path, WireError};

/// A path with wildcards: `*` is any one segment, `**` at the end is the place itself and all below.
///
/// ```
/// use mom_proto::{Path, Pattern};
/// let below = Pattern::parse("/robot/**").unwrap();
/// assert!(below.matches(&Path::parse("/robot/arm").unwrap()));
/// assert!(below.matches(&Path::parse("/robot").unwrap()));
/// assert!(!below.matches(&Path::parse("/camera").unwrap()));
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pattern {
    text: String,
    segments: Vec<Segment>,
    below: bool,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Segment {
    Any,
    Exactly(String),
}

impl Pattern {
    /// Reads a pattern.
    ///
    /// # Errors
    /// `bad-path` for what cannot match any path.
    pub fn parse(text: &str) -> Result<Pattern, WireError> {
        let (fixed, below) = match text.strip_suffix("/**") {
            Some("") => ("/", true),
            Some(fixed) => (fixed, true),
            None => (text, false),
        };
        // A wildcard is not a path segment: what remains when it is replaced by one has to be a path.
        let plain: Vec<&str> = fixed
            .split('/')
            .map(|segment| if segment == "*" { "x" } else { segment })
            .collect();
        Path::parse(&plain.join("/")).map_err(|error| {
            WireError::new(Code::BAD_PATH, format!("in the pattern {text:?}: {}", error.text))
        })?;
        let segments = fixed
            .split('/')
            .filter(|segment| !segment.is_empty())
            .map(|segment| match segment {
                "*" => Segment::Any,
                exactly => Segment::Exactly(exactly.to_owned()),
            });
        Ok(Pattern {
            text: text.to_owned(),
            segments: segments.collect(),
            below,
        })
    }

    /// Whether the pattern covers this path.
    pub fn matches(&self, path: &Path) -> bool {
        let mut given = path.segments();
        let fits = self.segments.iter().all(|segment| match (segment, given.next()) {
            (_, None) => false,
            (Segment::Any, Some(_)) => true,
            (Segment::Exactly(exactly), Some(segment)) => exactly == segment,
        });
        fits && (self.below || given.next().is_none())
    }
}

impl fmt::Display for Pattern {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.text)
    }
}

impl<'de> Deserialize<'de> for Pattern {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Pattern, D::Error> {
        let text = String::deserialize(deserializer)?;
        Pattern::parse(&text).map_err(|error| serde::de::Error::custom(error.text))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(pattern: &str, path: &str, expected: bool) {
        let matched = Pattern::parse(pattern)
            .unwrap()
            .matches(&Path::parse(path).unwrap());
        assert_eq!(matched, expected, "{pattern} on {path}");
    }

    #[test]
    fn wildcards() {
        check("/", "/", true);
        check("/", "/a", false);
        check("/**", "/", true);
        check("/**", "/a/b", true);
        check("/a", "/a", true);
        check("/a", "/a/b", false);
        check("/a/**", "/a", true);
        check("/a/**", "/ab", false);
        check("/a/*", "/a/b", true);
        check("/a/*", "/a", false);
        check("/a/*", "/a/b/c", false);
        check("/*/token", "/robot/token", true);
        check("/*/token/**", "/robot/token/x", true);
    }

    #[test]
    fn what_matches_nothing_is_refused() {
        for bad in ["", "robot", "/a/**/b", "/a*", "/../x", "/a/"] {
            assert!(Pattern::parse(bad).is_err(), "{bad}");
        }
    }
}
