//! A machine inside this one: it begins with the files of a folder and keeps its changes, network and mounts to itself.

use std::io::{self, BufRead as _, BufReader, Read as _};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use tempfile::TempDir;

use crate::programs::text;

/// Mounts all of it, says that it is done, and holds it until standard input ends. The files that change are in memory.
const HOLD: &str = r#"
    set -e
    mount -t tmpfs tmpfs "$1"
    mkdir "$1/upper" "$1/work" "$1/all"
    mount -t overlay overlay -o "lowerdir=$2,upperdir=$1/upper,workdir=$1/work" "$1/all"
    mount --rbind /dev "$1/all/dev"
    mount --rbind /proc "$1/all/proc"
    mount -t tmpfs tmpfs "$1/all/run"
    mount --bind "$3" "$1/all/mnt"
    ip link set lo up
    ip addr add "$4/32" dev lo
    echo there
    exec cat"#;

/// An address of such a machine that is not loopback.
pub const ADDRESS: &str = "10.88.0.2";

/// Its programs know nothing of this machine's variables.
const PATH: &str = "/usr/sbin:/usr/bin:/sbin:/bin";

/// The machine; gone with this, once its programs have ended.
#[derive(Debug)]
pub struct Machine {
    /// The process whose namespaces it is.
    holder: Child,
    /// Where its files are, for that process.
    files: TempDir,
    /// What it sees at `/mnt`.
    shared: TempDir,
}

impl Machine {
    /// A machine that begins with the files of `base`: `/` is a copy of this one.
    ///
    /// # Errors
    /// Where namespaces or overlays may not be made; that is, not as root.
    pub fn start(base: &Path) -> io::Result<Machine> {
        let (files, shared) = (tempfile::tempdir()?, tempfile::tempdir()?);
        // Its users look into it.
        let open = std::os::unix::fs::PermissionsExt::from_mode(0o755);
        std::fs::set_permissions(shared.path(), open)?;
        let mut command = Command::new("unshare");
        command.args(["--mount", "--net", "sh", "-c", HOLD, "sh"]);
        command.args([files.path(), base, shared.path(), Path::new(ADDRESS)]);
        command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut holder = command.spawn()?;
        let (out, err) = (holder.stdout.take(), holder.stderr.take());
        let mut said = String::new();
        let (Some(out), Some(mut err)) = (out, err) else {
            return Err(io::Error::other("its output is piped"));
        };
        BufReader::new(out).read_line(&mut said)?;
        if said != "there\n" {
            err.read_to_string(&mut said)?;
            holder.wait()?;
            return Err(io::Error::other(said.trim().to_owned()));
        }
        Ok(Machine {
            holder,
            files,
            shared,
        })
    }

    /// The folder that is `/mnt` in there.
    pub fn shared(&self) -> &Path {
        self.shared.path()
    }

    /// A program in there, as root.
    pub fn command(&self, program: &str) -> Command {
        let mut command = Command::new("nsenter");
        command.args(["--mount", "--net", "--target", &self.holder.id().to_string()]);
        command
            .arg("chroot")
            .arg(self.files.path().join("all"))
            .arg(program);
        command.env_clear().env("PATH", PATH).stdin(Stdio::null());
        command
    }

    /// Runs a line of shell in it as root; what it says, on both ways.
    ///
    /// # Panics
    /// If it fails.
    pub fn sh(&self, line: &str, environment: &[(&str, &str)]) -> String {
        let mut command = self.command("sh");
        command.args(["-ec", line]).envs(environment.iter().copied());
        let output = command.output().expect("nsenter runs");
        let said = text(&output.stdout) + &text(&output.stderr);
        assert!(output.status.success(), "{line}: {said}");
        said
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        // It ends with its input.
        drop(self.holder.stdin.take());
        let _ = self.holder.wait();
    }
}
