//! The client in JavaScript: built, tested and packed by npm.

use std::path::Path;

use anyhow::{Context as _, Result};

use crate::command::output;
use crate::counts::Counts;
use crate::npm;

/// Where it is, from the workspace's folder.
pub(crate) const FOLDER: &str = "clients/js";

/// Builds what its tests, and the dialogues that go through it, run.
pub(crate) fn build(root: &Path) -> Result<()> {
    npm::run(root, FOLDER, "build")
}

/// Runs its tests against this broker.
pub(crate) fn test(root: &Path, broker: &Path) -> Result<(String, Counts)> {
    // As it was built before: other tests that run now read that.
    npm::test(root, FOLDER, "test:built", ("MOM_BROKER", broker))
}

/// Writes it as a package for npm; says where.
pub(crate) fn pack(root: &Path, into: &Path) -> Result<()> {
    std::fs::create_dir_all(into).with_context(|| format!("{} cannot be made", into.display()))?;
    let mut pack = npm::npm(root, FOLDER, &["pack", "--silent", "--pack-destination"]);
    let said = output(pack.arg(into))?;
    println!("{}", said.lines().last().unwrap_or_default());
    println!("in {}", into.display());
    Ok(())
}
