//! Which rooms of a package may use which. A room is a folder or a file directly under `src/`; each may use itself and
//! the rooms after it in the list, so that there is no circle and a reader can begin at the end.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context as _, Result, ensure};

use super::Report;
use super::circles::circles;
use super::modules::{Use, packages, reached};
use super::room_order::ROOMS;
use super::rust_text::RustText;
use super::tree::{Tree, join, line_at};

pub(crate) fn check(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    check_rooms(ROOMS, tree, report)
}

fn check_rooms(table: &[(&str, &str)], tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    let mut folders = BTreeMap::new();
    for folder in packages(tree) {
        let manifest = join(folder, "Cargo.toml").and_then(|path| tree.text(&path));
        let manifest: toml::Table = manifest.unwrap_or_default().parse()?;
        let name = manifest.get("package").and_then(|package| package.get("name"));
        if let Some(name) = name.and_then(toml::Value::as_str) {
            folders.insert(name.to_owned(), folder);
        }
    }
    for (package, order) in table {
        let folder = folders
            .get(*package)
            .with_context(|| format!("ROOMS names the package {package}, which is not here"))?;
        let house = House::of(tree, package, folder, order)?;
        house.check(report);
    }
    for (package, folder) in &folders {
        if table.iter().any(|(listed, _)| listed == package) {
            continue;
        }
        if let Ok(house) = House::of(tree, package, folder, "")
            && house.lines() > SMALL
        {
            for circle in circles(&house.uses()) {
                let text = format!(
                    "{} of {package} use each other: a room uses only those below it",
                    circle.join(", ")
                );
                report(&house.manifest, 1, text);
            }
        }
    }
    Ok(())
}

/// A package of no more lines is one room.
const SMALL: usize = 2000;

