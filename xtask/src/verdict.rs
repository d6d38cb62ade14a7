//! What was found of some code, stored with a hash of it: as long as the code is the same, CI need not find it again.

use std::path::Path;
use std::process::Command;

use anyhow::Result;
use sha2::{Digest as _, Sha256};

use crate::command::output;
use crate::tidy::Tree;

/// The key of the hash in a file with a verdict.
pub(crate) const SOURCES: &str = "sources";

/// The stored counts of instructions, by case.
pub(crate) const BASELINE: &str = "benches/instructions.toml";

/// A hash of the files of the checkout that count, and of the compiler.
pub(crate) fn sources(root: &Path, counts: impl Fn(&str) -> bool) -> Result<String> {
    let compiler = output(Command::new("rustc").arg("--version").arg("--verbose"))?;
    Ok(hash(&Tree::read(root)?, &compiler, counts))
}

fn hash(tree: &Tree, compiler: &str, counts: impl Fn(&str) -> bool) -> String {
    let mut hash = Sha256::new();
    hash.update(compiler);
    for (path, text) in tree.files().filter(|(path, _)| counts(path)) {
        for part in [path, text] {
            hash.update(part.len().to_le_bytes());
            hash.update(part);
        }
    }
    format!("{:x}", hash.finalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_verdict_holds_for_the_code_that_it_is_of() {
        let counts = |path: &str| path != "docs/design.md";
        let of = |files: &[(&str, &str)], compiler| hash(&Tree::of(files), compiler, counts);
        let (lock, hub) = (("Cargo.lock", "1"), ("mom-hub/src/lib.rs", "fn admit() {}"));
        let now = of(&[lock, hub], "rustc 1");
        assert_eq!(of(&[lock, hub, ("docs/design.md", "words")], "rustc 1"), now);
        for (files, compiler) in [
            ([lock, ("mom-hub/src/lib.rs", "fn admit() { }")], "rustc 1"),
            ([lock, ("mom-hub/src/lab.rs", "fn admit() {}")], "rustc 1"),
            ([("Cargo.lock", "2"), hub], "rustc 1"),
            ([lock, hub], "rustc 2"),
        ] {
            assert_ne!(of(&files, compiler), now, "{files:?} {compiler}");
        }
    }
}
