//! The colours, by what they mean. They are always written; the stream takes them out where there is no
//! terminal, or `NO_COLOR` is set.

use std::fmt::Display;

use owo_colors::{OwoColorize as _, Style};

/// What a piece of text means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Tone {
    /// A path of a context, an address of a hub.
    Place,
    /// A peer.
    Peer,
    /// Something that went well, a free token.
    Good,
    /// Something to look at: a held token, an event.
    Notice,
    /// An error.
    Bad,
    /// What may be overlooked: times, kinds.
    Faint,
    /// A heading.
    Strong,
    /// A command to copy.
    Command,
}

/// The text in the colour of its meaning.
pub(crate) fn ink(text: impl Display, ink: Tone) -> String {
    text.style(style(ink)).to_string()
}

/// The text in its colour, padded with blanks to a width that its letters alone are counted for.
pub(crate) fn padded(text: &str, width: usize, as_ink: Tone) -> String {
    let blanks = " ".repeat(width.saturating_sub(text.chars().count()));
    match text.is_empty() {
        // Empty text gets no colour: escapes would hide that the line ends in blanks.
        true => blanks,
        false => format!("{}{blanks}", ink(text, as_ink)),
    }
}

fn style(ink: Tone) -> Style {
    let plain = Style::new();
    match ink {
        Tone::Place => plain.blue(),
        Tone::Peer => plain.cyan(),
        Tone::Good => plain.green(),
        Tone::Notice => plain.yellow(),
        Tone::Bad => plain.red().bold(),
        Tone::Faint => plain.dimmed(),
        Tone::Strong => plain.bold(),
        Tone::Command => plain.green(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn padding_does_not_count_the_colour() {
        let plain = anstream::adapter::strip_str(&padded("Zoë", 5, Tone::Peer)).to_string();
        assert_eq!(plain, "Zoë  ");
        assert_eq!(
            anstream::adapter::strip_str(&padded("longer", 5, Tone::Peer)).to_string(),
            "longer"
        );
    }
}
