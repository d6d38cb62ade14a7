//! By default the crate needs neither std nor alloc nor another crate, so that it builds for a microcontroller.
//!
//! A build for one (`cargo build -p mom-rsp --target thumbv7em-none-eabi`) shows it too, where that target is installed.

use std::fs;
use std::path::Path;

fn file(path: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).expect(path)
}

#[test]
fn only_the_middle_and_tests_have_more_than_core() {
    let root = file("src/lib.rs");
    assert!(root.contains("\n#![no_std]\n"));
    assert!(root.contains("#[cfg(feature = \"middle\")]\nextern crate alloc;"));
    assert!(root.contains("#[cfg(test)]\nextern crate std;"));
    assert!(root.contains("#[cfg(feature = \"middle\")]\npub mod middle;"));
    let manifest = file("Cargo.toml");
    assert!(manifest.contains("\ndefault = []\n"));
    let (_, dependencies) = manifest.split_once("\n[dependencies]\n").expect("dependencies");
    let (dependencies, _) = dependencies.split_once("\n[").expect("more");
    assert!(
        dependencies
            .trim()
            .lines()
            .all(|line| line.contains("optional = true")),
        "{dependencies}"
    );
}
