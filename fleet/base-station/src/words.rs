//! Where something stands in a text, and which known word was probably meant.

use std::fmt;

/// A line and a column of a text, in characters, from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Spot {
    /// The line.
    pub line: usize,
    /// The column.
    pub column: usize,
}

impl Spot {
    /// The spot of a byte of a text.
    pub(crate) fn of(text: &str, at: usize) -> Spot {
        let before = text.get(..at).unwrap_or(text);
        let start = before.rfind('\n').map_or(0, |end| end + 1);
        Spot {
            line: before.matches('\n').count() + 1,
            column: before.get(start..).map_or(1, |line| line.chars().count() + 1),
        }
    }
}

impl fmt::Display for Spot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}, column {}", self.line, self.column)
    }
}

/// What helps whoever wrote an unknown word: the known word that is similar enough to be meant, or all that there are.
pub(crate) fn hint(word: &str, known: &[&str]) -> String {
    match nearest(word, known) {
        Some(nearest) => format!("did you mean `{nearest}`?"),
        None => format!("there are `{}`", known.join("`, `")),
    }
}

fn nearest<'a>(word: &str, known: &[&'a str]) -> Option<&'a str> {
    // The cost grows with the square of the length.
    const LONGEST_WORD: usize = 64;
    if word.len() > LONGEST_WORD {
        return None;
    }
    let allowed = (word.chars().count() / 3).max(1);
    known
        .iter()
        .map(|known| (strsim::osa_distance(word, known), *known))
        .filter(|(distance, _)| *distance <= allowed)
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, known)| known)
}

/// A word of somebody else's text as an error may quote it: not too long, and without control characters.
pub(crate) fn quoted(word: &str) -> String {
    const MOST: usize = 40;
    let mut text: String = word
        .chars()
        .take(MOST)
        .map(|c| if c.is_control() { '\u{fffd}' } else { c })
        .collect();
    if word.chars().nth(MOST).is_some() {
        text.push('…');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spot_counts_lines_and_characters_from_1() {
        let text = "ä b\nc";
        assert_eq!(Spot::of(text, 0), Spot { line: 1, column: 1 });
        assert_eq!(Spot::of(text, 3), Spot { line: 1, column: 3 });
        assert_eq!(Spot::of(text, 5), Spot { line: 2, column: 1 });
        assert_eq!(Spot::of(text, 99), Spot { line: 2, column: 2 });
    }

    #[test]
    fn a_similar_word_is_offered_and_otherwise_all() {
        assert_eq!(hint("moter", &["leds", "motor"]), "did you mean `motor`?");
        assert_eq!(hint("sing", &["leds", "motor"]), "there are `leds`, `motor`");
        assert!(hint(&"m".repeat(1000), &["motor"]).starts_with("there are"));
    }

    #[test]
    fn what_is_quoted_is_short_and_printable() {
        assert_eq!(quoted("a\u{1b}b"), "a\u{fffd}b");
        assert_eq!(quoted(&"x".repeat(99)).chars().count(), 41);
    }
}
