//! A reserved word of the glossary is the name of one thing: a type of that name may be defined only in the folders that
//! its row names, and once in each. A second meaning under the same name misleads every reader who knows the first.

use std::collections::BTreeMap;

use anyhow::Result;

use super::Report;
use super::modules::{Use, packages, reached};
use super::rust_text::{RustText, words};
use super::tree::{Tree, line_at};

const GLOSSARY: &str = "docs/glossary.md";

/// Top folders whose packages are not shipped: in a test `Peer` may be any that speaks.
const NOT_SHIPPED: &[&str] = &["", "tests", "benches", "xtask"];

/// One reserved word.
#[derive(Debug, PartialEq, Eq)]
struct Row<'a> {
    line: usize,
    /// The word as the name of a type.
    name: String,
    /// Where a type of that name may be defined; empty = nowhere.
    folders: Vec<&'a str>,
    /// Whether the word may not be a part of a type's name either.
    in_compounds: bool,
}

/// A type that has the name of a reserved word.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Definition {
    path: String,
    line: usize,
}

pub(crate) fn check(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    let rows = rows(tree.text(GLOSSARY).unwrap_or_default());
    if rows.is_empty() {
        let text = "no row `| word | meaning | folders |` is found here";
        report(GLOSSARY, 1, text.to_owned());
        return Ok(());
    }
    let mut defined = definitions(tree, &rows);
    for row in &rows {
        for folder in row.folders.iter().filter(|folder| !tree.exists(folder)) {
            let text = format!("`{folder}`, where `{}` may be, is not here", row.name);
            report(GLOSSARY, row.line, text);
        }
        row.check(&defined.remove(&row.name).unwrap_or_default(), report);
    }
    // Left are the compounds.
    for (name, definitions) in &defined {
        for Definition { path, line } in definitions {
            let text =
                format!("`{name}` contains a word that is not used: {GLOSSARY} says what to say instead");
            report(path, *line, text);
        }
    }
    Ok(())
}

impl Row<'_> {
    /// Reports the definitions that are in no folder of this word, or not the first in one.
    fn check(&self, definitions: &[Definition], report: &mut Report<'_>) {
        let mut first: BTreeMap<&str, &str> = BTreeMap::new();
        for Definition { path, line } in definitions {
            let Some(folder) = self.folder_of(path) else {
                report(path, *line, self.foreign());
                continue;
            };
            if let Some(first) = first.get(folder) {
                let name = &self.name;
                let text = format!("`{name}` is defined in {first} too: one of them needs another name");
                report(path, *line, text);
            }
            first.entry(folder).or_insert(path);
        }
    }

    fn folder_of(&self, path: &str) -> Option<&str> {
        let mut folders = self.folders.iter();
        folders
            .find(|folder| {
                path.strip_prefix(**folder)
                    .is_some_and(|rest| rest.starts_with('/'))
            })
            .copied()
    }

    fn foreign(&self) -> String {
        let name = &self.name;
        match self.folders.is_empty() {
            true => format!(
                "`{name}` is the name of no type: {GLOSSARY} says what the word means, or what to say instead"
            ),
            false => format!(
                "`{name}` may be defined only in {}: give this another name, or {GLOSSARY} another row",
                self.folders.join(", ")
            ),
        }
    }
}

/// The rows of all tables: the word first, its folders last.
fn rows(document: &str) -> Vec<Row<'_>> {
    let mut found = Vec::new();
    for (number, line) in document.lines().enumerate() {
        let Some(cells) = line
            .trim()
            .strip_prefix('|')
            .and_then(|line| line.strip_suffix('|'))
        else {
            continue;
        };
        let cells: Vec<&str> = cells.split('|').map(str::trim).collect();
        let ([word, .., last], true) = (&cells[..], cells.len() == 3) else {
            continue;
        };
        let is_head = *word == "word" || word.chars().all(|next| "-: ".contains(next));
        if !is_head {
            found.push(Row {
                line: number + 1,
                name: type_name(word),
                in_compounds: last.contains("compounds"),
                folders: last
                    .split('`')
                    .skip(1)
                    .step_by(2)
                    .filter(|span| span.contains('/'))
                    .collect(),
            });
        }
    }
    found
}

/// `parcel run` as `ParcelRun`.
fn type_name(word: &str) -> String {
    let capital = |part: &str| {
        let mut letters = part.chars();
        letters
            .next()
            .map(|first| first.to_uppercase().chain(letters).collect::<String>())
    };
    word.split([' ', '-']).filter_map(capital).collect()
}

/// The words of a name: `ParcelRun` as `Parcel` and `Run`.
fn parts(name: &str) -> Vec<&str> {
    let starts = name
        .char_indices()
        .filter(|(at, next)| *at == 0 || next.is_uppercase())
        .map(|(at, _)| at);
    let starts: Vec<usize> = starts.collect();
    let ends = starts.iter().skip(1).copied().chain([name.len()]);
    starts
        .iter()
        .zip(ends)
        .map(|(start, end)| &name[*start..end])
        .collect()
}

