//! Paths of contexts in the tree (M21).

use std::borrow::Borrow;
use std::fmt;
use std::sync::Arc;

use crate::names::{is_nfc, is_segment_char, mixes_scripts};
use crate::{Code, WireError};

const BYTES: usize = 1024;
const LEVELS: usize = 32;

/// The canonical path of a context: `/` or `/a/b`.
///
/// Segments hold letters, digits, marks and `-_.@+=~`, in NFC; `.` and `..` are refused, as are empty segments,
/// escapes and a slash at the end. So two paths are the same context only if they are equal, and rules that match a
/// path cannot be bypassed. A segment that imitates another with letters of different scripts or with invisible
/// characters is refused as well. At most 1 KiB and 32 levels.
///
/// ```
/// use mom_proto::Path;
/// let arm = Path::parse("/robot/arm").unwrap();
/// assert_eq!(arm.parent().unwrap().as_str(), "/robot");
/// assert!(Path::parse("/robot/../secret").is_err());
/// ```
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Path(Arc<str>);

impl Path {
    /// The root, `/`.
    pub fn root() -> Path {
        Path(Arc::from("/"))
    }

    /// Reads the canonical form.
    ///
    /// # Errors
    /// `bad-path`, with the position of the fault.
    pub fn parse(text: &str) -> Result<Path, WireError> {
        check(text)?;
        Ok(Path(Arc::from(text)))
    }

    /// The path of a child.
    ///
    /// # Errors
    /// `bad-path` if the segment is invalid or the path becomes too long.
    pub fn child(&self, segment: &str) -> Result<Path, WireError> {
        match self.is_root() {
            true => Path::parse(&format!("/{segment}")),
            false => Path::parse(&format!("{self}/{segment}")),
        }
    }

    /// The text form.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Whether this is `/`.
    pub fn is_root(&self) -> bool {
        &*self.0 == "/"
    }

    /// The path above; none above the root.
    pub fn parent(&self) -> Option<Path> {
        if self.is_root() {
            return None;
        }
        match self.0.rfind('/') {
            Some(0) | None => Some(Path::root()),
            Some(at) => Some(Path(Arc::from(&self.0[..at]))),
        }
    }

    /// The last segment; empty for the root.
    pub fn name(&self) -> &str {
        self.0.rsplit('/').next().unwrap_or_default()
    }

    /// The segments from the root down; none for the root.
    pub fn segments(&self) -> impl Iterator<Item = &str> {
        self.0.split('/').filter(|segment| !segment.is_empty())
    }

    /// Whether this is `other` or lies below it.
    pub fn is_within(&self, other: &Path) -> bool {
        other.is_root()
            || self
                .0
                .strip_prefix(&*other.0)
                .is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
    }

    /// The shared text, for tables that hold many.
    pub fn shared(&self) -> Arc<str> {
        Arc::clone(&self.0)
    }
}

/// Paths are ordered as their texts are.
impl Borrow<str> for Path {
    fn borrow(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Path {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

impl fmt::Debug for Path {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Path({})", self.0)
    }
}

impl std::str::FromStr for Path {
    type Err = WireError;

    fn from_str(text: &str) -> Result<Path, WireError> {
        Path::parse(text)
    }
}

fn check(text: &str) -> Result<(), WireError> {
    let bad = |why: &str, position: usize| Err(WireError::new(Code::BAD_PATH, why).position(position));
    if text.len() > BYTES {
        return bad("a path has at most 1 KiB", BYTES);
    }
    if !text.starts_with('/') {
        return bad("a path begins with a slash, like /robot/arm", 0);
    }
    if text == "/" {
        return Ok(());
    }
    let mut position = 1;
    for (level, segment) in text[1..].split('/').enumerate() {
        if level >= LEVELS {
            return bad("a path has at most 32 levels", position);
        }
        if segment.is_empty() {
            return bad("a path has no empty segment and no slash at its end", position);
        }
        if segment == "." || segment == ".." {
            return bad("a path has no . and no .. in it", position);
        }
        if let Some((at, c)) = segment.char_indices().find(|&(_, c)| !is_segment_char(c)) {
            return bad(&format!("a path may not contain {c:?}"), position + at);
        }
        if mixes_scripts(segment) {
            let why =
                "a segment of a path has no letters of different scripts: it could be taken for another";
            return bad(why, position);
        }
        position += segment.len() + 1;
    }
    match is_nfc(text) {
        true => Ok(()),
        false => bad("a path is written in Unicode's composed form (NFC)", 0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Threat 11.
    #[test]
    fn one_canonical_form() {
        for good in [
            "/",
            "/robot",
            "/robot/arm",
            "/home/alice~2",
            "/名/前",
            "/a.b/c..d",
        ] {
            assert_eq!(
                Path::parse(good).map(|path| path.to_string()),
                Ok(good.to_owned())
            );
        }
        let long = format!("/{}", "a".repeat(BYTES));
        let deep = "/a".repeat(33);
        for (bad, position) in [
            ("", 0),
            ("robot", 0),
            ("//", 1),
            ("/robot/", 7),
            ("/robot//arm", 7),
            ("/robot/../x", 7),
            ("/./x", 1),
            ("/a/%2e%2e", 3),
            ("/a\\b", 2),
            ("/a\0", 2),
            ("/a b", 2),
            ("/*", 1),
            ("/#", 1),
            ("/e\u{301}", 0),
            (long.as_str(), BYTES),
            (deep.as_str(), 65),
        ] {
            let error = Path::parse(bad).expect_err(bad);
            assert_eq!(error.code, Code::BAD_PATH, "{bad}");
            assert_eq!(
                error.get("position").and_then(crate::Value::as_int),
                i64::try_from(position).ok(),
                "{bad}"
            );
        }
    }

    #[test]
    fn places_in_the_tree() {
        let arm = Path::parse("/robot/arm").unwrap();
        let robot = arm.parent().unwrap();
        assert_eq!((robot.as_str(), arm.name()), ("/robot", "arm"));
        assert_eq!(robot.parent(), Some(Path::root()));
        assert_eq!(Path::root().parent(), None);
        assert!(arm.is_within(&robot) && arm.is_within(&Path::root()) && arm.is_within(&arm));
        assert!(!Path::parse("/robots").unwrap().is_within(&robot));
        assert_eq!(Path::root().child("robot"), Ok(robot));
    }
}
