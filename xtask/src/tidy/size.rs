//! No source file is over 600 lines: a longer one has more than one reason to exist.

use anyhow::Result;

use super::Report;
use super::tree::Tree;

const LIMIT: usize = 600;
const EXTENSIONS: &[&str] = &["rs", "ts", "svelte", "css", "py", "sh"];

pub(crate) fn check(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    for (path, text) in tree.with_extension(EXTENSIONS) {
        let lines = text.lines().count();
        if lines > LIMIT {
            report(
                path,
                LIMIT + 1,
                format!("{lines} lines, {LIMIT} are the most: split it by its reasons to change"),
            );
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::found;
    use super::*;

    #[test]
    fn the_line_after_the_limit_is_one_too_many() {
        let (most, over) = ("x\n".repeat(LIMIT), "x\n".repeat(LIMIT + 1));
        let files = [
            ("a.rs", most.as_str()),
            ("b.rs", &over),
            ("c.py", &over),
            ("d.json", &over),
            ("e.svelte", &over),
            ("f.css", &over),
        ];
        let message = "601 lines, 600 are the most: split it by its reasons to change";
        assert_eq!(
            found(check, &files),
            ["b.rs", "c.py", "e.svelte", "f.css"].map(|file| format!("{file}:601: {message}"))
        );
    }
}
