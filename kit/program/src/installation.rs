//! Which installed program this is: a file in its state directory remembers it.

use std::fs;
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

/// The file in the state directory.
const FILE: &str = "installation";

/// The name of this installation, made where there is none yet; none without a state directory, as a robot without a disk.
pub(crate) fn installation() -> Option<String> {
    let directory = directory()?;
    match remembered(&directory) {
        Ok(id) => Some(id),
        Err(error) => {
            tracing::warn!(
                directory = %directory.display(), %error,
                "cannot remember which installation this is: after a start the hub takes this for another device until it has noticed that the earlier one is gone"
            );
            None
        }
    }
}

/// Where a program keeps what it has to remember: as the broker does.
fn directory() -> Option<PathBuf> {
    let absolute = |name: &str| {
        let path = std::env::var_os(name).map(PathBuf::from);
        path.filter(|path| path.is_absolute())
    };
    let unit = std::env::var_os("STATE_DIRECTORY").map(|paths| {
        let first = paths.to_string_lossy();
        PathBuf::from(first.split(':').next().unwrap_or_default())
    });
    let unit = unit.filter(|path| path.is_absolute());
    let xdg = || absolute("XDG_STATE_HOME").map(|state| state.join("mom"));
    let home = || absolute("HOME").map(|home| home.join(".local/state/mom"));
    unit.or_else(xdg).or_else(home)
}

fn remembered(directory: &Path) -> io::Result<String> {
    let file = directory.join(FILE);
    if let Some(id) = read(&file)? {
        return Ok(id);
    }
    fs::create_dir_all(directory)?;
    let mut bits = [0; 16];
    getrandom::fill(&mut bits).map_err(|error| io::Error::other(error.to_string()))?;
    let id = format!("{:032x}", u128::from_le_bytes(bits));
    // Of two programs that are started at once both have the name of the one that was first.
    let mut own = tempfile::NamedTempFile::new_in(directory)?;
    own.write_all(id.as_bytes())?;
    own.as_file().sync_all()?;
    match own.persist_noclobber(&file) {
        Ok(_) => Ok(id),
        Err(error) if error.error.kind() == ErrorKind::AlreadyExists => {
            read(&file)?.ok_or_else(|| io::Error::new(ErrorKind::InvalidData, "the file is empty"))
        }
        Err(error) => Err(error.error),
    }
}

/// The name in the file; none if there is no file.
fn read(file: &Path) -> io::Result<Option<String>> {
    match fs::read_to_string(file) {
        Ok(text) if (1..=64).contains(&text.trim().len()) => Ok(Some(text.trim().to_owned())),
        Ok(_) => Err(io::Error::new(
            ErrorKind::InvalidData,
            format!(
                "{} does not hold a name of 64 bytes at most; remove it",
                file.display()
            ),
        )),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_installation_has_one_name() {
        let directory = tempfile::tempdir().expect("a directory");
        let place = directory.path().join("state");
        let first = remembered(&place).expect("it is made");
        assert_eq!(remembered(&place).expect("it is read"), first);
        assert_eq!(first.len(), 32);
        let other = remembered(&directory.path().join("other")).expect("it is made");
        assert_ne!(first, other);
        fs::write(place.join(FILE), "").expect("it is written");
        assert!(remembered(&place).is_err());
    }
}
