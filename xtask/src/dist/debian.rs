//! Packages for Debian and its relatives: each a tree of files, which `dpkg-deb` packs.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result};

use super::files::{copy, kept, open, put};
use super::{Pack, Release};
use crate::command::output;

/// Packs what `tree` has into `out`; the package's name.
pub(super) fn pack(root: &Path, pack: &Pack, release: &Release, tree: &Path, out: &Path) -> Result<String> {
    let parts = root.join("packages");
    let package = out.join("debian");
    lay_out(&parts, pack, tree, &package)?;
    changelog(pack, release, &package)?;
    for file in kept(&package.join("usr/share"))? {
        let (man, doc) = (package.join("usr/share/man"), doc(pack, &package));
        let large = ["changelog", "CHANGELOG.md", "licences"].map(|name| doc.join(name));
        if file.starts_with(man) || large.contains(&file) {
            output(Command::new("gzip").arg("-9n").arg(&file))?;
        }
    }
    let control = package.join("DEBIAN");
    let own = parts.join("debian").join(pack.name);
    for (file, mode) in pack.control {
        copy(&own.join(file), &control.join(file), *mode)?;
    }
    let architecture = output(Command::new("dpkg").arg("--print-architecture"))?;
    let size = output(Command::new("du").args(["-sk", "--apparent-size"]).arg(&package))?;
    let fields = [
        ("@VERSION@", &*release.version),
        ("@ARCHITECTURE@", architecture.trim()),
        ("@MAINTAINER@", &release.maintainer),
        ("@SIZE@", size.split_whitespace().next().unwrap_or("0")),
        ("@DEPENDS@", &needs(pack, tree)?),
    ];
    let mut text = fs::read_to_string(own.join("control"))?;
    for (name, value) in fields {
        text = text.replace(name, value);
    }
    put(&control.join("control"), &text, 0o644)?;
    put(&control.join("md5sums"), &sums(&package)?, 0o644)?;
    open(&package)?;
    let name = format!("{}_{}_{}.deb", pack.name, release.version, architecture.trim());
    let mut build = Command::new("dpkg-deb");
    // xz is what each dpkg can unpack. The times in it are the commit's at the latest.
    let compress = if release.fast {
        ["-Zgzip", "-z1"]
    } else {
        ["-Zxz", "-z6"]
    };
    build.args(compress).args(["--root-owner-group", "--build"]);
    build
        .args([&package, &out.join(&name)])
        .env("SOURCE_DATE_EPOCH", &release.epoch);
    output(&mut build)?;
    fs::remove_dir_all(&package)?;
    Ok(name)
}

/// Where its documents are.
fn doc(pack: &Pack, package: &Path) -> PathBuf {
    package.join("usr/share/doc").join(pack.name)
}

/// Everything where Debian's policy has it.
fn lay_out(parts: &Path, pack: &Pack, tree: &Path, package: &Path) -> Result<()> {
    let to = |path: &str| package.join(path);
    for (_, name) in pack.programs {
        copy(&tree.join("bin").join(name), &to("usr/bin").join(name), 0o755)?;
    }
    for (name, _) in pack.links {
        symlink(pack.linked(), to("usr/bin").join(name))?;
    }
    let doc = doc(pack, package);
    for (from, into) in [
        ("man", "usr/share/man/man1"),
        ("completions/bash", "usr/share/bash-completion/completions"),
        ("completions/zsh", "usr/share/zsh/vendor-completions"),
        ("completions/fish", "usr/share/fish/vendor_completions.d"),
    ] {
        for file in kept(&tree.join(from))? {
            let name = file.file_name().context("a file has a name")?;
            copy(&file, &to(into).join(name), 0o644)?;
        }
    }
    for name in pack.configs {
        copy(
            &tree.join("config").join(name),
            &doc.join("examples").join(name),
            0o644,
        )?;
    }
    for (from, into, mode) in pack.settings {
        copy(&parts.join(from), &to(into), *mode)?;
    }
    copy(
        &parts.join(pack.unit),
        &to("lib/systemd/system").join(pack.unit),
        0o644,
    )?;
    let copyright = fs::read_to_string(parts.join("debian/copyright"))?;
    put(
        &doc.join("copyright"),
        &copyright.replace("@PACKAGE@", pack.name),
        0o644,
    )?;
    for name in ["CHANGELOG.md", "licences"] {
        copy(&tree.join(name), &doc.join(name), 0o644)?;
    }
    Ok(())
}

/// What changed is told in CHANGELOG.md; Debian's own form says which version this is.
fn changelog(pack: &Pack, release: &Release, package: &Path) -> Result<()> {
    let mut date = Command::new("date");
    let date = output(date.args(["--utc", "--rfc-email", "--date", &format!("@{}", release.epoch)]))?;
    let text = format!(
        "{} ({}) unstable; urgency=medium\n\n  * See CHANGELOG.md.\n\n -- {}  {}\n",
        pack.name,
        release.version,
        release.maintainer,
        date.trim()
    );
    put(&doc(pack, package).join("changelog"), &text, 0o644)
}

/// The libraries that the programs are linked with, in the versions of which they use something.
fn needs(pack: &Pack, tree: &Path) -> Result<String> {
    let mut versions: BTreeMap<&str, Vec<u32>> = BTreeMap::new();
    for (_, name) in pack.programs {
        let told = output(Command::new("objdump").arg("-p").arg(tree.join("bin").join(name)))?;
        for word in told.split_whitespace() {
            for (prefix, package) in [("GLIBC_", "libc6"), ("GCC_", "libgcc-s1")] {
                let Some(version) = word.strip_prefix(prefix) else {
                    continue;
                };
                let version: Vec<u32> = version.split('.').map_while(|part| part.parse().ok()).collect();
                let known = versions.entry(package).or_default();
                *known = known.clone().max(version);
            }
        }
    }
    let shown = versions.iter().map(|(package, version)| {
        let version: Vec<String> = version.iter().map(u32::to_string).collect();
        format!("{package} (>= {})", version.join("."))
    });
    Ok(shown.collect::<Vec<_>>().join(", "))
}

/// What dpkg checks the installed files by.
fn sums(package: &Path) -> Result<String> {
    let mut sums = Command::new("md5sum");
    sums.current_dir(package);
    for file in kept(package)? {
        let inside = file.strip_prefix(package)?;
        if !inside.starts_with("DEBIAN") && !inside.starts_with("etc") && !file.is_symlink() {
            sums.arg(inside);
        }
    }
    output(&mut sums)
}
