//! Comments and prose are at most 140 columns wide: what is wider is not read in two panes, and its differences are hard to see.

use anyhow::Result;

use super::Report;
use super::tree::Tree;

/// Columns that a line may have.
const WIDEST: usize = 140;
/// The words of the papers, and history.
const LEFT_OUT: &[&str] = &["docs/papers.md", "CHANGELOG.md"];

pub(crate) fn check(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    for (path, line) in ["rs", "md"].iter().flat_map(|kind| wide_lines(tree, kind)) {
        report(path, line, format!("wider than {WIDEST} columns: break the line"));
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
    fn a_wide_line_is_named() {
        let text = format!("short\n{}\n", "a ".repeat(WIDEST));
        let found = super::super::found(check, &[("a.md", &text)]);
        assert_eq!(found, ["a.md:2: wider than 140 columns: break the line"]);
    }
}
