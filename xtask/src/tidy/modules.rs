//! Which source files a package's crates reach by `mod`, and which of them only tests compile.

use std::collections::BTreeMap;

use super::rust_text::{RustText, attributes, words};
use super::tree::{Tree, folder_of, join};

/// A file that a crate reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Use {
    /// It is part of what is shipped.
    Shipped,
    /// It is under a `#[cfg(test)]` on the way.
    TestOnly,
}

/// The folders of the packages: where a `Cargo.toml` lies; the root's is empty.
pub(crate) fn packages(tree: &Tree) -> Vec<&str> {
    tree.files()
        .map(|(path, _)| path)
        .filter(|path| *path == "Cargo.toml" || path.ends_with("/Cargo.toml"))
        .map(folder_of)
        .collect()
}

/// The files under `package` that its library, programs and build script reach.
pub(crate) fn reached(tree: &Tree, package: &str) -> BTreeMap<String, Use> {
    let mut reached = BTreeMap::new();
    let mut open: Vec<(String, Use)> = roots(tree, package)
        .into_iter()
        .map(|root| (root, Use::Shipped))
        .collect();
    let roots: Vec<String> = open.iter().map(|(root, _)| root.clone()).collect();
    while let Some((path, how)) = open.pop() {
        // A file reached both ways is shipped.
        if reached
            .get(&path)
            .is_some_and(|known| *known == Use::Shipped || how == Use::TestOnly)
        {
            continue;
        }
        let Some(text) = tree.rust_text(&path) else {
            continue;
        };
        for declaration in declarations(text) {
            let how = if declaration.test_only { Use::TestOnly } else { how };
            let found = declaration.files(&path, roots.contains(&path));
            open.extend(
                found
                    .into_iter()
                    .filter(|file| tree.text(file).is_some())
                    .map(|file| (file, how)),
            );
        }
        reached.insert(path, how);
    }
    reached
}

/// The files that cargo itself starts from.
fn roots(tree: &Tree, package: &str) -> Vec<String> {
    let inside = |path: &str| join(package, path).unwrap_or_default();
    let mut roots: Vec<String> = ["src/lib.rs", "src/main.rs", "build.rs"].map(inside).into();
    let programs = inside("src/bin");
    for (path, _) in tree.with_extension(&["rs"]) {
        if let Some(rest) = path.strip_prefix(&format!("{programs}/"))
            && (!rest.contains('/') || rest.ends_with("/main.rs") && rest.matches('/').count() == 1)
        {
            roots.push(path.to_owned());
        }
    }
    let manifest = tree
        .text(&inside("Cargo.toml"))
        .and_then(|text| text.parse::<toml::Table>().ok());
    if let Some(manifest) = manifest {
        let library = manifest.get("lib").into_iter();
        let programs = manifest
            .get("bin")
            .and_then(toml::Value::as_array)
            .into_iter()
            .flatten();
        let named = library
            .chain(programs)
            .filter_map(|target| target.get("path")?.as_str());
        roots.extend(named.map(inside));
    }
    roots.retain(|root| tree.text(root).is_some());
    roots
}

/// One `mod name;`.
struct Declaration {
    /// The inline modules around it, then its own name.
    names: Vec<String>,
    /// What `#[path = "…"]` says.
    path: Option<String>,
    test_only: bool,
}

impl Declaration {
    /// Where its file may lie when it stands in `file`.
    fn files(&self, file: &str, is_root: bool) -> Vec<String> {
        let folder = folder_of(file);
        let stem = file
            .rsplit('/')
            .next()
            .and_then(|name| name.strip_suffix(".rs"))
            .unwrap_or_default();
        let own = if is_root || stem == "mod" {
            folder.to_owned()
        } else {
            format!("{folder}/{stem}")
        };
        let inner = self.names.join("/");
        match &self.path {
            Some(path) => join(folder, path).into_iter().collect(),
            None => [format!("{inner}.rs"), format!("{inner}/mod.rs")]
                .iter()
                .filter_map(|path| join(&own, path))
                .collect(),
        }
    }
}

fn declarations(text: &RustText) -> Vec<Declaration> {
    let code = text.code.as_bytes();
    let tests = text.test_regions();
    let paths: Vec<(usize, String)> = attributes(&text.code)
        .into_iter()
        .filter_map(|range| Some((range.end, path_attribute(&text.with_strings[range])?)))
        .collect();
    let mut found = Vec::new();
    // The inline modules that are open, each with the depth of its braces.
    let mut inside: Vec<(String, usize)> = Vec::new();
    let (mut depth, mut done) = (0_usize, 0);
    let all: Vec<(usize, &str)> = words(&text.code).collect();
    for pair in all.windows(2) {
        let [(at, "mod"), (name_at, name)] = *pair else {
            continue;
        };
        for byte in &code[done..at] {
            match byte {
                b'{' => depth += 1,
                b'}' => {
                    depth = depth.saturating_sub(1);
                    inside.retain(|(_, opened)| *opened <= depth);
                }
                _ => {}
            }
        }
        done = at;
        let after = name_at + name.len();
        match code[after..].iter().find(|byte| !byte.is_ascii_whitespace()) {
            Some(b'{') => inside.push((name.to_owned(), depth + 1)),
            Some(b';') => {
                let names = inside
                    .iter()
                    .map(|(name, _)| name.clone())
                    .chain([name.to_owned()])
                    .collect();
                let path = paths.iter().rev().find(|(end, _)| *end <= at).filter(|(end, _)| {
                    // Nothing but `pub` or further attributes may lie between the attribute and its module.
                    !text.code[*end..at].contains([';', '{', '}'])
                });
                let test_only = tests.iter().any(|region| region.contains(&at));
                found.push(Declaration {
                    names,
                    path: path.map(|(_, path)| path.clone()),
                    test_only,
                });
            }
            _ => {}
        }
    }
    found
}

