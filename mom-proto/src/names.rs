//! The characters allowed in names and text.

use unicode_normalization::char::is_combining_mark;
use unicode_normalization::{IsNormalized, is_nfc_quick};
use unicode_security::{GeneralSecurityProfile, RestrictionLevel, RestrictionLevelDetection};

use crate::{Code, WireError};

/// The name under which the hub itself sends.
pub const HUB: &str = "hub";

const NAME_BYTES: usize = 64;
const MESSAGE_NAME_BYTES: usize = 128;

/// Whether XML 1.0 can hold this character; strings hold no other, in every codec.
pub fn is_xml_char(c: char) -> bool {
    matches!(c, '\t' | '\n' | '\r' | ' '..='\u{D7FF}' | '\u{E000}'..='\u{FFFD}' | '\u{10000}'..='\u{10FFFF}')
}

/// The byte position of the first character that XML 1.0 cannot hold.
pub fn xml_violation(text: &str) -> Option<usize> {
    // All such characters are controls below 0x20, or U+FFFE and U+FFFF (bytes EF BF BE, EF BF BF).
    let bytes = text.as_bytes();
    let suspicious =
        |byte: u8| ((byte < 0x20) & (byte != b'\t') & (byte != b'\n') & (byte != b'\r')) | (byte == 0xEF);
    let mut start = 0;
    while let Some(found) = position_of(&bytes[start..], suspicious) {
        let position = start + found;
        if bytes[position] != 0xEF || matches!(bytes[position + 1..], [0xBF, 0xBE | 0xBF, ..]) {
            return Some(position);
        }
        start = position + 1;
    }
    None
}

/// The first byte that is so. Most texts have none: whole blocks are tried first, which compiles to vector
/// instructions if `is_so` has no branches.
#[inline]
pub(crate) fn position_of(bytes: &[u8], is_so: impl Fn(u8) -> bool) -> Option<usize> {
    const BLOCK: usize = 16;
    let any = |block: &[u8]| block.iter().fold(false, |any, byte| any | is_so(*byte));
    let (blocks, _) = bytes.as_chunks::<BLOCK>();
    let clean = blocks.iter().take_while(|block| !any(*block)).count() * BLOCK;
    let found = bytes[clean..].iter().position(|byte| is_so(*byte));
    found.map(|at| clean + at)
}

/// Checks text from outside.
///
/// # Errors
/// `bad-encoding` with the byte's position in the text.
pub fn check_text(text: &str) -> Result<(), WireError> {
    match xml_violation(text) {
        None => Ok(()),
        Some(position) => Err(WireError::new(
            Code::BAD_ENCODING,
            format!(
                "character {:?} is not allowed in a string",
                text[position..].chars().next().unwrap_or_default()
            ),
        )
        .position(position)),
    }
}

/// Checks a user name or nickname: 1–64 bytes of letters, digits, marks and `-_.@+=`, in NFC, and nothing that
/// looks like `hub`.
///
/// Invisible characters (zero width), confusing ones (controls, directions) and operators of paths and patterns (`/ ~
/// * # % \`) are excluded. So are obsolete letters, and mixtures of scripts that are not written together (UTS 39,
/// highly restrictive).
///
/// # Errors
/// `bad-name` in plain words.
pub fn check_name(name: &str) -> Result<(), WireError> {
    let refused = |why: String| Err(WireError::new(Code::BAD_NAME, format!("the name {name:?} {why}")));
    if name.is_empty() {
        return Err(WireError::new(
            Code::BAD_NAME,
            "a name needs at least one character",
        ));
    }
    if name.len() > NAME_BYTES {
        return Err(WireError::new(
            Code::BAD_NAME,
            format!("a name has at most {NAME_BYTES} bytes"),
        ));
    }
    if resembles(name, HUB) {
        return refused("is the hub's own, or looks like it".to_owned());
    }
    if name == "." || name == ".." {
        return refused("means a place in a path".to_owned());
    }
    if let Some(c) = name.chars().find(|&c| !is_segment_char(c) || c == '~') {
        return refused(format!("may not contain {c:?}"));
    }
    if !is_nfc(name) {
        return refused("is not in Unicode's composed form (NFC)".to_owned());
    }
    if mixes_scripts(name) {
        return refused("has letters of different scripts, so that it could be taken for another".to_owned());
    }
    Ok(())
}

/// The visual form of a name: names with equal forms are look-alikes (the skeleton of UTS 39).
///
/// ```
/// use mom_proto::looks_of;
/// assert_eq!(looks_of("\u{430}\u{441}\u{435}"), looks_of("ace"), "all of it Cyrillic");
/// assert_ne!(looks_of("Ace"), looks_of("ace"));
/// ```
pub fn looks_of(name: &str) -> String {
    unicode_security::skeleton(name).collect()
}

