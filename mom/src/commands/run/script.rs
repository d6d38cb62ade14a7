//! A script file: each line is one command.

use mom_client::Card;
use mom_device::check_by_card;

use crate::failure::Failure;

/// One command: a line of the file without its comment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ScriptLine {
    /// The line in the file, 1 for the first.
    pub(super) line: usize,
    /// How many characters of the line are before the text.
    pub(super) indent: usize,
    /// The script text that is sent.
    pub(super) text: String,
}

impl ScriptLine {
    /// A command that stands in no file.
    pub(crate) fn alone(text: String) -> ScriptLine {
        ScriptLine {
            line: 1,
            indent: 0,
            text,
        }
    }
}

/// The commands of a file's text; lines with nothing but blanks and comments are none.
pub(super) fn commands(text: &str) -> Vec<ScriptLine> {
    let numbered = text.lines().enumerate();
    numbered
        .filter_map(|(index, line)| {
            let code = line.split_once('#').map_or(line, |(code, _comment)| code).trim();
            let nothing = code.trim_matches([';', ' ', '\t']).is_empty();
            let indent = line.chars().take_while(|char| char.is_whitespace()).count();
            (!nothing).then(|| ScriptLine {
                line: index + 1,
                indent,
                text: code.to_owned(),
            })
        })
        .collect()
}

/// Checks that the device of this card can read every command, before the first of them moves anything.
pub(super) fn check(file: &str, commands: &[ScriptLine], card: &Card) -> Result<(), Failure> {
    let wrong: Vec<String> = commands
        .iter()
        .filter_map(|command| {
            let error = check_by_card(card, &command.text).err()?;
            let column = command.indent + error.place().map_or(1, |(_, column)| column as usize);
            Some(format!("{file}:{}:{column}: {error}", command.line))
        })
        .collect();
    match wrong.is_empty() {
        true => Ok(()),
        false => Err(Failure::new(
            wrong.join("\n"),
            "nothing was sent; `mom card CHANNEL` lists the statements",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_command_per_line() {
        for (text, expected) in [
            ("", &[][..]),
            ("# nothing\n\n  ;; \n", &[]),
            ("home", &[(1, "home")]),
            (
                "# pick\nmove 1 2 3 4 5; grip close  # got it\r\n\n\thome # home; home\n",
                &[(2, "move 1 2 3 4 5; grip close"), (4, "home")],
            ),
        ] {
            let told = commands(text);
            let told: Vec<(usize, &str)> = told
                .iter()
                .map(|command| (command.line, command.text.as_str()))
                .collect();
            assert_eq!(told, expected, "{text:?}");
        }
    }

    #[test]
    fn mistakes_are_told_with_file_line_and_column_before_anything_is_sent() {
        let card = mom_device::card(&mom_camera::pan::Mount::default());
        let mistakes = check(
            "pick",
            &commands("home\n\n  home; loko 1 2\nturn 1 2\nwait -1"),
            &card,
        )
        .unwrap_err();
        let text = mistakes.to_string();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 2, "{text}");
        assert!(
            lines[0].starts_with("pick:3:9: ") && lines[0].contains("did you mean `look`?"),
            "{text}"
        );
        assert!(lines[1].starts_with("pick:5:6: "), "{text}");
        assert!(check("pick", &commands("home; look 1 2\nwait 5"), &card).is_ok());
    }
}