/// One package.
struct House<'a> {
    package: &'a str,
    manifest: String,
    order: Vec<&'a str>,
    /// Its shipped files: path, room, and how deep its module lies below the root; none = no room.
    files: Vec<(String, Option<Place>, &'a str)>,
    /// The names that the root gives to what is in a room.
    names: BTreeMap<String, String>,
    /// What the root defines itself.
    above: BTreeSet<String>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Place {
    room: String,
    depth: usize,
}

impl<'a> House<'a> {
    fn of(tree: &'a Tree, package: &'a str, folder: &str, order: &'a str) -> Result<House<'a>> {
        let sources = format!("{}/", join(folder, "src").unwrap_or_default());
        let mut files = Vec::new();
        let (mut names, mut above) = (BTreeMap::new(), BTreeSet::new());
        for (path, how) in reached(tree, folder) {
            let inside = path.strip_prefix(&sources);
            let (Some(inside), Some(text), Use::Shipped) = (inside, tree.text(&path), how) else {
                continue;
            };
            if inside == "lib.rs" {
                let root = RustText::new(text);
                names = root_names(&root.code);
                above = defined(&root.code);
            }
            files.push((path.clone(), place(inside), text));
        }
        ensure!(!files.is_empty(), "the package {package} has no source files");
        Ok(House {
            package,
            manifest: join(folder, "Cargo.toml").unwrap_or_default(),
            order: order.split_whitespace().collect(),
            files,
            names,
            above,
        })
    }

    fn check(&self, report: &mut Report<'_>) {
        for (path, place, text) in &self.files {
            let Some(place) = place else { continue };
            let Some(own) = self.order.iter().position(|room| *room == place.room) else {
                let text = format!(
                    "`{}` has no place among the rooms of {}: add it to ROOMS of xtask/src/tidy/room_order.rs",
                    place.room, self.package
                );
                report(path, 1, text);
                continue;
            };
            for (at, room) in self.used(text, place.depth) {
                let used = self.order.iter().position(|known| *known == room);
                if used.is_none() && self.above.contains(&room) {
                    let text = format!(
                        "`{}` must not use `{room}` of the root of {}, which is above all rooms: give it a room",
                        place.room, self.package
                    );
                    report(path, line_at(self.text_of(path), at), text);
                }
                if used.is_some_and(|used| used < own) {
                    let text = format!(
                        "`{}` must not use `{room}`: a room of {} uses only those after it in {}",
                        place.room,
                        self.package,
                        self.order.join(", ")
                    );
                    report(path, line_at(self.text_of(path), at), text);
                }
            }
        }
        for room in &self.order {
            let exists = |place: &Option<Place>| place.as_ref().is_some_and(|place| place.room == *room);
            if !self.files.iter().any(|(_, place, _)| exists(place)) {
                let text = format!("ROOMS names `{room}`, which {} does not have", self.package);
                report(&self.manifest, 1, text);
            }
        }
    }

    fn lines(&self) -> usize {
        self.files.iter().map(|(_, _, text)| text.lines().count()).sum()
    }

    /// The rooms that each room uses.
    fn uses(&self) -> BTreeMap<String, BTreeSet<String>> {
        let mut uses: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        for (_, place, text) in &self.files {
            let Some(place) = place else { continue };
            let used = self.used(text, place.depth).into_iter().map(|(_, room)| room);
            uses.entry(place.room.clone()).or_default().extend(used);
        }
        uses
    }

    fn text_of(&self, path: &str) -> &str {
        let file = self.files.iter().find(|(known, _, _)| known == path);
        file.map_or("", |(_, _, text)| text)
    }

    /// The rooms that a file names outside its tests, with the places where it does.
    fn used(&self, source: &str, depth: usize) -> Vec<(usize, String)> {
        let text = RustText::new(source);
        let tests = text.test_regions();
        let mut found = Vec::new();
        for (at, start) in paths_from_root(&text.code, depth) {
            if tests.iter().any(|region| region.contains(&at)) {
                continue;
            }
            for leaf in leaves(&text.code, start) {
                let Some(first) = leaf.path.first() else { continue };
                let room = self.names.get(first).unwrap_or(first);
                found.push((at, room.clone()));
            }
        }
        found
    }
}

/// The room of a file under `src/`; none for the files that cargo starts from.
fn place(inside: &str) -> Option<Place> {
    let path = inside.strip_suffix(".rs")?;
    let path = path.strip_suffix("/mod").unwrap_or(path);
    let (first, depth) = (path.split('/').next()?, path.split('/').count());
    let starts = matches!(path, "lib" | "main") || first == "bin";
    (!starts).then(|| Place {
        room: first.to_owned(),
        depth,
    })
}

/// The names that the root has in use, and the room that each comes from.
fn root_names(code: &str) -> BTreeMap<String, String> {
    let mut names = BTreeMap::new();
    for (at, word) in super::rust_text::words(code) {
        if word != "use" {
            continue;
        }
        for leaf in leaves(code, at + word.len()) {
            let rooted = |part: &&String| !matches!(part.as_str(), "crate" | "self");
            if let Some(room) = leaf.path.iter().find(rooted) {
                names.insert(leaf.name, room.clone());
            }
        }
    }
    names
}

/// The types, traits and functions that are defined in a text outside of all braces.
fn defined(code: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let (mut depth, mut done) = (0_usize, 0);
    let all: Vec<(usize, &str)> = super::rust_text::words(code).collect();
    for pair in all.windows(2) {
        let [(at, "struct" | "enum" | "trait" | "fn"), (_, name)] = *pair else {
            continue;
        };
        for byte in code[done..at].bytes() {
            match byte {
                b'{' => depth += 1,
                b'}' => depth = depth.saturating_sub(1),
                _ => {}
            }
        }
        done = at;
        if depth == 0 {
            found.insert(name.to_owned());
        }
    }
    found
}

/// The places of all paths that begin at the root of the package, each with the offset of what follows `crate::` or
/// enough of `super::`.
fn paths_from_root(code: &str, depth: usize) -> Vec<(usize, usize)> {
    let mut found = Vec::new();
    let continued = |at: usize| {
        code[..at].ends_with(|before: char| before.is_alphanumeric() || before == '_' || before == ':')
    };
    for (at, word) in code.match_indices("crate::") {
        if !continued(at) {
            found.push((at, at + word.len()));
        }
    }
    for (at, word) in code.match_indices("super::") {
        if continued(at) {
            continue;
        }
        let supers = code[at..]
            .split(word)
            .take_while(|between| between.is_empty())
            .count();
        if supers >= depth {
            found.push((at, at + word.len() * depth));
        }
    }
    found.sort_unstable();
    found
}

/// One name that a path or a tree of paths leads to.
#[derive(Debug, PartialEq, Eq)]
struct Leaf {
    path: Vec<String>,
    /// As what it is known: its last part, or what stands after `as`.
    name: String,
}

/// The leaves of the path, or of the tree `{a::b, c as d}`, at an offset.
fn leaves(code: &str, at: usize) -> Vec<Leaf> {
    let mut found = Vec::new();
    read_tree(&mut Reader { code, at }, &mut Vec::new(), &mut found);
    found
}

struct Reader<'a> {
    code: &'a str,
    at: usize,
}

impl<'a> Reader<'a> {
    fn rest(&self) -> &'a str {
        &self.code[self.at..]
    }

    /// Goes past a text, and blanks before it, if it stands here.
    fn take(&mut self, text: &str) -> bool {
        let rest = self.rest().trim_start();
        let taken = rest.starts_with(text);
        if taken {
            self.at = self.code.len() - rest.len() + text.len();
        }
        taken
    }

    fn word(&mut self) -> &'a str {
        let rest = self.rest().trim_start();
        let end = rest
            .find(|next: char| !next.is_alphanumeric() && next != '_')
            .unwrap_or(rest.len());
        self.at = self.code.len() - rest.len() + end;
        &rest[..end]
    }
}

