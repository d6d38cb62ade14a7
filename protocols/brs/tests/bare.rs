//! By default the crate needs neither std nor alloc nor another crate, so that it builds for a microcontroller.
//!
//! A build for one (`cargo build -p mom-brs --target thumbv7em-none-eabi`) shows it too, where that target is installed.

use std::fs;
use std::path::Path;

fn file(path: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).expect(path)
}

#[test]
fn the_default_features_bring_no_crate() {
    let manifest: toml::Table = file("Cargo.toml").parse().unwrap();
    let default = manifest["features"]["default"].as_array().unwrap();
    assert!(default.is_empty());
    for (name, dependency) in manifest["dependencies"].as_table().unwrap() {
        let optional = dependency.get("optional").and_then(toml::Value::as_bool);
        assert_eq!(optional, Some(true), "{name}");
    }
}

#[test]
fn only_the_room_of_files_and_tests_use_std() {
    let root = file("src/lib.rs");
    let before = |needle: &str| -> Vec<&str> {
        let found = root.match_indices(needle);
        found
            .map(|(at, _)| root[..at].trim_end().lines().last().unwrap())
            .collect()
    };
    assert!(root.contains("\n#![no_std]\n"));
    assert!(!root.contains("extern crate alloc"));
    assert_eq!(
        before("extern crate std;"),
        ["#[cfg(any(test, feature = \"file\"))]"]
    );
    assert_eq!(before("pub mod file;"), ["#[cfg(feature = \"file\")]"]);
    for name in ["frame", "number", "parser", "table"] {
        let text = file(&format!("src/{name}.rs"));
        let (shipped, _tests) = text.split_once("#[cfg(test)]").expect(name);
        assert!(
            !shipped.contains("std::") && !shipped.contains("alloc::"),
            "{name}"
        );
    }
}
