//! Text of others as people may see it.

/// Text of others, safe to show on one line of a terminal: what would move the cursor, start a new line or
/// turn the direction of writing is shown as an escape.
pub fn visible(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '\t' => shown.push(' '),
            c if c.is_control() || turns_direction(c) => shown.extend(c.escape_default()),
            c => shown.push(c),
        }
    }
    shown
}

fn turns_direction(c: char) -> bool {
    matches!(c, '\u{200E}' | '\u{200F}' | '\u{2028}'..='\u{202E}' | '\u{2066}'..='\u{2069}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nobody_paints_on_our_terminal() {
        for (text, shown) in [
            ("good morning", "good morning"),
            ("Zoë 名前 😀", "Zoë 名前 😀"),
            ("a\nb\r\tc", "a\\nb\\r c"),
            ("\u{9b}2J", "\\u{9b}2J"),
            ("ab\u{202e}c", "ab\\u{202e}c"),
        ] {
            assert_eq!(visible(text), shown);
        }
    }
}
