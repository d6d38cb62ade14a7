//! The epoch of fences without a store: one number in a directory, by which fences rise over restarts.
//!
//! Each start takes the next number, under a lock and durably. So several brokers may share the directory: each has
//! an epoch of its own, above all that were given out before.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path as FilePath;

use mom_proto::{Fence, Time};

use super::StoreError;
use super::start::{make_directory, seconds, sync};

const EPOCH: &str = "epoch";

/// Takes the next epoch of a directory, which is made if it is not there. Blocks.
///
/// # Errors
/// Why the broker must not start: without it fences could fall.
pub(super) fn take(directory: &FilePath, wall: Time) -> Result<u64, StoreError> {
    let failed = |error| StoreError::State {
        path: directory.to_owned(),
        error,
    };
    make_directory(directory).map_err(failed)?;
    let lock = own(&directory.join("epoch.lock")).map_err(failed)?;
    // Held by others for as long as a number takes to be written.
    lock.lock().map_err(failed)?;
    let file = directory.join(EPOCH);
    let last = match fs::read_to_string(&file) {
        Ok(text) => Some(
            text.trim()
                .parse::<u64>()
                .map_err(|_| StoreError::Epoch { file: file.clone() })?,
        ),
        Err(error) if error.kind() == io::ErrorKind::NotFound => None,
        Err(error) => return Err(failed(error)),
    };
    let after = last.map(|last| last.saturating_add(1)).unwrap_or_default();
    let epoch = after.max(seconds(wall));
    if epoch > Fence::MAX_EPOCH {
        return Err(StoreError::Clock { epoch });
    }
    // Whole or not at all.
    let new = directory.join("epoch.new");
    let write = || {
        let mut file = own(&new)?;
        file.set_len(0)?;
        writeln!(file, "{epoch}")?;
        file.sync_all()?;
        fs::rename(&new, directory.join(EPOCH))?;
        sync(directory)
    };
    write().map_err(failed)?;
    // Closing would do, but for a process that is just being made and has all files of this one.
    let _ = lock.unlock();
    Ok(epoch)
}

fn own(path: &FilePath) -> io::Result<File> {
    OpenOptions::new()
        .write(true)
        .create(true)
        .truncate(false)
        .mode(0o600)
        .open(path)
}
