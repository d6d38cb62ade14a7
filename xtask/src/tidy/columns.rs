//! Comments and prose are at most 140 columns wide: what is wider is not read in two panes, and its differences are hard to see.

use anyhow::Result;

use super::Report;
use super::tree::Tree;

/// Columns that a line may have.
const WIDEST: usize = 140;
/// Where the bounds stand that are to be lowered.
const HERE: &str = "xtask/src/tidy/columns.rs";
/// An extension, and how many lines of such files are wider at most. It may only fall.
const BOUNDS: &[(&str, usize)] = &[("rs", RUST), ("md", PROSE)];
const RUST: usize = 60;
const PROSE: usize = 1140;
/// So many fewer than the bound may there be before it is lowered.
const SLACK: usize = 20;
/// The words of the papers, and history.
const LEFT_OUT: &[&str] = &["docs/papers.md", "CHANGELOG.md"];

pub(crate) fn check(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    for (extension, bound) in BOUNDS {
        let wide = wide_lines(tree, extension);
        if wide.len() > *bound {
            let text = format!("{} lines of .{extension} files are wider than", wide.len());
            report(
                HERE,
                1,
                format!("{text} {WIDEST} columns, {bound} at most: break the new ones"),
            );
            // With nothing left over each of them is new, and can be named.
            for (path, line) in wide.iter().filter(|_| *bound == 0) {
                report(
                    path,
                    *line,
                    format!("wider than {WIDEST} columns: break the line"),
                );
            }
        } else if wide.len() + SLACK < *bound {
            let text = format!("{} lines of .{extension} files are wider than", wide.len());
            report(
                HERE,
                1,
                format!("{text} {WIDEST} columns: lower the bound, which is {bound}"),
            );
        }
    }
    Ok(())
}

/// The lines of comments (`rs`) or of prose (`md`) that are too wide: path and number.
fn wide_lines<'a>(tree: &'a Tree, extension: &str) -> Vec<(&'a str, usize)> {
    let mut found = Vec::new();
    for (path, text) in tree.with_extension(&[extension]) {
        if LEFT_OUT.contains(&path) {
            continue;
        }
        let mut in_code = false;
        for (number, line) in text.lines().enumerate() {
            let words = line.trim_start();
            let is_written = if extension == "rs" {
                words.starts_with("//")
            } else {
                let is_fence = words.starts_with("```");
                in_code ^= is_fence;
                !in_code && !is_fence && !words.starts_with('|')
            };
            if is_written && line.chars().count() > WIDEST && !ends_in_a_link(line) {
                found.push((path, number + 1));
            }
        }
    }
    found
}

/// Whether a line is wide only by an address that cannot be broken.
fn ends_in_a_link(line: &str) -> bool {
    let (before, last) = line.trim_end().rsplit_once(' ').unwrap_or(("", line));
    before.chars().count() < WIDEST && (last.contains("://") || last.contains("]("))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_and_prose_are_measured() {
        let wide = "ä ".repeat(71);
        let rust = format!("// {wide}x\nlet a = \"{wide}\";\n/// short\n");
        let prose = format!("{wide}\n\n| {wide} |\n```\n{wide}\n```\n{}\n", "ä".repeat(WIDEST));
        let link = format!("{} <https://example.org/{wide}>", "a".repeat(100)).replace("ä ", "a");
        let files = [
            ("a.rs", rust.as_str()),
            ("b.md", &prose),
            ("c.md", &link),
            ("docs/papers.md", &prose),
        ];
        let tree = Tree::of(&files);
        assert_eq!(wide_lines(&tree, "rs"), [("a.rs", 1)]);
        assert_eq!(wide_lines(&tree, "md"), [("b.md", 1)]);
    }

    #[test]
    fn more_than_the_bound_is_found() {
        let text = format!("{}\n", "a ".repeat(WIDEST)).repeat(RUST.max(PROSE) + 1);
        let found = super::super::found(check, &[("a.md", &text)]);
        assert!(
            found.iter().any(|line| line.contains("wider than 140 columns")),
            "{found:?}"
        );
    }
}
