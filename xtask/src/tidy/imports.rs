//! Who may look at whom: the arrows of the design, read from the manifests, and what the deciding crates must
//! never reach, read from the resolved graph. The hub is replayed and simulated; an arrow the wrong way ends that.

use std::collections::BTreeSet;

use anyhow::{Context as _, Result};
use toml::{Table, Value};

use super::Report;
use super::tree::{Tree, join, line_at};
use crate::command::{cargo, output};

/// What a package may depend on among ours, and does. Dependencies of tests and of `build.rs` are free.
enum May {
    Use(&'static [&'static str]),
    UseAll,
}

/// Where the arrows stand.
const HERE: &str = "xtask/src/tidy/imports.rs";

const ARROWS: &[(&str, May)] = &[
    ("mom-proto", May::Use(&["mom-nearest"])),
    ("mom-managers", May::Use(&["mom-proto"])),
    ("mom-hub", May::Use(&["mom-proto", "mom-managers"])),
    ("mom-net", May::Use(&["mom-proto"])),
    ("mom-client", May::Use(&["mom-proto", "mom-net"])),
    ("mom-system", May::Use(&["mom-proto"])),
    ("mom-login", May::Use(&["mom-proto", "mom-hub", "mom-system"])),
    ("mom-store", May::Use(&["mom-proto", "mom-hub", "mom-system"])),
    (
        "mom-journal",
        May::Use(&["mom-proto", "mom-managers", "mom-hub", "mom-system"]),
    ),
    (
        "mom-config",
        May::Use(&[
            "mom-proto",
            "mom-managers",
            "mom-hub",
            "mom-net",
            "mom-system",
            "mom-login",
            "mom-store",
            "mom-journal",
            "mom-toml-faults",
        ]),
    ),
    (
        "mom-broker",
        May::Use(&[
            "mom-proto",
            "mom-managers",
            "mom-hub",
            "mom-net",
            "mom-system",
            "mom-login",
            "mom-store",
            "mom-journal",
            "mom-config",
            "mom-client",
            "mom-pages",
        ]),
    ),
    ("mom-device", May::Use(&["mom-client", "mom-nearest"])),
    ("mom-device-cases", May::Use(&["mom-client", "mom-device"])),
    (
        "mom-arm",
        May::Use(&[
            "mom-client",
            "mom-device",
            "mom-pages",
            "mom-program",
            "mom-trace",
        ]),
    ),
    (
        "mom-base-station",
        May::Use(&["mom-brs", "mom-pages", "mom-screen", "mom-toml-faults"]),
    ),
    (
        "mom-camera",
        May::Use(&["mom-client", "mom-device", "mom-program", "mom-trace"]),
    ),
    ("mom-vision", May::Use(&[])),
    ("mom-drive", May::Use(&["mom-client"])),
    ("mom-agent", May::Use(&["mom-client", "mom-drive"])),
    (
        "mom-cubo",
        May::Use(&["mom-rsp", "mom-sound", "mom-trace", "mom-wheels", "mom-pages"]),
    ),
    (
        "mom-simulacrum",
        May::Use(&[
            "mom-client",
            "mom-device",
            "mom-wheeled",
            "mom-rsp",
            "mom-rsp-model",
            "mom-sound",
            "mom-wheels",
            "mom-program",
        ]),
    ),
    (
        "mom-wheeled",
        May::Use(&["mom-client", "mom-device", "mom-toml-faults", "mom-wheels"]),
    ),
    (
        "mom-rover",
        May::Use(&[
            "mom-client",
            "mom-device",
            "mom-wheeled",
            "mom-trace",
            "mom-wheels",
            "mom-program",
        ]),
    ),
    ("mom-trace", May::Use(&[])),
    ("mom-wheels", May::Use(&["mom-trace"])),
    ("mom-sound", May::Use(&["mom-rsp"])),
    (
        "mom-linuxbot",
        May::Use(&["mom-brs", "mom-trace", "mom-wheels", "mom-pages"]),
    ),
    (
        "mom-model",
        May::Use(&[
            "mom-client",
            "mom-drive",
            "mom-nearest",
            "mom-vision",
            "mom-program",
        ]),
    ),
    (
        "mom-calibrate",
        May::Use(&["mom-agent", "mom-client", "mom-drive", "mom-pages", "mom-vision"]),
    ),
    (
        "mom-mcp",
        May::Use(&["mom-client", "mom-device", "mom-drive", "mom-program"]),
    ),
    (
        "mom-servo",
        May::Use(&[
            "mom-agent",
            "mom-client",
            "mom-drive",
            "mom-nearest",
            "mom-pages",
            "mom-vision",
            "mom-program",
        ]),
    ),
    (
        "mom",
        May::Use(&[
            "mom-client",
            "mom-broker",
            "mom-agent",
            "mom-arm",
            "mom-camera",
            "mom-device",
            "mom-drive",
            "mom-calibrate",
            "mom-model",
            "mom-servo",
            "mom-gateway",
            "mom-linuxbot",
            "mom-base-station",
            "mom-brs",
            "mom-cubo",
            "mom-simulacrum",
            "mom-rsp",
            "mom-rsp-model",
            "mom-wheels",
            "mom-plots",
            "mom-pages",
            "mom-screen",
        ]),
    ),
    (
        "mom-robot",
        May::Use(&[
            "mom-arm",
            "mom-base-station",
            "mom-camera",
            "mom-cubo",
            "mom-gateway",
            "mom-linuxbot",
            "mom-mcp",
            "mom-model",
            "mom-nearest",
            "mom-pages",
            "mom-rover",
            "mom-servo",
            "mom-simulacrum",
        ]),
    ),
    ("mom-brs", May::Use(&["mom-toml-faults"])),
    ("mom-rsp", May::Use(&[])),
    ("mom-rsp-model", May::Use(&["mom-rsp", "mom-toml-faults"])),
    ("mom-rsp-typed", May::Use(&["mom-rsp"])),
    (
        "mom-gateway",
        May::Use(&[
            "mom-client",
            "mom-device",
            "mom-drive",
            "mom-wheeled",
            "mom-brs",
            "mom-linuxbot",
            "mom-base-station",
            "mom-program",
        ]),
    ),
    ("mom-plots", May::Use(&[])),
    ("mom-pages", May::Use(&[])),
    ("mom-screen", May::Use(&[])),
    ("mom-toml-faults", May::Use(&["mom-nearest"])),
    ("mom-nearest", May::Use(&[])),
    ("mom-program", May::Use(&["mom-client", "mom-pages"])),
    ("mom-tests", May::UseAll),
    ("mom-simulation", May::UseAll),
    ("mom-cases", May::Use(&[])),
    ("xtask", May::Use(&[])),
];

