//! No dependency that nobody uses: each costs a build, a licence and an eye on its advisories, and the compiler does not say so.

use std::collections::BTreeSet;

use anyhow::{Context as _, Result};
use toml::{Table, Value};

use super::imports::line_of_key;
use super::tree::{Tree, folder_of};
use super::{Report, rust_text};

/// Behind a dependency that only generated code names, with the reason.
const EXCUSE: &str = "# tidy: ";

/// A manifest of the checkout.
struct Manifest<'a> {
    path: &'a str,
    text: &'a str,
    table: Table,
}

impl Manifest<'_> {
    fn folder(&self) -> &str {
        folder_of(self.path)
    }

    /// The keys of the dependencies of one kind, on any target.
    fn keys(&self, kind: &str) -> Vec<&str> {
        let targets = self.table.get("target").and_then(Value::as_table);
        targets
            .into_iter()
            .flatten()
            .filter_map(|(_, target)| target.get(kind))
            .chain(self.table.get(kind))
            .filter_map(Value::as_table)
            .flat_map(|table| table.keys().map(String::as_str))
            .collect()
    }

    fn report(&self, key: &str, message: &str, report: &mut Report<'_>) {
        let line = line_of_key(self.text, key);
        let written = self.text.lines().nth(line - 1).unwrap_or_default();
        if !written.contains(EXCUSE) {
            report(self.path, line, format!("`{key}` {message}"));
        }
    }
}

pub(crate) fn check(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    let mut manifests = Vec::new();
    for (path, text) in tree.with_extension(&["toml"]) {
        if path.rsplit('/').next() == Some("Cargo.toml") {
            let table = text.parse().with_context(|| format!("{path} is not TOML"))?;
            manifests.push(Manifest { path, text, table });
        }
    }
    for manifest in &manifests {
        if tree.exists(&within(manifest.folder(), "src")) {
            package(tree, manifest, &manifests, report);
        }
        workspace(manifest, &manifests, report);
    }
    Ok(())
}

/// What a package names in its manifest and in none of the files that this kind of dependency is for.
fn package(tree: &Tree, manifest: &Manifest<'_>, all: &[Manifest<'_>], report: &mut Report<'_>) {
    let own = manifest
        .table
        .get("package")
        .and_then(|package| package.get("name"));
    let (source, script) = (
        within(manifest.folder(), "src/"),
        within(manifest.folder(), "build.rs"),
    );
    for (kind, files, message) in [
        (
            "dependencies",
            source,
            "is used in no file of src: remove it, or let only tests have it",
        ),
        (
            "dev-dependencies",
            within(manifest.folder(), ""),
            "is used in no file of the package: remove it",
        ),
        ("build-dependencies", script, "is not used in build.rs: remove it"),
    ] {
        let keys = manifest.keys(kind);
        if keys.is_empty() {
            continue;
        }
        let words = words(tree, manifest, all, &files);
        for key in keys {
            // A package that depends on itself asks for a feature.
            let is_itself = own.and_then(Value::as_str) == Some(key);
            if !is_itself && !words.contains(key.replace('-', "_").as_str()) {
                manifest.report(key, message, report);
            }
        }
    }
}

/// The words of the package's code in the files whose path begins so; packages inside it are not its own. Examples in comments count for
/// what only tests have.
fn words<'a>(
    tree: &'a Tree,
    manifest: &Manifest<'_>,
    all: &[Manifest<'_>],
    begin: &str,
) -> BTreeSet<&'a str> {
    let own = within(manifest.folder(), "");
    let others: Vec<String> = all
        .iter()
        .map(|other| within(other.folder(), ""))
        .filter(|other| *other != own && other.starts_with(&own))
        .collect();
    let is_whole = begin == own;
    let mut words = BTreeSet::new();
    for (path, _) in tree.with_extension(&["rs"]) {
        if !path.starts_with(begin) || others.iter().any(|other| path.starts_with(other)) {
            continue;
        }
        let Some(text) = tree.rust_text(path) else {
            continue;
        };
        words.extend(rust_text::words(&text.code).map(|(_, word)| word));
        if is_whole {
            words.extend(rust_text::words(&text.comments).map(|(_, word)| word));
        }
    }
    words
}

