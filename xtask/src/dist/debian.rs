//! The package for Debian and its relatives: a tree of files, which `dpkg-deb` packs.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context as _, Result};

use super::files::{copy, kept, open, put};
use super::{PROGRAMS, Release};
use crate::command::output;

/// Packs what `tree` has into `out`; the package's name.
pub(super) fn pack(root: &Path, release: &Release, tree: &Path, out: &Path) -> Result<String> {
    let parts = root.join("packages");
    let package = out.join("debian");
    lay_out(&parts, tree, &package)?;
    changelog(release, &package)?;
    for file in kept(&package.join("usr/share"))? {
        let (man, doc) = (package.join("usr/share/man"), package.join("usr/share/doc/mom"));
        let large = ["changelog", "CHANGELOG.md", "licences"].map(|name| doc.join(name));
        if file.starts_with(man) || large.contains(&file) {
            output(Command::new("gzip").arg("-9n").arg(&file))?;
        }
    }
    let control = package.join("DEBIAN");
    for script in ["postinst", "prerm", "postrm"] {
        copy(&parts.join("debian").join(script), &control.join(script), 0o755)?;
    }
    let conffiles = control.join("conffiles");
    copy(&parts.join("debian/conffiles"), &conffiles, 0o644)?;
    let architecture = output(Command::new("dpkg").arg("--print-architecture"))?;
    let size = output(Command::new("du").args(["-sk", "--apparent-size"]).arg(&package))?;
    let fields = [
        ("@VERSION@", &*release.version),
        ("@ARCHITECTURE@", architecture.trim()),
        ("@MAINTAINER@", &release.maintainer),
        ("@SIZE@", size.split_whitespace().next().unwrap_or("0")),
        ("@DEPENDS@", &needs(tree)?),
    ];
    let mut text = fs::read_to_string(parts.join("debian/control"))?;
    for (name, value) in fields {
        text = text.replace(name, value);
    }
    put(&control.join("control"), &text, 0o644)?;
    put(&control.join("md5sums"), &sums(&package)?, 0o644)?;
    open(&package)?;
    let name = format!("mom_{}_{}.deb", release.version, architecture.trim());
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

/// Everything where Debian's policy has it.
fn lay_out(parts: &Path, tree: &Path, package: &Path) -> Result<()> {
    let to = |path: &str| package.join(path);
    for name in PROGRAMS {
        copy(&tree.join("bin").join(name), &to("usr/bin").join(name), 0o755)?;
    }
    for (from, into) in [
        ("man", "usr/share/man/man1"),
        ("completions/bash", "usr/share/bash-completion/completions"),
        ("completions/zsh", "usr/share/zsh/vendor-completions"),
        ("completions/fish", "usr/share/fish/vendor_completions.d"),
        ("config", "usr/share/doc/mom/examples"),
    ] {
        for file in kept(&tree.join(from))? {
            let name = file.file_name().context("a file has a name")?;
            copy(&file, &to(into).join(name), 0o644)?;
        }
    }
    for (from, into, mode) in [
        ("mom.toml", "etc/mom/mom.toml", 0o644),
        ("users.toml", "etc/mom/users.toml", 0o640),
        (
            "mom-broker.service",
            "lib/systemd/system/mom-broker.service",
            0o644,
        ),
        // For robots; nobody starts it unasked.
        (
            "mom-linuxbot.service",
            "lib/systemd/system/mom-linuxbot.service",
            0o644,
        ),
        ("debian/copyright", "usr/share/doc/mom/copyright", 0o644),
    ] {
        copy(&parts.join(from), &to(into), mode)?;
    }
    for name in ["CHANGELOG.md", "licences"] {
        copy(&tree.join(name), &to("usr/share/doc/mom").join(name), 0o644)?;
    }
    Ok(())
}

/// What changed is told in CHANGELOG.md; Debian's own form says which version this is.
fn changelog(release: &Release, package: &Path) -> Result<()> {
    let mut date = Command::new("date");
    let date = output(date.args(["--utc", "--rfc-email", "--date", &format!("@{}", release.epoch)]))?;
    let text = format!(
        "mom ({}) unstable; urgency=medium\n\n  * See CHANGELOG.md.\n\n -- {}  {}\n",
        release.version,
        release.maintainer,
        date.trim()
    );
    put(&package.join("usr/share/doc/mom/changelog"), &text, 0o644)
}

/// The libraries that the programs are linked with, in the versions of which they use something.
fn needs(tree: &Path) -> Result<String> {
    let mut versions: BTreeMap<&str, Vec<u32>> = BTreeMap::new();
    for name in PROGRAMS {
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
        if !inside.starts_with("DEBIAN") && !inside.starts_with("etc") {
            sums.arg(inside);
        }
    }
    output(&mut sums)
}