/// The wings: folders whose packages use the core, the kit and their own wing, and never one another.
const WINGS: &[&str] = &["lab", "fleet", "thin"];
/// What all wings are built with.
const KIT: &str = "kit";

/// The crates that decide: no IO, no clock, no randomness but a given seed.
const PURE: &[&str] = &["mom-proto", "mom-managers", "mom-hub"];
/// What brings IO, or randomness that is not given.
const IMPURE: &[&str] = &["tokio", "mio", "async-std", "smol", "getrandom"];

/// The arrows between our own packages.
pub(crate) fn check(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    let root = manifest(tree, "Cargo.toml")?;
    let workspace = root
        .get("workspace")
        .and_then(Value::as_table)
        .context("Cargo.toml has no [workspace]")?;
    let members = workspace
        .get("members")
        .and_then(Value::as_array)
        .context("Cargo.toml has no members")?;
    let paths: Vec<String> = members
        .iter()
        .filter_map(Value::as_str)
        .filter_map(|member| join(member, "Cargo.toml"))
        .collect();
    let mut manifests = Vec::new();
    for path in &paths {
        let manifest = manifest(tree, path)?;
        let name = package_name(&manifest)
            .with_context(|| format!("{path} has no package.name"))?
            .to_owned();
        manifests.push((path, name, manifest));
    }
    let ours: BTreeSet<&str> = manifests.iter().map(|(_, name, _)| name.as_str()).collect();
    for (path, name, manifest) in &manifests {
        let Some((_, may)) = ARROWS.iter().find(|(package, _)| package == name) else {
            report(
                path,
                1,
                format!("`{name}` has no place in ARROWS of {HERE}: say what it may use"),
            );
            continue;
        };
        let May::Use(allowed) = may else { continue };
        let used = dependencies(manifest, workspace);
        let is_unused =
            |may: &&&str| ours.contains(**may) && used.iter().all(|(_, package)| package != **may);
        for unused in allowed.iter().filter(is_unused) {
            let text =
                format!("`{name}` does not depend on `{unused}`: take that arrow out of ARROWS of {HERE}");
            report(path, 1, text);
        }
        for (key, package) in used {
            if let Some(text) = crosses(path, name, &package, &manifests) {
                report(path, line_of_key(tree.text(path).unwrap_or_default(), &key), text);
            }
            if ours.contains(package.as_str()) && !allowed.contains(&package.as_str()) {
                let line = line_of_key(tree.text(path).unwrap_or_default(), &key);
                report(
                    path,
                    line,
                    format!(
                        "`{name}` must not depend on `{package}`: it may use {}",
                        list(allowed)
                    ),
                );
            }
        }
    }
    Ok(())
}

