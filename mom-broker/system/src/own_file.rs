//! Files that only this broker writes and only its owner reads, and their disk.

use std::fs::{File, OpenOptions, TryLockError};
use std::io;
use std::path::Path;

/// Opens or creates a file for appending; nobody else may read it, and no other broker may write it.
///
/// # Errors
/// What the system says, or that another broker has the file.
pub fn open_own(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).append(true).create(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let file = options.open(path)?;
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => {
            let text = "another broker is writing to it";
            return Err(io::Error::new(io::ErrorKind::ResourceBusy, text));
        }
        // File systems without locks are accepted.
        Ok(()) | Err(TryLockError::Error(_)) => {}
    }
    #[cfg(unix)]
    if file.metadata()?.is_file() {
        file.set_permissions(std::os::unix::fs::PermissionsExt::from_mode(0o600))?;
    }
    Ok(file)
}

/// The path with `.` and this behind its name: `audit.jsonl.1`.
pub fn numbered(path: &Path, number: impl std::fmt::Display) -> std::path::PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(format!(".{number}"));
    name.into()
}

/// Bytes of a disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DiskSpace {
    /// That this broker may still fill.
    pub free: u64,
    /// In all.
    pub total: u64,
}

/// How full the disk of a file is.
///
/// # Errors
/// What the system says.
pub fn disk_space(path: &Path) -> io::Result<DiskSpace> {
    let disk = rustix::fs::statvfs(path)?;
    Ok(DiskSpace {
        free: disk.f_bavail.saturating_mul(disk.f_frsize),
        total: disk.f_blocks.saturating_mul(disk.f_frsize),
    })
}