/// Where the shipped code defines types that have the names of `rows`.
fn definitions(tree: &Tree, rows: &[Row<'_>]) -> BTreeMap<String, Vec<Definition>> {
    let is_reserved = |name: &str| {
        let row = rows
            .iter()
            .find(|row| row.name == name || row.in_compounds && parts(name).contains(&row.name.as_str()));
        row.is_some()
    };
    let mut found: BTreeMap<String, Vec<Definition>> = BTreeMap::new();
    let packages = packages(tree).into_iter();
    let top = |package: &str| package.split('/').next().unwrap_or_default().to_owned();
    for package in packages.filter(|package| !NOT_SHIPPED.contains(&top(package).as_str())) {
        for (path, how) in reached(tree, package) {
            let Some(text) = tree.rust_text(&path).filter(|_| how == Use::Shipped) else {
                continue;
            };
            for (at, name) in types(text, &is_reserved) {
                found.entry(name.to_owned()).or_default().push(Definition {
                    path: path.clone(),
                    line: line_at(&text.code, at),
                });
            }
        }
    }
    found
}

/// The types with a reserved name that a source defines outside of its tests.
fn types<'a>(text: &'a RustText, is_reserved: &dyn Fn(&str) -> bool) -> Vec<(usize, &'a str)> {
    let code = text.code.as_str();
    let mut found = Vec::new();
    let mut words = words(code).peekable();
    while let Some((at, keyword)) = words.next() {
        let Some(&(_, name)) = words.peek().filter(|(_, name)| is_reserved(name)) else {
            continue;
        };
        let defines = match keyword {
            "struct" | "enum" | "trait" => true,
            // Deeper it is the associated type of a trait, whose name the trait has chosen.
            "type" => code[..at].matches('{').count() == code[..at].matches('}').count(),
            _ => false,
        };
        if defines {
            found.push((at, name));
        }
    }
    if !found.is_empty() {
        let tests = text.test_regions();
        found.retain(|(at, _)| !tests.iter().any(|region| region.contains(at)));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::super::found;
    use super::*;

    const TABLE: &str = "# Words\n\n| word | meaning | types |\n|---|---|---|\n\
        | token | What one peer owns. | `hub/src`, `cli/src` |\n\
        | parcel run | Messages. | `hub/src` |\n\
        | fence | A number. | none |\n\
        | gatherer | batch | none, nor in compounds |\n";

    fn faults(hub: &str, cli: &str) -> Vec<String> {
        let files = [
            (GLOSSARY, TABLE),
            ("hub/Cargo.toml", ""),
            ("hub/src/lib.rs", hub),
            ("cli/Cargo.toml", ""),
            ("cli/src/lib.rs", cli),
            ("tests/Cargo.toml", ""),
            ("tests/src/lib.rs", "struct Fence;"),
            ("benches/others/Cargo.toml", ""),
            ("benches/others/src/lib.rs", "struct Fence;"),
        ];
        let mut found = Vec::new();
        check(&Tree::of(&files), &mut |file: &str, line, message| {
            found.push(format!("{file}:{line}: {message}"));
        })
        .unwrap();
        found
    }

    const NONE: [&str; 0] = [];

    #[test]
    fn a_word_is_defined_in_its_rooms() {
        let hub = "pub(crate) struct Token { a: u8 }\nenum ParcelRun {}\nstruct Tokens;\n// struct Fence;\n";
        let cli = "pub struct Token<'a>(&'a str);\nimpl Iterator for X { type Fence = u8; }\n\
            #[cfg(test)]\nmod tests { struct Fence; }";
        assert_eq!(faults(hub, cli), NONE);
    }

    #[test]
    fn a_word_in_another_room_is_found() {
        assert_eq!(
            faults("", "\npub trait ParcelRun {}"),
            [
                "cli/src/lib.rs:2: `ParcelRun` may be defined only in hub/src: give this another name, or docs/glossary.md another row"
            ]
        );
        assert_eq!(
            faults("type Fence = u64;", ""),
            [
                "hub/src/lib.rs:1: `Fence` is the name of no type: docs/glossary.md says what the word means, or what to say instead"
            ]
        );
    }

    #[test]
    fn a_word_that_is_not_used_is_found_in_compounds() {
        let hub = "struct BatchGatherer; struct Gatherers; struct FenceGuard;";
        assert_eq!(
            faults(hub, ""),
            [
                "hub/src/lib.rs:1: `BatchGatherer` contains a word that is not used: docs/glossary.md says what to say instead"
            ]
        );
    }

    #[test]
    fn a_word_is_defined_once_in_a_room() {
        assert_eq!(
            faults("struct Token;\nmod a { enum Token {} }", ""),
            ["hub/src/lib.rs:2: `Token` is defined in hub/src/lib.rs too: one of them needs another name"]
        );
    }

    #[test]
    fn a_table_of_another_shape_is_no_success() {
        let found = found(check, &[(GLOSSARY, "| a |\n|---|\n| b |")]);
        assert_eq!(
            found,
            ["docs/glossary.md:1: no row `| word | meaning | folders |` is found here"]
        );
        let folders = TABLE.replace("cli/src", "gone/src");
        let files = [(GLOSSARY, folders.as_str()), ("hub/src/lib.rs", "")];
        let found = super::super::found(check, &files);
        assert_eq!(
            found,
            ["docs/glossary.md:5: `gone/src`, where `Token` may be, is not here"]
        );
    }
}
