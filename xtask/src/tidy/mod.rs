//! `cargo xtask tidy`: what the compiler does not check. One file per check, each with the reason for its rule.

mod circles;
mod citations;
mod codes;
mod columns;
mod dependencies;
mod dialogues;
mod glossary;
mod imports;
mod leftovers;
mod links;
mod modules;
mod names;
mod orphans;
mod purity;
mod room_order;
mod rooms;
mod rust_text;
mod script_rooms;
mod size;
mod tree;
mod turns;

use std::fmt;
use std::path::Path;

use anyhow::{Context as _, Result};

pub(crate) use tree::Tree;

/// One thing that is not as it should be; shown as `file:line: check: message`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Finding {
    file: String,
    line: usize,
    check: &'static str,
    message: String,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}: {}: {}", self.file, self.line, self.check, self.message)
    }
}

/// What a check calls for each thing it finds: file, line from 1, message.
type Report<'a> = dyn FnMut(&str, usize, String) + 'a;

/// A check looks at the whole tree and reports what is wrong; an error means that it could not look.
type Check = fn(&Tree, &mut Report<'_>) -> Result<()>;

const CHECKS: &[(&str, Check)] = &[
    ("size", size::check),
    ("orphan", orphans::check),
    ("codes", codes::check),
    ("imports", imports::check),
    ("imports", imports::check_resolved),
    ("unused", dependencies::check),
    ("rooms", rooms::check),
    ("rooms", script_rooms::check),
    ("purity", purity::check),
    ("leftover", leftovers::check),
    ("link", links::check),
    ("cite", citations::check),
    ("word", glossary::check),
    ("name", names::check),
    ("turn", turns::check),
    ("columns", columns::check),
    ("dialogue", dialogues::check),
];

/// Runs all checks on the checkout at `root` and prints the findings; whether there were none.
pub(crate) fn run(root: &Path) -> Result<bool> {
    let tree = Tree::read(root)?;
    let findings = findings(&tree, CHECKS)?;
    for finding in &findings {
        println!("{finding}");
    }
    let looked = format!("{} files, {} checks", tree.len(), CHECKS.len());
    match findings.len() {
        0 => println!("tidy: {looked}, nothing found"),
        1 => println!("tidy: {looked}, 1 finding"),
        number => println!("tidy: {looked}, {number} findings"),
    }
    Ok(findings.is_empty())
}

fn findings(tree: &Tree, checks: &[(&'static str, Check)]) -> Result<Vec<Finding>> {
    let mut findings = Vec::new();
    for (name, check) in checks {
        let mut report = |file: &str, line: usize, message: String| {
            findings.push(Finding {
                file: file.to_owned(),
                line,
                check: name,
                message,
            });
        };
        check(tree, &mut report).with_context(|| format!("the check `{name}` could not be made"))?;
    }
    findings.sort();
    findings.dedup();
    Ok(findings)
}

/// For the tests of the checks: what `check` finds in a tree of these files, as `file:line: message`.
#[cfg(test)]
fn found(check: Check, files: &[(&str, &str)]) -> Vec<String> {
    let tree = Tree::of(files);
    findings(&tree, &[("test", check)])
        .unwrap()
        .into_iter()
        .map(|finding| format!("{}:{}: {}", finding.file, finding.line, finding.message))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn findings_are_sorted_and_shown_with_their_place() {
        let check: Check = |_, report| {
            report("b.rs", 2, "second".to_owned());
            report("a.rs", 9, "first".to_owned());
            report("a.rs", 9, "first".to_owned());
            Ok(())
        };
        let shown: Vec<_> = findings(&Tree::of(&[]), &[("demo", check)])
            .unwrap()
            .iter()
            .map(ToString::to_string)
            .collect();
        assert_eq!(shown, ["a.rs:9: demo: first", "b.rs:2: demo: second"]);
    }

    #[test]
    fn a_check_that_cannot_be_made_is_no_success() {
        let check: Check = |_, _| anyhow::bail!("no cargo");
        let error = findings(&Tree::of(&[]), &[("demo", check)]).unwrap_err();
        assert_eq!(
            format!("{error:#}"),
            "the check `demo` could not be made: no cargo"
        );
    }
}
