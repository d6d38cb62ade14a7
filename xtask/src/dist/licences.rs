//! The licences of the libraries inside the programs: recipients of a program have to get them too.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result};
use serde_json::Value;

use crate::command::{cargo, output};
use crate::console;

/// Every library that is linked into the packages' programs, or in the console's page where they have it: name, version, licence,
/// and the texts that come with it.
pub(super) fn of(root: &Path, packages: &[&str], has_console: bool) -> Result<String> {
    let mut tree = cargo(root);
    tree.args([
        "tree", "--locked", "--edges", "normal", "--prefix", "none", "--format", "{p}",
    ]);
    for package in packages {
        tree.args(["--package", package]);
    }
    let tree = output(&mut tree)?;
    let linked: Vec<(&str, &str)> = tree.lines().filter_map(name_and_version).collect();
    let mut metadata = cargo(root);
    metadata.args(["metadata", "--locked", "--format-version", "1"]);
    let metadata: Value = serde_json::from_str(&output(&mut metadata)?)?;
    let known = metadata["packages"].as_array().context("cargo knows packages")?;
    let mut told = BTreeMap::new();
    for package in known {
        let word = |key: &str| package[key].as_str().unwrap_or_default();
        // Ours have no source; their licence is told elsewhere.
        if package["source"].is_string() && linked.contains(&(word("name"), word("version"))) {
            let heading = format!("{} {}: {}", word("name"), word("version"), word("license"));
            told.insert(heading, texts(Path::new(word("manifest_path")))?);
        }
    }
    if has_console {
        told.extend(bundled(&root.join(console::FOLDER))?);
    }
    let mut all = String::from("The programs contain these libraries.\n");
    for (heading, texts) in told {
        all.push_str(&format!("\n==== {heading}\n{texts}"));
    }
    Ok(all)
}

/// What is in the console's page, which is in programs.
fn bundled(folder: &Path) -> Result<BTreeMap<String, String>> {
    let read = |path: &Path| -> Result<Value> {
        let text = fs::read(path).with_context(|| format!("{} cannot be read", path.display()))?;
        Ok(serde_json::from_slice(&text)?)
    };
    let manifest = read(&folder.join("package.json"))?;
    let mut told = BTreeMap::new();
    for name in manifest["dependencies"]
        .as_object()
        .into_iter()
        .flatten()
        .map(|(name, _)| name)
    {
        let package = folder.join("node_modules").join(name).join("package.json");
        let known = read(&package)?;
        let word = |key: &str| known[key].as_str().unwrap_or_default();
        let heading = format!("{name} {}: {}", word("version"), word("license"));
        told.insert(heading, texts(&package)?);
    }
    Ok(told)
}

/// From a line such as `clap v4.6.7` or `mom v0.1.0 (here) (*)`.
fn name_and_version(line: &str) -> Option<(&str, &str)> {
    let mut words = line.split(' ');
    Some((words.next()?, words.next()?.strip_prefix('v')?))
}

/// The licences and notices beside a manifest.
fn texts(manifest: &Path) -> Result<String> {
    let folder = manifest.parent().context("a manifest is in a folder")?;
    let mut texts = BTreeMap::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let wanted = ["license", "licence", "copying", "copyright", "notice"];
        let is_wanted = wanted.iter().any(|word| name.to_lowercase().starts_with(word));
        if is_wanted && entry.path().is_file() {
            let text = fs::read(entry.path())?;
            texts.insert(name, String::from_utf8_lossy(&text).into_owned());
        }
    }
    Ok(texts
        .into_iter()
        .map(|(name, text)| format!("\n-- {name}\n{}\n", text.trim()))
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_in_the_page_is_told_too() {
        let folder = tempfile::tempdir().unwrap();
        let package = folder.path().join("node_modules/plots");
        fs::create_dir_all(&package).unwrap();
        let write = |path: &Path, name: &str, text: &str| fs::write(path.join(name), text).unwrap();
        let manifest = r#"{"dependencies": {"plots": "1"}, "devDependencies": {"tester": "2"}}"#;
        write(folder.path(), "package.json", manifest);
        write(
            &package,
            "package.json",
            r#"{"version": "1.2.3", "license": "MIT"}"#,
        );
        write(&package, "LICENSE", "as you like");
        let told = bundled(folder.path()).unwrap();
        let all: Vec<_> = told
            .iter()
            .map(|(heading, text)| (heading.as_str(), text.contains("as you like")))
            .collect();
        assert_eq!(all, [("plots 1.2.3: MIT", true)]);
    }

    #[test]
    fn libraries_are_told_with_their_texts_and_ours_are_not() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let told = of(&root, &["mom-proto"], true).unwrap();
        assert!(
            told.contains("\n==== bytes 1.") && told.contains("Permission is hereby granted"),
            "{told}"
        );
        assert!(
            !told.contains("\n==== mom") && !told.contains("\n==== clap"),
            "{told}"
        );
    }
}
