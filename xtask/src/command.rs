//! Running other programs: one way to start them, to show what they do, and to say that they failed.

use std::ffi::OsString;
use std::io::Read as _;
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use anyhow::{Context as _, Result, bail};

use crate::node;

/// How long programs take to end that are killed.
const END: Duration = Duration::from_secs(30);

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

/// What `command` prints on its standard output, and how it ended; whatever it has started is ended when this much time is over.
pub(crate) fn output_within(command: &mut Command, limit: Duration) -> Result<(String, ExitStatus)> {
    let spawned = command.stdout(Stdio::piped()).spawn();
    let mut child = spawned.with_context(|| format!("`{}` cannot be started", line(command)))?;
    let mut stdout = child.stdout.take().context("its output cannot be read")?;
    let (sender, text) = channel();
    std::thread::spawn(move || {
        let mut said = Vec::new();
        let read = stdout.read_to_end(&mut said);
        // Nobody waits any more where the limit is over.
        let _ = sender.send(match read {
            Ok(_) => String::from_utf8_lossy(&said).into_owned(),
            Err(error) => format!("its output cannot be read: {error}"),
        });
    });
    let mut said = text.recv_timeout(limit);
    if said == Err(RecvTimeoutError::Timeout) {
        eprintln!(
            "`{}` has not ended within {} s, and is ended",
            line(command),
            limit.as_secs()
        );
        end_with_children(child.id());
        said = text.recv_timeout(END);
    }
    let said =
        said.with_context(|| format!("`{}` has left a program that holds its output", line(command)))?;
    Ok((said, child.wait().context("it cannot be waited for")?))
}

/// Ends a program and all that it has started, as far as the system tells whom.
pub(crate) fn end_with_children(pid: u32) {
    let known = std::fs::read_to_string(format!("/proc/{pid}/task/{pid}/children")).unwrap_or_default();
    // It first, so that it starts no other.
    succeeds("kill", &["-KILL", &pid.to_string()]);
    for child in known.split_whitespace().filter_map(|word| word.parse().ok()) {
        end_with_children(child);
    }
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
    fn a_program_that_does_not_end_is_ended_with_what_it_has_started() {
        let mut short = Command::new("sh");
        let (said, status) =
            output_within(short.args(["-c", "echo a"]), Duration::from_secs(60)).expect("it runs");
        assert!(said == "a\n" && status.success(), "{said}");
        // The sleeper holds the pipe: its end is the end of the output.
        let mut long = Command::new("sh");
        let (said, status) = output_within(
            long.args(["-c", "echo b; sleep 600 & wait"]),
            Duration::from_millis(300),
        )
        .expect("it runs");
        assert!(said == "b\n" && !status.success(), "{said}");
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
