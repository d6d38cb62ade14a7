//! Turns of phrase that a reader stumbles over: each may only become rarer.

use anyhow::Result;

use super::Report;
use super::tree::Tree;

/// Where the bound stands that is to be lowered.
const HERE: &str = "xtask/src/tidy/turns.rs";

/// A turn, how often it stands in the project at most, and what to write instead.
const TURNS: &[(&str, usize, &str)] = &[
    (" is no ", 24, "`is not a`, `there is no`"),
    ("whoever", 23, "who does it: `the sender`, `the owner`"),
    ("somebody", 36, "who it is: `a peer`, `the operator`"),
];
/// So many fewer than the bound may there be before it is lowered.
const SLACK: usize = 20;

/// What is written by people for people.
const WRITTEN: &[&str] = &["rs", "md", "ts", "mjs", "py", "svelte", "toml"];
/// The papers' words, and history.
const LEFT_OUT: &[&str] = &["docs/papers.md", "CHANGELOG.md", HERE];

pub(crate) fn check(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    for (turn, most, instead) in TURNS {
        let count = count(tree, turn);
        if count > *most {
            report(
                HERE,
                1,
                format!("`{turn}` stands {count} times, {most} at most: write {instead}"),
            );
        } else if count + SLACK < *most {
            report(
                HERE,
                1,
                format!("`{turn}` stands {count} times: lower its bound, which is {most}"),
            );
        }
    }
    Ok(())
}

/// How often a turn stands, in any case of its letters; `there is no` is not one.
fn count(tree: &Tree, turn: &str) -> usize {
    let files = tree
        .with_extension(WRITTEN)
        .filter(|(path, _)| !LEFT_OUT.contains(path));
    let each = files.map(|(_, text)| {
        let text = text.to_lowercase();
        let there = |(at, _): &(usize, &str)| text[..*at].ends_with("there");
        text.match_indices(turn).filter(|found| !there(found)).count()
    });
    each.sum()
}

#[cfg(test)]
mod tests {
    use super::super::found;
    use super::*;

    #[test]
    fn a_turn_is_counted_in_what_people_read() {
        let tree = Tree::of(&[
            (
                "a.rs",
                "// Whoever reads; somebody else. It is\u{20}no word, and there is no other.",
            ),
            ("docs/papers.md", "whoever"),
            ("b.svg", "whoever"),
        ]);
        assert_eq!(
            TURNS
                .iter()
                .map(|(turn, _, _)| count(&tree, turn))
                .collect::<Vec<_>>(),
            [1, 1, 1]
        );
    }

    #[test]
    fn more_than_before_is_found() {
        let text = "whoever ".repeat(1000);
        let found = found(check, &[("a.md", &text)]);
        assert!(
            found
                .iter()
                .any(|line| line.contains("`whoever` stands 1000 times")),
            "{found:?}"
        );
    }
}
