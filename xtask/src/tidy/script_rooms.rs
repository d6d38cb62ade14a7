//! Which rooms of what is written in TypeScript and Python use which. A room is a folder or a file directly in the folder of a client or of
//! the console, and none may lead back to itself by way of others. Imports of types alone count as well: who reads a file reads them.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Result, ensure};

use super::Report;
use super::circles::circles;
use super::tree::{Tree, folder_of, join};

/// The folders whose rooms are looked at.
const HOUSES: &[&str] = &["clients/js/src", "clients/python/src/mom", "console/src"];

/// What stands before the name of a file in JavaScript and TypeScript.
const BEFORE: [&str; 3] = ["from ", "import ", "import("];

pub(crate) fn check(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    check_houses(HOUSES, tree, report)
}

fn check_houses(houses: &[&str], tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    for house in houses {
        let mut uses: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        let mut files = BTreeMap::new();
        for (path, text) in tree.with_extension(&["ts", "svelte", "js", "mjs", "py"]) {
            let Some(room) = room(house, path) else { continue };
            let imported = match path.ends_with(".py") {
                true => python(path, text),
                false => script(path, text),
            };
            let used = imported.iter().filter_map(|path| self::room(house, path));
            uses.entry(room.clone()).or_default().extend(used);
            files.entry(room).or_insert(path);
        }
        ensure!(!uses.is_empty(), "{house} has no scripts");
        for circle in circles(&uses) {
            let text = format!(
                "{} use each other: a room uses only those below it",
                circle.join(", ")
            );
            report(files.get(circle[0]).copied().unwrap_or(house), 1, text);
        }
    }
    Ok(())
}

/// The room of a file in this folder; none for one that is elsewhere.
fn room(house: &str, path: &str) -> Option<String> {
    let inside = path.strip_prefix(house)?.strip_prefix('/')?;
    let name = inside.split('/').next()?;
    Some(name.split('.').next().unwrap_or(name).to_owned())
}

/// The paths that a file in JavaScript or TypeScript imports, of those that it names by where they are.
fn script(path: &str, text: &str) -> Vec<String> {
    let mut found = Vec::new();
    for before in BEFORE {
        for (at, word) in text.match_indices(before) {
            let rest = &text[at + word.len()..];
            let Some(quote) = rest.chars().next().filter(|first| matches!(first, '"' | '\'')) else {
                continue;
            };
            let name = rest[1..].split(quote).next().unwrap_or_default();
            if name.starts_with('.') {
                found.extend(join(folder_of(path), name));
            }
        }
    }
    found
}

/// The paths, without `.py`, that a module in Python imports from its own package.
fn python(path: &str, text: &str) -> Vec<String> {
    let mut found = Vec::new();
    for line in text.lines() {
        let Some((module, names)) =
            (line.trim_start().strip_prefix("from .")).and_then(|rest| rest.split_once(" import "))
        else {
            continue;
        };
        let above = module.chars().take_while(|dot| *dot == '.').count();
        let module = &module[above..];
        let folder = format!("{}{}", "../".repeat(above), module.replace('.', "/"));
        if module.is_empty() {
            // The names are modules themselves.
            let names = names.trim_matches(|c| matches!(c, '(' | ')' | ' ')).split(',');
            let names = names.filter_map(|name| name.split_whitespace().next());
            found.extend(names.filter_map(|name| join(folder_of(path), &format!("{folder}{name}"))));
        } else {
            found.extend(join(folder_of(path), &folder));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tidy::{Check, found};

    const CHECK: Check = |tree, report| check_houses(&["src"], tree, report);

    #[test]
    fn circles_of_scripts_are_found() {
        for low in [
            "import { a } from \"./top.js\";",
            "import type { A } from './top.js';",
            "import {\n  a,\n  type B,\n} from \"./top.js\";",
            "export * from \"./top.js\";",
            "import \"./top.js\";",
            "const top = await import(\"./top.js\");",
            "import { part } from \"./middle/part.svelte.js\";",
        ] {
            let files = [
                ("src/top.ts", "import { part } from \"./middle/part.svelte.js\";"),
                ("src/middle/part.svelte.ts", "import { low } from \"../low.js\";"),
                (
                    "src/middle/other.ts",
                    "import { part } from \"./part.svelte.js\";",
                ),
                ("src/low.ts", low),
            ];
            let found = found(CHECK, &files);
            assert!(
                found.len() == 1 && found[0].starts_with("src/low.ts:1: low, middle"),
                "{low}: {found:?}"
            );
        }
    }

    #[test]
    fn arrows_downwards_of_scripts_are_free() {
        for low in [
            "import { top } from \"top\";",
            "import { Other } from \"../other/top.js\";",
            "const words = \"from ./top.js\";",
            "",
        ] {
            let files = [
                ("src/top.ts", "import { low } from \"./low.js\";"),
                ("src/low.ts", low),
            ];
            assert_eq!(found(CHECK, &files), [] as [&str; 0], "{low}");
        }
    }

    #[test]
    fn circles_of_modules_in_python_are_found() {
        for low in [
            "from .top import Top",
            "if TYPE_CHECKING:\n    from .top import Top",
            "def f():\n    from . import top as above, other",
            "from .inner.part import Part",
            "import asyncio\nfrom .inner import Part",
        ] {
            let files = [
                ("src/__init__.py", "from .top import Top"),
                ("src/top.py", "from .inner.part import Part"),
                ("src/inner/__init__.py", "from .part import Part"),
                ("src/inner/part.py", "from ..low import (\n    Low,\n)"),
                ("src/low.py", low),
            ];
            let found = found(CHECK, &files);
            assert!(
                found.len() == 1 && found[0].contains("low") && found[0].contains("inner"),
                "{low}: {found:?}"
            );
        }
        let files = [
            ("src/top.py", "from . import low\nfrom ..other import top"),
            (
                "src/low.py",
                "from top import Top\nfrom __future__ import annotations",
            ),
        ];
        assert_eq!(found(CHECK, &files), [] as [&str; 0]);
    }
}