/// What is wrong with a package in this place using that one, by their wings.
fn crosses(path: &str, name: &str, used: &str, all: &[(&String, String, Table)]) -> Option<String> {
    let (used_path, _, _) = all.iter().find(|(_, known, _)| known == used)?;
    let wing = |path: &str| {
        path.split('/')
            .next()
            .filter(|folder| WINGS.contains(folder))
            .map(str::to_owned)
    };
    let (own, other) = (wing(path), wing(used_path)?);
    match own {
        Some(own) if own != other => Some(format!(
            "`{name}` of {own}/ must not depend on `{used}` of {other}/: what two wings share belongs in {KIT}/"
        )),
        None if path.starts_with(&format!("{KIT}/")) => Some(format!(
            "`{name}` of {KIT}/ must not depend on `{used}` of {other}/: wings use the kit"
        )),
        _ => None,
    }
}

/// What the deciding crates reach through other people's crates.
pub(crate) fn check_resolved(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    for package in PURE {
        let mut command = cargo(tree.root());
        command.args([
            "tree", "--locked", "-p", package, "-e", "normal", "--prefix", "none", "--format", "{p}",
        ]);
        for name in impure_crates(&output(&mut command)?) {
            let message =
                format!("`{package}` reaches `{name}`: see cargo tree -p {package} -e normal -i {name}");
            report("Cargo.lock", 1, message);
        }
    }
    Ok(())
}

/// The impure crates among the lines `name v1.2.3` of a resolved graph.
fn impure_crates(graph: &str) -> BTreeSet<&str> {
    graph
        .lines()
        .filter_map(|line| line.split_whitespace().next())
        .filter(|name| IMPURE.contains(name))
        .collect()
}

fn manifest(tree: &Tree, path: &str) -> Result<Table> {
    let text = tree.text(path).with_context(|| format!("{path} is not here"))?;
    text.parse().with_context(|| format!("{path} is not TOML"))
}

fn package_name(manifest: &Table) -> Option<&str> {
    manifest.get("package")?.get("name")?.as_str()
}

/// The normal dependencies of a manifest, on any target: the key and the package that it means.
fn dependencies(manifest: &Table, workspace: &Table) -> Vec<(String, String)> {
    let targets = manifest
        .get("target")
        .and_then(Value::as_table)
        .into_iter()
        .flatten();
    let tables = targets
        .filter_map(|(_, target)| target.get("dependencies"))
        .chain(manifest.get("dependencies"));
    tables
        .filter_map(Value::as_table)
        .flatten()
        .map(|(key, value)| {
            let inherited = value.get("workspace").is_some();
            let shared = || workspace.get("dependencies").and_then(|all| all.get(key));
            let value = if inherited {
                shared().unwrap_or(value)
            } else {
                value
            };
            let package = value.get("package").and_then(Value::as_str).unwrap_or(key);
            (key.clone(), package.to_owned())
        })
        .collect()
}

pub(super) fn line_of_key(text: &str, key: &str) -> usize {
    let begins = |line: &str| {
        line.trim_start()
            .strip_prefix(key)
            .is_some_and(|rest| rest.trim_start().starts_with(['.', '=']))
    };
    let table = text
        .find(&format!("dependencies.{key}]"))
        .map_or(1, |at| line_at(text, at));
    text.lines().position(begins).map_or(table, |line| line + 1)
}

