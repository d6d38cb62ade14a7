//! `cargo xtask experiments`: the papers' experiments, with the programs as they are shipped. Never a part of CI.

use std::path::Path;
use std::process::Command;

use anyhow::Result;

use crate::command::shows;
use crate::peers::build;

/// Builds the broker, the lab's devices and what experiments with them, and hands the arguments on.
pub(crate) fn run(root: &Path, args: &[String]) -> Result<bool> {
    let built = build(
        root,
        &[
            ("mom-broker", &["mom-broker"]),
            ("mom-robot", &["mom-device"]),
            ("mom-experiments", &["experiments"]),
        ],
    )?;
    shows(Command::new(built.join("experiments")).args(args))
}