fn read_tree(reader: &mut Reader<'_>, path: &mut Vec<String>, found: &mut Vec<Leaf>) {
    if reader.take("{") {
        while !reader.take("}") && !reader.rest().trim_start().is_empty() {
            if !reader.take(",") {
                let before = reader.at;
                read_tree(reader, path, found);
                // What is not a tree is left to the compiler.
                if reader.at == before {
                    return;
                }
            }
        }
        return;
    }
    let raw = reader.take("r#");
    let word = if reader.take("*") { "*" } else { reader.word() };
    if word.is_empty() && !raw {
        // A path that ends here, as in `a::b::<T>`.
        if let Some(name) = path.last().cloned() {
            found.push(Leaf {
                path: path.clone(),
                name,
            });
        }
        return;
    }
    path.push(word.to_owned());
    if reader.take("::") {
        read_tree(reader, path, found);
    } else {
        let mut name = word;
        let before = reader.at;
        if reader.rest().trim_start().starts_with("as ") {
            reader.word();
            name = reader.word();
        } else {
            reader.at = before;
        }
        found.push(Leaf {
            path: path.clone(),
            name: name.to_owned(),
        });
    }
    path.pop();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tidy::{Check, found};

    const CHECK: Check = |tree, report| {
        let table: &[(&str, &str)] = &[("demo", "top middle low")];
        check_rooms(table, tree, report)
    };

    /// What is found in a package whose `middle/part.rs` is this.
    fn faults(part: &str) -> Vec<String> {
        let root =
            "mod top;\nmod middle;\nmod low;\npub use top::Roof;\nuse low::{Floor, deep::Cellar as Well};";
        let files = [
            ("Cargo.toml", "[workspace]\nmembers = [\"p\"]\n"),
            ("p/Cargo.toml", "[package]\nname = \"demo\"\n"),
            ("p/src/lib.rs", root),
            ("p/src/top.rs", "use crate::middle::part; use crate::low;"),
            ("p/src/middle/mod.rs", "mod part;\nuse super::low;"),
            ("p/src/middle/part.rs", part),
            ("p/src/low/mod.rs", "use crate::Floor;"),
        ];
        let found = found(CHECK, &files);
        let short = |line: &String| line.split(": a room of").next().unwrap_or_default().to_owned();
        found.iter().map(short).collect()
    }

    #[test]
    fn an_arrow_upwards_is_found_however_it_is_written() {
        for part in [
            "\nuse crate::top::Thing;",
            "\nuse crate::{low, top as above};",
            "\nuse crate::{low::{a, b}, top::{c, d}};",
            "\nuse crate::Roof;",
            "\nfn f() { crate::top::thing(); }",
            "\nuse super::super::top;",
            "\nuse super::super::{low, Roof};",
            "\nfn f(of: &crate::Roof) {}",
        ] {
            let expected = "p/src/middle/part.rs:2: `middle` must not use `top`";
            assert_eq!(faults(part), [expected], "{part}");
        }
    }

    #[test]
    fn arrows_downwards_and_within_a_room_are_free() {
        for part in [
            "use crate::low::Thing; use crate::{Floor, Well}; use crate::middle::other;",
            "use super::top;",
            "// use crate::top;\nconst A: &str = \"crate::top\";",
            "#[cfg(test)]\nmod tests { use crate::top::Thing; use super::super::super::top; }",
            "use other_crate::top; use other::crate_like::top;",
        ] {
            assert_eq!(faults(part), [] as [&str; 0], "{part}");
        }
    }

    #[test]
    fn what_the_root_defines_is_above_all_rooms() {
        let found = |low: &str| {
            let files = [
                ("p/Cargo.toml", "[package]\nname = \"demo\"\n"),
                (
                    "p/src/lib.rs",
                    "mod top; mod middle; mod low;\nmod inner { pub struct In; }\npub struct Whole;\npub type Span = i64;",
                ),
                ("p/src/top.rs", ""),
                ("p/src/middle.rs", ""),
                ("p/src/low.rs", low),
            ];
            found(CHECK, &files)
        };
        assert_eq!(found("use crate::Span; use crate::In;"), [] as [&str; 0]);
        let fault =
            "`low` must not use `Whole` of the root of demo, which is above all rooms: give it a room";
        assert_eq!(
            found("use super::{Span, Whole};"),
            [format!("p/src/low.rs:1: {fault}")]
        );
    }

    #[test]
    fn every_room_has_a_place_and_every_place_a_room() {
        let files = [
            ("p/Cargo.toml", "[package]\nname = \"demo\"\n"),
            (
                "p/src/lib.rs",
                "mod top;\nmod attic;\nmod low;\n#[cfg(test)]\nmod trials;",
            ),
            ("p/src/top.rs", ""),
            ("p/src/attic.rs", ""),
            ("p/src/low.rs", ""),
            ("p/src/trials.rs", "use crate::top;"),
        ];
        let found = found(CHECK, &files);
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(
            found[1].starts_with("p/src/attic.rs:1: `attic` has no place"),
            "{found:?}"
        );
        assert!(
            found[0].ends_with("p/Cargo.toml:1: ROOMS names `middle`, which demo does not have"),
            "{found:?}"
        );
    }

    #[test]
    fn rooms_that_use_each_other_are_found_in_any_large_package() {
        let check: Check = |tree, report| check_rooms(&[], tree, report);
        let long = "\n".repeat(SMALL);
        let found = |low: &str| {
            let low = format!("{low}{long}");
            let files = [
                ("p/Cargo.toml", "[package]\nname = \"demo\"\n"),
                ("p/src/lib.rs", "mod top;\nmod middle;\nmod low;"),
                ("p/src/top.rs", "use crate::middle;"),
                ("p/src/middle.rs", "use crate::low;"),
                ("p/src/low.rs", low.as_str()),
            ];
            found(check, &files)
        };
        assert_eq!(found("use other::top;"), [] as [&str; 0]);
        let circle = "low, middle, top of demo use each other: a room uses only those below it";
        assert_eq!(found("use crate::top;"), [format!("p/Cargo.toml:1: {circle}")]);
    }

    #[test]
    fn trees_of_paths_are_read() {
        let check = |code: &str, expected: &[(&str, &str)]| {
            let found = leaves(code, 0);
            let found: Vec<(String, &str)> = found
                .iter()
                .map(|leaf| (leaf.path.join("::"), leaf.name.as_str()))
                .collect();
            let found: Vec<(&str, &str)> = found.iter().map(|(path, name)| (path.as_str(), *name)).collect();
            assert_eq!(found, expected, "{code}");
        };
        check("a::b::c(1)", &[("a::b::c", "c")]);
        check("a::b::<T>()", &[("a::b", "b")]);
        check(
            "{a, b::{self, c as d}, e::*};",
            &[("a", "a"), ("b::self", "self"), ("b::c", "d"), ("e::*", "*")],
        );
        check("{a, (", &[("a", "a")]);
    }
}