/// The path of an attribute `#[path = "…"]`.
fn path_attribute(attribute: &str) -> Option<String> {
    let rest = attribute.strip_prefix("#[")?.trim_start().strip_prefix("path")?;
    let rest = rest
        .trim_start()
        .strip_prefix('=')?
        .trim_start()
        .strip_prefix('"')?;
    rest.split('"').next().map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(files: &[(&str, &str)], expected: &[(&str, Use)]) {
        let reached = reached(&Tree::of(files), "p");
        let expected = expected
            .iter()
            .map(|(path, how)| ((*path).to_owned(), *how))
            .collect();
        assert_eq!(reached, expected, "{files:?}");
    }

    #[test]
    fn modules_are_followed_through_files_and_folders() {
        check(
            &[
                (
                    "p/src/lib.rs",
                    "pub mod a;\nmod b; // mod c;\nconst X: &str = \"mod c;\";",
                ),
                ("p/src/a.rs", "pub(crate) mod deep;"),
                ("p/src/a/deep.rs", ""),
                ("p/src/b/mod.rs", "mod side;"),
                ("p/src/b/side.rs", ""),
                ("p/src/c.rs", ""),
            ],
            &[
                ("p/src/lib.rs", Use::Shipped),
                ("p/src/a.rs", Use::Shipped),
                ("p/src/a/deep.rs", Use::Shipped),
                ("p/src/b/mod.rs", Use::Shipped),
                ("p/src/b/side.rs", Use::Shipped),
            ],
        );
    }

    #[test]
    fn inline_modules_and_path_attributes_lead_elsewhere() {
        check(
            &[
                (
                    "p/src/lib.rs",
                    "mod a { mod x {} mod b; }\n#[path = \"odd/name.rs\"]\nmod c;\nmod d;",
                ),
                ("p/src/a/b.rs", ""),
                ("p/src/odd/name.rs", ""),
                ("p/src/b.rs", ""),
                ("p/src/d.rs", ""),
            ],
            &[
                ("p/src/lib.rs", Use::Shipped),
                ("p/src/a/b.rs", Use::Shipped),
                ("p/src/odd/name.rs", Use::Shipped),
                ("p/src/d.rs", Use::Shipped),
            ],
        );
    }

    #[test]
    fn programs_are_roots() {
        check(
            &[
                (
                    "p/Cargo.toml",
                    "[[bin]]\nname = \"tool\"\npath = \"src/tool/start.rs\"\n",
                ),
                ("p/src/main.rs", ""),
                ("p/src/bin/one.rs", ""),
                ("p/src/bin/two/main.rs", "mod part;"),
                ("p/src/bin/two/part.rs", ""),
                ("p/src/tool/start.rs", "mod side;"),
                ("p/src/tool/side.rs", ""),
                ("p/build.rs", ""),
            ],
            &[
                ("p/src/main.rs", Use::Shipped),
                ("p/src/bin/one.rs", Use::Shipped),
                ("p/src/bin/two/main.rs", Use::Shipped),
                ("p/src/bin/two/part.rs", Use::Shipped),
                ("p/src/tool/start.rs", Use::Shipped),
                ("p/src/tool/side.rs", Use::Shipped),
                ("p/build.rs", Use::Shipped),
            ],
        );
    }

    #[test]
    fn what_tests_alone_reach_is_known() {
        check(
            &[
                ("p/src/lib.rs", "#[cfg(test)]\nmod tests;\nmod both;"),
                ("p/src/tests.rs", "mod deeper; #[path = \"both.rs\"] mod again;"),
                ("p/src/tests/deeper.rs", ""),
                ("p/src/both.rs", ""),
            ],
            &[
                ("p/src/lib.rs", Use::Shipped),
                ("p/src/tests.rs", Use::TestOnly),
                ("p/src/tests/deeper.rs", Use::TestOnly),
                ("p/src/both.rs", Use::Shipped),
            ],
        );
    }

    #[test]
    fn packages_are_where_manifests_are() {
        let tree = Tree::of(&[
            ("Cargo.toml", ""),
            ("a/b/Cargo.toml", ""),
            ("a/NotCargo.toml", ""),
        ]);
        assert_eq!(packages(&tree), ["", "a/b"]);
    }
}
