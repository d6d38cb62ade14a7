//! Which known word was probably meant, and how an error quotes a word.

pub use mom_nearest::nearest;

/// What helps the author of an unknown word: the nearest known one, or all of them.
#[must_use]
pub fn hint(word: &str, known: &[&str]) -> String {
    match nearest(word, known.iter().copied()) {
        Some(nearest) => format!("did you mean `{nearest}`?"),
        None if known.is_empty() => "none are defined here".to_owned(),
        None if known.len() == 1 => format!("expected `{}`", known.join("")),
        None => format!("expected one of `{}`", known.join("`, `")),
    }
}

/// That there is no such key, command or whatever else it is, with the [`hint`].
///
/// ```
/// let words = mom_toml_faults::unknown("key", "adress", &["unit", "address"]);
/// assert_eq!(words, "there is no key `adress`; did you mean `address`?");
/// ```
#[must_use]
pub fn unknown(what: &str, word: &str, known: &[&str]) -> String {
    format!("there is no {what} `{}`; {}", quoted(word), hint(word, known))
}

/// A word of another's text as an error quotes it: in one line, printable, and of at most 64 characters.
#[must_use]
pub fn quoted(word: &str) -> String {
    const MOST: usize = 64;
    let mut text = String::new();
    for c in word.chars().take(MOST) {
        match c {
            '"' | '\'' => text.push(c),
            c => text.extend(c.escape_debug()),
        }
    }
    if word.chars().nth(MOST).is_some() {
        text.push('…');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_similar_word_is_offered_and_otherwise_all() {
        assert_eq!(hint("moter", &["leds", "motor"]), "did you mean `motor`?");
        assert_eq!(
            hint("sing", &["leds", "motor"]),
            "expected one of `leds`, `motor`"
        );
        assert_eq!(hint("sing", &[]), "none are defined here");
        assert!(hint(&"m".repeat(1000), &["motor"]).starts_with("expected `motor`"));
    }

    #[test]
    fn what_is_quoted_is_short_and_printable() {
        assert_eq!(quoted("a\u{1b}b\u{202e}c\n\"d'"), "a\\u{1b}b\\u{202e}c\\n\"d'");
        assert_eq!(quoted(&"x".repeat(99)).chars().count(), 65);
    }
}
