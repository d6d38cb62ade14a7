//! `cargo xtask simulate`: the whole in virtual time, seed after seed.
//!
//! It is built in a folder of its own with `tokio_unstable`, by which a runtime takes the seed of what `select!` chooses, with its own
//! random numbers where libraries look for the system's by name, and with the assertions of a debug build.

use std::path::Path;
use std::process::Command;

use anyhow::Result;

use crate::clients::target;
use crate::command::{cargo, line, shows};

/// Builds and runs it with these words; whether no promise was broken.
pub(crate) fn run(root: &Path, args: &[String]) -> Result<bool> {
    let mut simulation = command(root, args);
    println!("$ {}", line(&simulation));
    shows(&mut simulation)
}

fn command(root: &Path, args: &[String]) -> Command {
    let mut simulation = cargo(root);
    simulation
        .args([
            "run",
            "--quiet",
            "--release",
            "--locked",
            "--package",
            "mom-simulation",
        ])
        .arg("--target-dir")
        .arg(target(root).join("simulate"))
        .arg("--")
        .args(args)
        .env("RUSTFLAGS", "--cfg tokio_unstable -C link-arg=-rdynamic")
        .env("CARGO_PROFILE_RELEASE_DEBUG_ASSERTIONS", "true")
        .env("CARGO_PROFILE_RELEASE_OVERFLOW_CHECKS", "true");
    simulation
}
