//! The file of a log and those before it: how many are kept, and how much of the disk they leave to others.
//!
//! The store of tokens may lie on the same disk, and nobody is granted a token that cannot be stored. So logs give way:
//! where too little is free, the oldest files are removed, and if that is not enough nothing more is written.

use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use mom_system::{DiskSpace, disk_space, numbered};

/// The files of one log: `audit.jsonl` and its predecessors, of which `audit.jsonl.1` is the youngest.
#[derive(Debug)]
pub(crate) struct KeptFiles {
    path: PathBuf,
    keep: u32,
    reserve: u64,
    space: fn(&Path) -> io::Result<DiskSpace>,
}

impl KeptFiles {
    /// Those of this path: so many predecessors, and so many bytes that are left free on their disk, though never more
    /// than a tenth of it.
    pub(crate) fn new(path: &Path, keep: u32, reserve: u64) -> KeptFiles {
        KeptFiles {
            path: path.to_owned(),
            keep,
            reserve,
            space: disk_space,
        }
    }

    /// On another disk.
    #[cfg(test)]
    pub(crate) fn on(self, space: fn(&Path) -> io::Result<DiskSpace>) -> KeptFiles {
        KeptFiles { space, ..self }
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// How many bytes all files may have if one may have `size`.
    pub(crate) fn most(&self, size: u64) -> u64 {
        size.saturating_mul(u64::from(self.keep) + 1)
    }

    /// Removes those that were kept by an earlier configuration and are too many by this one.
    ///
    /// # Errors
    /// What the system says.
    pub(crate) fn trim(&self) -> io::Result<()> {
        for number in self.keep.saturating_add(1).. {
            if !remove(&numbered(&self.path, number))? {
                break;
            }
        }
        Ok(())
    }

    /// Makes the present file the youngest of the old ones; the oldest goes.
    ///
    /// # Errors
    /// What the system says.
    pub(crate) fn shift(&self) -> io::Result<()> {
        if self.keep == 0 {
            return remove(&self.path).map(|_| ());
        }
        for number in (1..self.keep).rev() {
            match fs::rename(self.old(number), self.old(number + 1)) {
                Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
                _ => {}
            }
        }
        fs::rename(&self.path, self.old(1))
    }

    /// Makes sure that enough of the disk is free; removes the oldest files for that.
    ///
    /// # Errors
    /// Too little is free although none of them is left.
    pub(crate) fn leave_space(&self) -> io::Result<()> {
        let mut number = self.keep;
        while let Some(reserve) = self.lacking() {
            // From the oldest on; some may be missing.
            while number > 0 && !remove(&self.old(number))? {
                number -= 1;
            }
            if number == 0 {
                let text =
                    format!("less than {reserve} bytes of its disk are free, which it leaves to others");
                return Err(io::Error::new(ErrorKind::StorageFull, text));
            }
        }
        Ok(())
    }

    /// What should be free, if less is. A disk that does not say counts as one with enough.
    fn lacking(&self) -> Option<u64> {
        let space = (self.space)(&self.path).ok()?;
        let reserve = self.reserve.min(space.total / 10);
        (space.free < reserve).then_some(reserve)
    }

    fn old(&self, number: u32) -> PathBuf {
        numbered(&self.path, number)
    }
}

/// False if there is none.
fn remove(path: &Path) -> io::Result<bool> {
    match fs::remove_file(path) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(false),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tempfile::TempDir;

    /// A disk of 1000 bytes, which holds what is in the file's folder.
    fn small(path: &Path) -> io::Result<DiskSpace> {
        let mut used = 0;
        for entry in fs::read_dir(path.parent().expect("a folder"))? {
            used += entry?.metadata()?.len();
        }
        Ok(DiskSpace {
            free: 1000_u64.saturating_sub(used),
            total: 1000,
        })
    }

    #[test]
    fn the_oldest_go_where_the_disk_is_full() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("log");
        let files = KeptFiles::new(&path, 9, 1 << 30).on(small);
        let write = |name: &Path, bytes| fs::write(name, vec![b'x'; bytes]).unwrap();
        write(&path, 150);
        for number in [1, 2, 4, 5] {
            write(&numbered(&path, number), 200);
        }
        assert!(files.leave_space().is_ok());
        assert!(
            numbered(&path, 4).exists() && !numbered(&path, 5).exists(),
            "a tenth is free"
        );
        write(&folder.path().join("other"), 550);
        assert!(files.leave_space().is_ok());
        assert!(numbered(&path, 1).exists() && !numbered(&path, 2).exists());
        write(&folder.path().join("other"), 850);
        let error = files.leave_space().unwrap_err();
        assert_eq!(error.kind(), ErrorKind::StorageFull);
        assert!(error.to_string().contains("less than 100 bytes"), "{error}");
        assert!(
            path.exists() && !numbered(&path, 1).exists(),
            "what is written now stays"
        );
    }

    #[test]
    fn what_is_too_many_goes() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("log");
        for number in 1..=5 {
            fs::write(numbered(&path, number), number.to_string()).unwrap();
        }
        fs::write(&path, "0").unwrap();
        let files = KeptFiles::new(&path, 2, 0);
        files.trim().unwrap();
        files.shift().unwrap();
        let read = |number| fs::read_to_string(numbered(&path, number)).ok();
        assert_eq!(
            [1, 2, 3].map(read),
            [Some("0".to_owned()), Some("1".to_owned()), None]
        );
        fs::write(&path, "now").unwrap();
        KeptFiles::new(&path, 0, 0).shift().unwrap();
        assert!(!path.exists());
    }
}
