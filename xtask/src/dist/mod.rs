//! `cargo xtask dist`: what is installed: the programs with their pages, as archives and as packages for Debian.

mod debian;
mod files;
mod licences;

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

use anyhow::{Context as _, Result, ensure};

use crate::command::{cargo, line, output, shows};
use files::{copy, kept, open, put};

/// The links to `mom-device`, and what each is.
const LINKS: &[(&str, &str)] = &include!("../../../mom-robot/names.rs");

/// What is installed together, as an archive and as a package for Debian.
struct Pack {
    name: &'static str,
    /// Packages of the workspace, each with its program.
    programs: &'static [(&'static str, &'static str)],
    /// Names by which the last of the programs is started too.
    links: &'static [(&'static str, &'static str)],
    /// Of the folder `config`.
    configs: &'static [&'static str],
    /// A unit for systemd.
    unit: &'static str,
    /// What it has of `packages`, where that goes, and its mode.
    settings: &'static [(&'static str, &'static str, u32)],
    /// What dpkg runs and reads beside the control file.
    control: &'static [(&'static str, u32)],
    /// Whether the console is in its programs.
    has_console: bool,
}

const PACKS: [Pack; 2] = [
    Pack {
        name: "mom",
        programs: &[("mom-broker", "mom-broker"), ("mom", "mom")],
        links: &[],
        configs: &[
            "mom.toml",
            "lab.toml",
            "two-arms.toml",
            "fleet.toml",
            "convoy.toml",
            "lab-users.toml",
        ],
        unit: "mom-broker.service",
        settings: &[
            ("mom.toml", "etc/mom/mom.toml", 0o644),
            ("users.toml", "etc/mom/users.toml", 0o640),
        ],
        control: &[
            ("postinst", 0o755),
            ("prerm", 0o755),
            ("postrm", 0o755),
            ("conffiles", 0o644),
        ],
        has_console: true,
    },
    Pack {
        name: "mom-robot",
        programs: &[("mom-robot", "mom-device")],
        links: LINKS,
        configs: &[],
        // For robots; nobody starts it unasked.
        unit: "mom-linuxbot.service",
        settings: &[],
        control: &[],
        has_console: false,
    },
];

impl Pack {
    /// All names by which its programs are started.
    fn names(&self) -> impl Iterator<Item = &'static str> {
        let programs = self.programs.iter().map(|(_, program)| *program);
        programs.chain(self.links.iter().map(|(name, _)| *name))
    }

    /// The program that its links mean.
    fn linked(&self) -> &'static str {
        self.programs.last().map_or("", |(_, program)| program)
    }
}

/// What is packed, and whose it is.
struct Release {
    /// The version of all our packages.
    version: String,
    /// The name and mail of the author of the latest commit, to whom SECURITY.md sends reports.
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
    let (mut files, mut titles) = (Vec::new(), BTreeSet::new());
    let named = |pack: &str| format!("{pack}-{}-{}-linux", release.version, env::consts::ARCH);
    let debug = out.join(named("mom-debug"));
    fs::create_dir_all(&debug)?;
    for pack in &PACKS {
        let tree = out.join(named(pack.name));
        lay_out(root, pack, &programs, &tree, &debug)?;
        part_titles(&tree.join("man"), &mut titles)?;
        files.push(debian::pack(root, pack, &release, &tree, &out)?);
        files.push(archive(&release, &tree)?);
        fs::remove_dir_all(&tree)?;
    }
    open(&debug)?;
    files.push(archive(&release, &debug)?);
    fs::remove_dir_all(&debug)?;
    let container = "Containerfile".to_owned();
    copy(
        &root.join("packages").join(&container),
        &out.join(&container),
        0o644,
    )?;
    files.push(container);
    let mut sums = Command::new("sha256sum");
    sums.current_dir(&out).args(&files);
    put(&out.join("SHA256SUMS"), &output(&mut sums)?, 0o644)?;
    files.push("SHA256SUMS".to_owned());
    for file in files {
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
    for (package, _) in PACKS.iter().flat_map(|pack| pack.programs) {
        build.args(["--package", package]);
    }
    ensure!(shows(&mut build)?, "`{}` failed", line(&build));
    Ok(target(root).join("release"))
}

/// Puts everything that belongs to a pack into a folder, where its archive and its package take it from.
fn lay_out(root: &Path, pack: &Pack, programs: &Path, tree: &Path, debug: &Path) -> Result<()> {
    let pages = tree.join("pages");
    fs::create_dir_all(tree.join("bin"))?;
    for (_, name) in pack.programs {
        split(&programs.join(name), &tree.join("bin"), debug)?;
    }
    for (name, _) in pack.links {
        symlink(pack.linked(), tree.join("bin").join(name))?;
    }
    for name in pack.names() {
        // It is the program itself that writes them.
        let mut write = Command::new(tree.join("bin").join(name));
        output(write.arg("--write-pages").arg(&pages))?;
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
    for name in pack.configs {
        copy(
            &root.join("config").join(name),
            &tree.join("config").join(name),
            0o644,
        )?;
    }
    copy(
        &root.join("packages").join(pack.unit),
        &tree.join(pack.unit),
        0o644,
    )?;
    let packages: Vec<&str> = pack.programs.iter().map(|(package, _)| *package).collect();
    let licences = licences::of(root, &packages, pack.has_console)?;
    put(&tree.join("licences"), &licences, 0o644)?;
    open(tree)
}

/// Puts a program into the folder `bin` without its debug info, and that into the folder `debug`. The program names the file, and finds it
/// in
/// `.debug` beside itself, or in `/usr/lib/debug` below its own path: then a crash tells files and lines.
fn split(built: &Path, bin: &Path, debug: &Path) -> Result<()> {
    let name = built.file_name().context("a program has a name")?;
    let mut info_name = name.to_owned();
    info_name.push(".debug");
    let (stripped, info) = (bin.join(name), debug.join(info_name));
    let mut keep = Command::new("objcopy");
    output(keep.arg("--only-keep-debug").args([built, &info]))?;
    copy(&info, &info, 0o644)?;
    let mut strip = Command::new("objcopy");
    let mut link = OsString::from("--add-gnu-debuglink=");
    link.push(&info);
    output(strip.arg("--strip-all").arg(link).args([built, &stripped]))?;
    copy(&stripped, &stripped, 0o755)?;
    let mib = |path: &Path| anyhow::Ok(fs::metadata(path)?.len() as f64 / f64::from(1 << 20));
    println!(
        "{}: {:.1} MiB, its debug info {:.1} MiB",
        name.display(),
        mib(&stripped)?,
        mib(&info)?
    );
    Ok(())
}

/// Gives the section `1robot` to pages whose title another pack has: `mom-camera` is a program of its own, and `mom camera` a command.
/// No file may be in two packages; `man` finds either, that of section 1 first.
fn part_titles(man: &Path, titles: &mut BTreeSet<OsString>) -> Result<()> {
    for page in kept(man)? {
        let title = page.file_name().context("a page has a name")?.to_owned();
        if titles.contains(&title) {
            fs::rename(&page, page.with_extension("1robot"))?;
        }
        titles.insert(title);
    }
    Ok(())
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
