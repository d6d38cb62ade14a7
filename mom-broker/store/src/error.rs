//! A store that cannot be used: which file, why, and what to do.

use std::io;
use std::path::PathBuf;

/// A store with which the broker does not start.
///
/// Starting without it could let fences fall or grant a token in the time of another's lease.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The directory cannot be made or used.
    #[error("[store] {}: {error}; path must be a directory writable by this user", path.display())]
    Directory {
        /// The directory.
        path: PathBuf,
        /// What the system says.
        error: io::Error,
    },
    /// Another broker uses the directory.
    #[error(
        "[store] {} is in use: another broker runs on it; stop that one, or give this one a path of its own",
        path.display()
    )]
    InUse {
        /// The directory.
        path: PathBuf,
    },
    /// A file does not hold what was written to it.
    #[error(
        "[store] {}: {reason}; the broker does not start, so that no fence falls and no token is granted in the \
         time of another's lease. To go on without what the store held: halt what the tokens guard, wait for the \
         longest lease, check that this machine's clock is right, move {} away, and start again",
        file.display(),
        directory(file)
    )]
    Damaged {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A file cannot be read or written.
    #[error("[store] {}: {reason}; check that the disk is healthy, has free space, and is writable by this user", file.display())]
    Unwritable {
        /// The file.
        file: PathBuf,
        /// What the system says.
        reason: String,
    },
    /// The directory of the epoch cannot be made or used.
    #[error(
        "[store] state, {}: {error}; fences rise over restarts by a number that is kept there, so the broker does not \
         start without it. Give it a directory that this user may write to: state in [store] of the configuration, \
         STATE_DIRECTORY (StateDirectory=mom in a unit of systemd), or XDG_STATE_HOME",
        path.display()
    )]
    State {
        /// The directory.
        path: PathBuf,
        /// What the system says.
        error: io::Error,
    },
    /// Nothing says where the epoch could be kept.
    #[error(
        "[store] state: there is no directory for the number by which fences rise over restarts, as neither \
         STATE_DIRECTORY nor XDG_STATE_HOME nor HOME is set; name one as state in [store] of the configuration, or in \
         STATE_DIRECTORY"
    )]
    NoState,
    /// The epoch is not a number.
    #[error(
        "[store] state, {}: this is not the number that was written there; the broker does not start, so that no fence \
         falls. To go on without it: halt what the tokens guard, check that this machine's clock is right, move the \
         file away, and start again",
        file.display()
    )]
    Epoch {
        /// The file.
        file: PathBuf,
    },
    /// The wall clock is beyond all fences.
    #[error("fences of the epoch {epoch} are beyond 2^53; check that this machine's clock is right")]
    Clock {
        /// The epoch that would follow.
        epoch: u64,
    },
}

fn directory(file: &std::path::Path) -> String {
    let directory = file.parent().unwrap_or(file);
    format!("the directory {}", directory.display())
}
