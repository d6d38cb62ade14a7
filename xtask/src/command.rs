//! Running other programs: one way to start them, to show what they do, and to say that they failed.

use std::ffi::OsString;
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, bail};

use crate::node;

/// A program of this machine, or of those that were installed for this project.
pub(crate) fn program(name: impl AsRef<std::ffi::OsStr>) -> Command {
    let mut command = Command::new(name);
    node::first(&mut command);
    command
}

/// The cargo that started this program, so that all steps use one toolchain.
pub(crate) fn cargo(root: &Path) -> Command {
    let mut command = program(std::env::var_os("CARGO").unwrap_or_else(|| OsString::from("cargo")));
    // Those of this package: ring's build script watches them, and it and all above it would be built again each time.
    for (name, _) in std::env::vars_os() {
        let text = name.to_string_lossy();
        if text.starts_with("CARGO_PKG_") || text.starts_with("CARGO_MANIFEST_") {
            command.env_remove(name);
        }
    }
    // No step may wait for an answer: CI has no one to give it.
    command.current_dir(root).stdin(Stdio::null());
    command
}

/// Whether this program starts and ends well with these arguments; its output is not shown.
pub(crate) fn succeeds(name: &str, args: &[&str]) -> bool {
    program(name)
        .args(args)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success())
}

/// Runs `command` with its output shown; whether it ended well.
pub(crate) fn shows(command: &mut Command) -> Result<bool> {
    let status = command
        .status()
        .with_context(|| format!("`{}` cannot be started", line(command)))?;
    Ok(status.success())
}

/// What `command` prints on its standard output; an error with what it complained about if it fails.
pub(crate) fn output(command: &mut Command) -> Result<String> {
    let out = command
        .output()
        .with_context(|| format!("`{}` cannot be started", line(command)))?;
    if !out.status.success() {
        bail!(
            "`{}` failed:\n{}",
            line(command),
            String::from_utf8_lossy(&out.stderr).trim_end()
        );
    }
    Ok(String::from_utf8_lossy(&out.stdout).into_owned())
}

/// The command as one would type it.
pub(crate) fn line(command: &Command) -> String {
    let program = Path::new(command.get_program());
    let mut words = vec![
        program
            .file_name()
            .unwrap_or(command.get_program())
            .to_string_lossy()
            .into_owned(),
    ];
    words.extend(command.get_args().map(|arg| arg.to_string_lossy().into_owned()));
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_program_does_not_succeed() {
        assert!(succeeds("cargo", &["--version"]));
        assert!(!succeeds("cargo", &["--no-such-flag"]));
        assert!(!succeeds("no-such-program-anywhere", &[]));
    }

    #[test]
    fn output_is_returned_and_a_failure_says_what_was_run() {
        let version = output(cargo(Path::new(".")).arg("--version")).unwrap();
        assert!(version.starts_with("cargo "), "{version}");
        let error = output(cargo(Path::new(".")).arg("--no-such-flag"))
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("cargo --no-such-flag") && error.contains("unexpected argument"),
            "{error}"
        );
    }
}
