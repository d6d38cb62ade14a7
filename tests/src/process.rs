//! What the system says of a program that runs: its memory, threads and open files.

use std::fs;

use crate::programs::Running;

/// The memory of a program, in bytes: what it has (`VmRSS`), or the most that it ever had (`VmHWM`).
///
/// # Panics
/// If it has ended, or this is not Linux.
pub fn resident(program: &Running, key: &str) -> usize {
    let status = fs::read_to_string(format!("/proc/{}/status", program.id())).expect("it runs");
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix(key)?.strip_prefix(':'));
    let kib = line.and_then(|line| line.split_whitespace().next()?.parse::<usize>().ok());
    kib.expect("Linux says so") * 1024
}

/// Its threads.
///
/// # Panics
/// If it has ended, or this is not Linux.
pub fn threads(program: &Running) -> usize {
    entries(program, "task")
}

/// Its open files, connections among them.
///
/// # Panics
/// If it has ended, or this is not Linux.
pub fn files(program: &Running) -> usize {
    entries(program, "fd")
}

fn entries(program: &Running, folder: &str) -> usize {
    let entries = fs::read_dir(format!("/proc/{}/{folder}", program.id()));
    entries.expect("it runs").count()
}
