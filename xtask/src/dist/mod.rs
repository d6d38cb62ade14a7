//! `cargo xtask dist`: what is installed: the programs with their pages, as an archive and as a package for Debian.

mod debian;
mod files;
mod licences;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

use anyhow::{Context as _, Result, ensure};

use crate::command::{cargo, line, output, shows};
use files::{copy, kept, open, put};

/// The programs that are packed. Each has a package of its name.
const PROGRAMS: [&str; 13] = [
    "mom-broker",
    "mom-arm",
    "mom-camera",
    "mom-model",
    "mom-servo",
    "mom-mcp",
    "mom-linuxbot",
    "mom-base-station",
    "mom-gateway",
    "mom-rover",
    "mom-cubo",
    "mom-simulacrum",
    "mom",
];

/// What is packed, and whose it is.
struct Release {
    /// The version of all our packages.
    version: String,
    /// The name and mail of whoever made the latest commit, to whom SECURITY.md sends reports.
    maintainer: String,
    /// When it was made, in seconds since 1970: the same commit gives the same files.
    epoch: String,
    /// Whether it is compressed little.
    fast: bool,
}

/// Builds all of it into `out`, from the programs in `programs` if they are there already.
pub(crate) fn run(root: &Path, programs: Option<&Path>, out: Option<&Path>, fast: bool) -> Result<()> {
    let out = match out {
        Some(out) => {
            let empty = fs::read_dir(out).map_or(true, |mut entries| entries.next().is_none());
            ensure!(empty, "{} is not empty: name a new folder", out.display());
            out.to_owned()
        }
        None => target(root).join("dist"),
    };
    if out.exists() {
        fs::remove_dir_all(&out).with_context(|| format!("{} cannot be emptied", out.display()))?;
    }
    let programs = match programs {
        Some(programs) => programs.to_owned(),
        None => build(root)?,
    };
    let release = Release::of(root, fast)?;
    let tree = out.join(format!("mom-{}-{}-linux", release.version, env::consts::ARCH));
    lay_out(root, &programs, &tree)?;
    let package = debian::pack(root, &release, &tree, &out)?;
    let archive = archive(&release, &tree)?;
    let container = out.join("Containerfile");
    copy(&root.join("packages/Containerfile"), &container, 0o644)?;
    fs::remove_dir_all(&tree)?;
    let mut sums = Command::new("sha256sum");
    sums.current_dir(&out).args([&package, &archive, "Containerfile"]);
    put(&out.join("SHA256SUMS"), &output(&mut sums)?, 0o644)?;
    for file in [&package, &archive, "Containerfile", "SHA256SUMS"] {
        println!("{}", out.join(file).display());
    }
    Ok(())
}

impl Release {
    fn of(root: &Path, fast: bool) -> Result<Release> {
        let manifest: toml::Table = fs::read_to_string(root.join("Cargo.toml"))?.parse()?;
        let version = manifest["workspace"]["package"]["version"].as_str();
        let version = version.context("Cargo.toml has no workspace.package.version")?;
        let commit = |format: &str| {
            let mut git = Command::new("git");
            git.current_dir(root).args(["log", "-1", format]);
            output(&mut git).map(|text| text.trim().to_owned())
        };
        Ok(Release {
            version: version.to_owned(),
            maintainer: commit("--format=%an <%ae>")?,
            epoch: env::var("SOURCE_DATE_EPOCH").or_else(|_| commit("--format=%ct"))?,
            fast,
        })
    }
}

fn target(root: &Path) -> PathBuf {
    env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from)
}

/// Builds the programs as they are shipped, and says where they are.
fn build(root: &Path) -> Result<PathBuf> {
    let mut build = cargo(root);
    build.args(["build", "--release", "--locked", "--bins"]);
    for program in PROGRAMS {
        build.args(["--package", program]);
    }
    ensure!(shows(&mut build)?, "`{}` failed", line(&build));
    Ok(target(root).join("release"))
}

/// Puts everything that belongs to the programs into a folder, where the archive and the package take it from.
fn lay_out(root: &Path, programs: &Path, tree: &Path) -> Result<()> {
    let pages = tree.join("pages");
    for name in PROGRAMS {
        let built = programs.join(name);
        // Before it is stripped: it is the program itself that writes them.
        output(Command::new(&built).arg("--write-pages").arg(&pages))?;
        let stripped = tree.join("bin").join(name);
        fs::create_dir_all(tree.join("bin"))?;
        let mut strip = Command::new("strip");
        output(strip.arg("--strip-all").arg("-o").arg(&stripped).arg(&built))?;
        copy(&stripped, &stripped, 0o755)?;
        let bytes = fs::metadata(&stripped)?.len();
        println!("{name}: {:.1} MiB", bytes as f64 / f64::from(1 << 20));
    }
    fs::rename(pages.join("man"), tree.join("man"))?;
    fs::rename(&pages, tree.join("completions"))?;
    for file in kept(tree)? {
        if !file.starts_with(tree.join("bin")) {
            copy(&file, &file, 0o644)?;
        }
    }
    for name in ["LICENSE-APACHE", "LICENSE-MIT", "CHANGELOG.md", "README.md"] {
        copy(&root.join(name), &tree.join(name), 0o644)?;
    }
    for name in [
        "mom.toml",
        "lab.toml",
        "two-arms.toml",
        "fleet.toml",
        "convoy.toml",
        "lab-users.toml",
    ] {
        copy(
            &root.join("config").join(name),
            &tree.join("config").join(name),
            0o644,
        )?;
    }
    for unit in ["mom-broker.service", "mom-linuxbot.service"] {
        copy(&root.join("packages").join(unit), &tree.join(unit), 0o644)?;
    }
    put(&tree.join("licences"), &licences::of(root, &PROGRAMS)?, 0o644)?;
    open(tree)
}

/// Packs the folder beside itself; the archive's name.
fn archive(release: &Release, tree: &Path) -> Result<String> {
    let (parent, name) = (tree.parent(), tree.file_name());
    let (parent, name) = parent.zip(name).context("the folder has a name")?;
    let archive = format!("{}.tar.gz", name.to_string_lossy());
    let mut tar = Command::new("tar");
    tar.current_dir(parent)
        .env("GZIP", if release.fast { "-1n" } else { "-9n" });
    tar.args(["--sort=name", "--owner=root:0", "--group=root:0", "--format=gnu"]);
    tar.arg(format!("--mtime=@{}", release.epoch));
    tar.args(["--create", "--gzip", "--file", &archive]).arg(name);
    output(&mut tar)?;
    Ok(archive)
}