/// The forms by which a name is taken for another: names that share one differ only in the case of letters, in letters
/// that look alike, or in both. The first is [`looks_of`] the name in lower case.
///
/// There are several, because what looks alike depends on the case: `aIice` looks like `alice` with its capital I, and
/// `ALICE` only without.
///
/// ```
/// use mom_proto::folds_of;
/// let shared = |one, other| folds_of(one).iter().any(|fold| folds_of(other).contains(fold));
/// assert!(shared("Alice", "alice") && shared("aIice", "Alice") && shared("\u{430}\u{441}\u{435}", "ACE"));
/// assert!(!shared("alice", "alicia"));
/// ```
pub fn folds_of(name: &str) -> Vec<String> {
    let looks = looks_of(name);
    let mut folds = vec![looks_of(&name.to_lowercase()), looks.to_lowercase(), looks];
    // Most names have one form.
    let mut kept = 0;
    for index in 0..folds.len() {
        if !folds[..kept].contains(&folds[index]) {
            folds.swap(kept, index);
            kept += 1;
        }
    }
    folds.truncate(kept);
    folds
}

/// Whether a name could be taken for another, or is the same.
pub fn resembles(name: &str, other: &str) -> bool {
    let others = folds_of(other);
    folds_of(name).iter().any(|fold| others.contains(fold))
}

/// Checks the name of a message: 1–128 bytes, no controls, no blanks at its ends.
///
/// # Errors
/// `bad-name` in plain words.
pub fn check_message_name(name: &str) -> Result<(), WireError> {
    let fine = !name.is_empty()
        && name.len() <= MESSAGE_NAME_BYTES
        && name.trim() == name
        && !name.chars().any(|c| c.is_control() || !is_xml_char(c));
    if fine {
        return Ok(());
    }
    Err(WireError::new(
        Code::BAD_NAME,
        format!("a message's name has 1 to {MESSAGE_NAME_BYTES} bytes, no controls, no blanks at its ends"),
    )
    .slot("name"))
}

/// The peer name for the `count`th peer of a nickname: the nickname itself, then `~2`, `~3` …
pub fn numbered_name(nickname: &str, count: u32) -> String {
    match count {
        0 | 1 => nickname.to_owned(),
        _ => format!("{nickname}~{count}"),
    }
}

/// Whether a path segment may hold this character.
pub(crate) fn is_segment_char(c: char) -> bool {
    match c.is_ascii() {
        true => c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.' | '@' | '+' | '=' | '~'),
        // Some letters and marks are invisible, such as fillers and variation selectors.
        false => {
            (c.is_alphanumeric() || is_combining_mark(c)) && GeneralSecurityProfile::identifier_allowed(c)
        }
    }
}

/// Whether a name or segment has letters of scripts that are not written together, such as a Cyrillic one among
/// Latin ones.
pub(crate) fn mixes_scripts(text: &str) -> bool {
    if text.is_ascii() {
        return false;
    }
    let letters: String = text
        .chars()
        .filter(|c| !c.is_ascii() || c.is_ascii_alphanumeric())
        .collect();
    !letters.check_restriction_level(RestrictionLevel::HighlyRestrictive)
}

pub(crate) fn is_nfc(text: &str) -> bool {
    match is_nfc_quick(text.chars()) {
        IsNormalized::Yes => true,
        IsNormalized::No => false,
        IsNormalized::Maybe => unicode_normalization::is_nfc(text),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names() {
        for good in [
            "alice",
            "Zoë",
            "arm-2",
            "x.y_z@lab",
            "名前",
            "арм-2",
            "Tokyo東京タワー",
        ] {
            assert!(check_name(good).is_ok(), "{good}");
        }
        let long = "a".repeat(65);
        for bad in [
            "",
            "hub",
            "Hub",
            "HUB",
            "alice~2",
            "a/b",
            "*",
            "#",
            "..",
            "a b",
            "a\u{200b}",
            "a\u{202e}b",
            "Zoe\u{308}",
            "\u{430}lice",
            "alice\u{fe0f}",
            "alice\u{34f}",
            "alice\u{3164}",
            "\u{ff41}lice",
            "a\0",
            long.as_str(),
        ] {
            let error = check_name(bad).expect_err(bad);
            assert_eq!(error.code, Code::BAD_NAME);
        }
    }

    #[test]
    fn who_is_taken_for_whom() {
        for (name, other) in [
            ("alice", "Alice"),
            ("ALICE", "alice"),
            ("aIice", "alice"),
            ("Alice", "aIice"),
            ("a1ice", "ALICE"),
            ("bob", "B0B"),
            ("\u{430}\u{441}\u{435}", "Ace"),
            ("\u{410}\u{421}\u{415}", "ace"),
            ("Zoë", "ZOË"),
        ] {
            assert!(resembles(name, other) && resembles(other, name), "{name} {other}");
        }
        for (name, other) in [
            ("alice", "alicia"),
            ("arm-1", "arm-2"),
            ("jim", "kim"),
            ("Zoë", "zoe"),
        ] {
            assert!(!resembles(name, other), "{name} {other}");
        }
        assert_eq!(folds_of("zoe"), ["zoe"]);
    }

    #[test]
    fn only_characters_of_xml() {
        assert_eq!(xml_violation("tab\tand\r\n and ü and 😀 and \u{FFFD}"), None);
        for (text, position) in [("a\0", 1), ("\u{1b}[0m", 0), ("ab\u{FFFE}", 2), ("\u{FFFF}", 0)] {
            assert_eq!(xml_violation(text), Some(position), "{text:?}");
        }
    }
}