/// What a workspace names and no package below its folder takes over.
fn workspace(manifest: &Manifest<'_>, all: &[Manifest<'_>], report: &mut Report<'_>) {
    let shared = manifest
        .table
        .get("workspace")
        .and_then(|workspace| workspace.get("dependencies"));
    let Some(shared) = shared.and_then(Value::as_table) else {
        return;
    };
    let folder = within(manifest.folder(), "");
    let nested: Vec<String> = all
        .iter()
        .filter(|other| other.path != manifest.path && other.table.contains_key("workspace"))
        .map(|other| within(other.folder(), ""))
        .filter(|other| other.starts_with(&folder))
        .collect();
    let members = all.iter().filter(|member| {
        member.path.starts_with(&folder) && !nested.iter().any(|other| member.path.starts_with(other))
    });
    let used: BTreeSet<&str> = members
        .flat_map(|member| {
            ["dependencies", "dev-dependencies", "build-dependencies"]
                .into_iter()
                .flat_map(|kind| member.keys(kind))
        })
        .collect();
    for key in shared.keys().filter(|key| !used.contains(key.as_str())) {
        manifest.report(key, "is used by no package of the workspace: remove it", report);
    }
}

fn within(folder: &str, path: &str) -> String {
    if folder.is_empty() {
        path.to_owned()
    } else {
        format!("{folder}/{path}")
    }
}

#[cfg(test)]
mod tests {
    use super::super::found;
    use super::*;

    const ROOT: &str =
        "[workspace]\nmembers = [\"a\"]\n[workspace.dependencies]\nserde = \"1\"\nrmp = \"0.8\"\n";

    fn faults(manifest: &str, files: &[(&str, &str)]) -> Vec<String> {
        let mut all = vec![("Cargo.toml", ROOT), ("a/Cargo.toml", manifest)];
        all.extend(files);
        found(check, &all)
            .into_iter()
            .filter(|fault| !fault.starts_with("Cargo.toml"))
            .collect()
    }

    #[test]
    fn a_dependency_that_no_code_names_is_found() {
        let manifest = "[package]\nname = \"a\"\n[dependencies]\nserde.workspace = true\ntoml-edit = \"1\"\n";
        let source = ("a/src/lib.rs", "// serde is not used\nuse toml_edit::Item;\n");
        let message = "`serde` is used in no file of src: remove it, or let only tests have it";
        assert_eq!(
            faults(manifest, &[source]),
            [format!("a/Cargo.toml:4: {message}")]
        );
        // What only tests use is a dependency of tests.
        let test = ("a/tests/all.rs", "use serde::Serialize;\n");
        assert_eq!(faults(manifest, &[source, test]).len(), 1);
        // A package inside another is not a part of it.
        let inner = [
            ("a/inner/Cargo.toml", "[package]\nname = \"inner\"\n"),
            ("a/inner/src/lib.rs", "use serde::Serialize;\n"),
        ];
        assert_eq!(faults(manifest, &[source, inner[0], inner[1]]).len(), 1);
        let excused = manifest.replace(
            "serde.workspace = true",
            "serde.workspace = true # tidy: generated code uses it",
        );
        assert_eq!(faults(&excused, &[source]), [] as [&str; 0]);
    }

    #[test]
    fn those_of_tests_and_of_the_build_have_files_of_their_own() {
        let manifest = "[package]\nname = \"a\"\n[dev-dependencies]\nserde = \"1\"\na = { path = \".\", features = [\"x\"] }\n[build-dependencies]\nrmp = \"1\"\n";
        let files = [
            ("a/src/lib.rs", "use rmp::encode;\n"),
            ("a/tests/all.rs", "use serde::Serialize;\n"),
        ];
        let message = "`rmp` is not used in build.rs: remove it";
        assert_eq!(faults(manifest, &files), [format!("a/Cargo.toml:7: {message}")]);
        let script = ("a/build.rs", "fn main() { rmp::encode(); }\n");
        assert_eq!(faults(manifest, &[files[0], files[1], script]), [] as [&str; 0]);
        let example = ("a/src/lib.rs", "/// use serde::Serialize;\nfn f() {}\n");
        assert_eq!(faults(manifest, &[example, script]), [] as [&str; 0]);
    }

    #[test]
    fn what_a_workspace_shares_with_nobody_is_found() {
        let inner = "[workspace]\n[package]\nname = \"b\"\n[dependencies]\nrmp.workspace = true\n";
        let files = [
            ("Cargo.toml", ROOT),
            (
                "a/Cargo.toml",
                "[package]\nname = \"a\"\n[dev-dependencies]\nserde.workspace = true\n",
            ),
            ("b/Cargo.toml", inner),
        ];
        assert_eq!(
            found(check, &files),
            ["Cargo.toml:5: `rmp` is used by no package of the workspace: remove it"]
        );
    }
}