fn list(names: &[&str]) -> String {
    if names.is_empty() {
        "none of ours".to_owned()
    } else {
        format!("only {}", names.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::super::found;
    use super::*;

    const ROOT: &str = "[workspace]\nmembers = [\"a\", \"b\"]\n[workspace.dependencies]\nmom-cli = { path = \"m\", package = \"mom-net\" }\n";
    const PROTO: &str = "[package]\nname = \"mom-net\"\n[dependencies]\nserde = \"1\"\n";

    fn faults(manifest: &str) -> Vec<String> {
        found(
            check,
            &[
                ("Cargo.toml", ROOT),
                ("a/Cargo.toml", manifest),
                ("b/Cargo.toml", PROTO),
            ],
        )
    }

    #[test]
    fn an_arrow_the_wrong_way_is_found_however_it_is_written() {
        let message = "`mom-hub` must not depend on `mom-net`: it may use only mom-proto, mom-managers";
        for (dependency, line) in [
            ("[dependencies]\nserde = \"1\"\nmom-net.workspace = true", 5),
            ("[dependencies]\nmom-net = { path = \"../b\" }", 4),
            ("[dependencies]\nmom-cli.workspace = true", 4),
            (
                "[dependencies]\nrenamed = { path = \"../b\", package = \"mom-net\" }",
                4,
            ),
            ("[dependencies.mom-net]\npath = \"../b\"", 3),
            (
                "[target.'cfg(unix)'.dependencies]\nmom-net = { path = \"../b\" }",
                4,
            ),
        ] {
            let manifest = format!("[package]\nname = \"mom-hub\"\n{dependency}\n");
            assert_eq!(
                faults(&manifest),
                [format!("a/Cargo.toml:{line}: {message}")],
                "{dependency}"
            );
        }
    }

    #[test]
    fn a_wing_that_uses_another_is_found_and_so_is_the_kit() {
        let root = "[workspace]\nmembers = [\"lab/arm\", \"fleet/rover\", \"kit/drive\"]\n";
        let package = |name: &str| format!("[package]\nname = \"{name}\"\n");
        let faults = |arm: &str, drive: &str| {
            let (arm, drive) = (package("mom-arm") + arm, package("mom-drive") + drive);
            let files = [
                ("Cargo.toml", root),
                ("lab/arm/Cargo.toml", arm.as_str()),
                ("fleet/rover/Cargo.toml", &package("mom-rover")),
                ("kit/drive/Cargo.toml", &drive),
            ];
            found(check, &files).len()
        };
        let uses = |name: &str| format!("[dependencies]\n{name}.workspace = true\n");
        // Each breaks its row of ARROWS as well.
        assert_eq!(faults("", ""), 0);
        assert_eq!(faults(&uses("mom-rover"), ""), 2);
        assert_eq!(faults("", &uses("mom-rover")), 2);
        assert_eq!(faults(&uses("mom-drive"), ""), 1);
    }

    #[test]
    fn arrows_of_the_design_and_of_tests_are_free() {
        for manifest in [
            "[package]\nname = \"mom-client\"\n[dependencies]\nmom-net.workspace = true\n",
            "[package]\nname = \"mom-hub\"\n[dev-dependencies]\nmom-net.workspace = true\n",
            "[package]\nname = \"mom-tests\"\n[dependencies]\nmom-net.workspace = true\n",
            "[package]\nname = \"mom-hub\"\n[dependencies]\nserde.workspace = true\n",
        ] {
            assert_eq!(faults(manifest), [] as [&str; 0], "{manifest}");
        }
    }

    #[test]
    fn an_arrow_that_nothing_needs_is_found() {
        let fault = "a/Cargo.toml:1: `mom-client` does not depend on `mom-net`: take that arrow out of ARROWS of xtask/src/tidy/imports.rs";
        for dependencies in ["", "[dev-dependencies]\nmom-net.workspace = true\n"] {
            let manifest = format!("[package]\nname = \"mom-client\"\n{dependencies}");
            assert_eq!(faults(&manifest), [fault], "{dependencies}");
        }
    }

    #[test]
    fn a_package_without_a_place_is_found() {
        let faults = faults("[package]\nname = \"newcomer\"\n");
        assert_eq!(faults.len(), 1);
        assert!(
            faults[0].starts_with("a/Cargo.toml:1: `newcomer` has no place"),
            "{faults:?}"
        );
    }

    #[test]
    fn impure_crates_are_seen_in_a_resolved_graph() {
        let graph =
            "mom-hub v0.1.0 (/x)\nmom-proto v0.1.0 (/y)\ntokio v1.54.0\ntokio-util v0.7.0\nmio v1.0.0 (*)\n";
        assert_eq!(
            impure_crates(graph).into_iter().collect::<Vec<_>>(),
            ["mio", "tokio"]
        );
        assert!(impure_crates("mom-hub v0.1.0\nserde v1.0.0\n").is_empty());
    }
}
