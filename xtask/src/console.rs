//! `cargo xtask console`: the console, built by npm, for the programs that are built after it; `cargo xtask lab`: a lab with it.

use std::ffi::OsStr;
use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::SystemTime;

use anyhow::{Context as _, Result, bail};

use crate::command::{cargo, line};
use crate::counts::Counts;
use crate::{javascript, npm};

/// Where it is, from the workspace's folder.
pub(crate) const FOLDER: &str = "console";

/// What a build of it has at least.
const BUILT: [&str; 2] = ["index.html", "build.json"];

/// What is in its folder and no part of a build.
const ASIDE: [&str; 3] = ["node_modules", "dist", "test"];

/// Checks and builds it, unless what is there is newer than all that it is made of.
pub(crate) fn build(root: &Path) -> Result<()> {
    let (console, client) = (root.join(FOLDER), root.join(javascript::FOLDER).join("src"));
    let built = built(&console);
    let made = latest(&console)?.max(latest(&client)?);
    if built.is_some_and(|built| built > made) {
        println!("console: {FOLDER}/dist is newer than its sources, and stays");
        return Ok(());
    }
    npm::run(root, FOLDER, "check")?;
    npm::run(root, FOLDER, "build")?;
    for name in BUILT {
        let file = console.join("dist").join(name);
        if !file.is_file() {
            bail!("the build of {FOLDER} has left no dist/{name}, without which there is no console");
        }
    }
    println!("console: built into {FOLDER}/dist; programs that are built from now on have it");
    Ok(())
}

/// Runs its tests against this program `mom`.
pub(crate) fn test(root: &Path, mom: &Path) -> Result<(String, Counts)> {
    npm::test(root, FOLDER, "test", ("MOM_BIN", mom))
}

/// Starts a lab in place of this program, so that Ctrl-C is the lab's alone.
pub(crate) fn lab(root: &Path, args: &[String]) -> Result<bool> {
    let mut lab = cargo(root);
    lab.args(["run", "--release", "--locked", "--", "lab"]).args(args);
    lab.stdin(Stdio::inherit());
    println!("$ {}", line(&lab));
    become_it(&mut lab).with_context(|| format!("`{}` cannot be started", line(&lab)))
}

#[cfg(unix)]
fn become_it(command: &mut std::process::Command) -> std::io::Result<bool> {
    use std::os::unix::process::CommandExt as _;
    Err(command.exec())
}

#[cfg(not(unix))]
fn become_it(command: &mut std::process::Command) -> std::io::Result<bool> {
    Ok(command.status()?.success())
}

/// When the oldest part of the build was written; none if it is not whole.
fn built(console: &Path) -> Option<SystemTime> {
    let written = |name| fs::metadata(console.join("dist").join(name)).and_then(|file| file.modified());
    BUILT.into_iter().map(|name| written(name).ok()).min().flatten()
}

/// When the newest file below a folder was written, or the folder in it from which one was taken.
fn latest(folder: &Path) -> Result<SystemTime> {
    let cannot = || format!("{} cannot be read", folder.display());
    let mut latest = SystemTime::UNIX_EPOCH;
    for entry in fs::read_dir(folder).with_context(cannot)? {
        let entry = entry.with_context(cannot)?;
        let aside = ASIDE
            .into_iter()
            .any(|name| entry.file_name() == OsStr::new(name));
        if aside {
            continue;
        }
        let found = entry.metadata().with_context(cannot)?;
        latest = latest.max(found.modified().with_context(cannot)?);
        if found.is_dir() {
            latest = latest.max(self::latest(&entry.path())?);
        }
    }
    Ok(latest)
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::time::Duration;

    use super::*;

    /// Writes it as of so many seconds after 1970.
    fn write(folder: &Path, name: &str, seconds: u64) {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        let file = File::create(path).expect("made");
        file.set_modified(SystemTime::UNIX_EPOCH + Duration::from_secs(seconds))
            .expect("set");
    }

    #[test]
    fn a_build_is_as_old_as_its_oldest_part() {
        let folder = tempfile::tempdir().expect("a folder");
        let console = folder.path();
        let seconds = |console: &Path| {
            let since = |time: SystemTime| {
                time.duration_since(SystemTime::UNIX_EPOCH)
                    .map(|since| since.as_secs())
            };
            built(console).and_then(|time| since(time).ok())
        };
        assert_eq!(seconds(console), None);
        write(console, "dist/index.html", 50);
        assert_eq!(seconds(console), None, "it is not whole");
        write(console, "dist/build.json", 70);
        assert_eq!(seconds(console), Some(50));
    }

    #[test]
    fn what_it_is_made_of_is_newest() {
        let folder = tempfile::tempdir().expect("a folder");
        let console = folder.path();
        // A folder is as new as the last file that was put into it.
        let begin = SystemTime::now();
        for name in [
            "dist/index.html",
            "node_modules/vite/package.json",
            "test/page.test.mjs",
        ] {
            write(console, name, 4_000_000_000);
        }
        assert_eq!(
            latest(console).expect("it is there"),
            SystemTime::UNIX_EPOCH,
            "none of these counts"
        );
        write(console, "package.json", 40);
        let forty = SystemTime::UNIX_EPOCH + Duration::from_secs(40);
        assert_eq!(latest(console).expect("it is there"), forty);
        write(console, "src/parts/arm.ts", 60);
        let latest = latest(console).expect("it is there");
        assert!(
            latest >= begin - Duration::from_secs(1),
            "the folder of a new file is new: {latest:?}"
        );
    }
}
