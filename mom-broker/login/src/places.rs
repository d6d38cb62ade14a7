//! Where users have logged in before by their passwords: wrong passwords from elsewhere do not hinder them there.
//!
//! They outlive the broker in a file, where there is a directory for it. Only a right password adds a line, so nobody but
//! the users themselves can fill it.

use std::collections::{HashMap, VecDeque};
use std::fs;
use std::io::{self, Write};
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use mom_system::Workers;
use parking_lot::Mutex;

/// The file in that directory.
const FILE: &str = "known-places";

/// Places of one user; after more, the first is forgotten.
const MOST: usize = 64;

/// The places of all users.
#[derive(Debug)]
pub(super) struct Places {
    shared: Arc<Shared>,
    /// Writes the file, because a disk may hang.
    writer: Workers,
}

#[derive(Debug, Default)]
struct Shared {
    of_user: Mutex<HashMap<String, VecDeque<IpAddr>>>,
    /// Whether the file lacks something.
    stale: AtomicBool,
    /// None without a directory; locked while it is written.
    file: Option<Mutex<PathBuf>>,
}

impl Places {
    /// None are known, and none will be after the end.
    pub(super) fn forgetful() -> Places {
        Places::new(Shared::default())
    }

    /// Those of a directory.
    ///
    /// # Errors
    /// A file that is there and cannot be read.
    pub(super) fn open(directory: &Path) -> io::Result<Places> {
        let file = directory.join(FILE);
        let text = match fs::read_to_string(&file) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
            read => read?,
        };
        let shared = Shared {
            file: Some(Mutex::new(file)),
            ..Shared::default()
        };
        let lines = text.lines().filter_map(|line| line.split_once(' '));
        for (user, place) in lines {
            // A line that says nothing costs its user no more than one login elsewhere does.
            if let Ok(place) = place.parse() {
                shared.add(user, place);
            }
        }
        Ok(Places::new(shared))
    }

    fn new(shared: Shared) -> Places {
        Places {
            shared: Arc::new(shared),
            writer: Workers::new(1),
        }
    }

    pub(super) fn knows(&self, user: &str, place: IpAddr) -> bool {
        let of_user = self.shared.of_user.lock();
        of_user.get(user).is_some_and(|places| places.contains(&place))
    }

    /// Notes that a user has logged in somewhere.
    pub(super) fn note(&self, user: &str, place: IpAddr) {
        if !self.shared.add(user, place) || self.shared.file.is_none() {
            return;
        }
        // One job writes all that is new by then.
        if !self.shared.stale.swap(true, Ordering::AcqRel) {
            let shared = Arc::clone(&self.shared);
            self.writer.run(move || {
                // It is tried again with the next place, and at the end.
                let _ = shared.write();
            });
        }
    }

    /// Writes what is not written yet. Blocks.
    ///
    /// # Errors
    /// What the system says.
    pub(super) fn write(&self) -> io::Result<()> {
        self.shared.write()
    }
}

impl Shared {
    /// Whether it is news.
    fn add(&self, user: &str, place: IpAddr) -> bool {
        let mut of_user = self.of_user.lock();
        if of_user.get(user).is_some_and(|places| places.contains(&place)) {
            return false;
        }
        let places = of_user.entry(user.to_owned()).or_default();
        if places.len() >= MOST {
            places.pop_front();
        }
        places.push_back(place);
        true
    }

    fn write(&self) -> io::Result<()> {
        let Some(file) = &self.file else {
            return Ok(());
        };
        let file = file.lock();
        if !self.stale.swap(false, Ordering::AcqRel) {
            return Ok(());
        }
        let mut text = String::new();
        for (user, places) in &*self.of_user.lock() {
            places
                .iter()
                .for_each(|place| text += &format!("{user} {place}\n"));
        }
        replace(&file, &text).inspect_err(|_| self.stale.store(true, Ordering::Release))
    }
}

/// Gives a file another text, whole or not at all.
fn replace(path: &Path, text: &str) -> io::Result<()> {
    let new = path.with_extension("new");
    let mut options = fs::OpenOptions::new();
    options.write(true).create(true).truncate(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut file = options.open(&new)?;
    file.write_all(text.as_bytes())?;
    file.sync_data()?;
    fs::rename(&new, path)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(number: u8) -> IpAddr {
        IpAddr::from([127, 0, 0, number])
    }

    #[test]
    fn places_outlive_the_broker() {
        let folder = tempfile::tempdir().expect("a folder");
        let places = Places::open(folder.path()).expect("none yet");
        places.note("alice", place(1));
        places.note("alice", "2001:db8::".parse().expect("an address"));
        places.note("bob", place(2));
        places.write().expect("written");
        let file = folder.path().join(FILE);
        let text = fs::read_to_string(&file).expect("a file");
        fs::write(&file, format!("{text}nonsense\nalice nowhere\n")).expect("written");
        let again = Places::open(folder.path()).expect("readable");
        assert!(again.knows("alice", place(1)) && again.knows("bob", place(2)));
        assert!(again.knows("alice", "2001:db8::".parse().expect("an address")));
        assert!(!again.knows("alice", place(2)) && !again.knows("carol", place(1)));
    }

    #[test]
    fn one_user_has_so_many_places() {
        let places = Places::forgetful();
        places.note("bob", place(1));
        for number in 0..=MOST {
            places.note("alice", place(u8::try_from(number).expect("small")));
        }
        assert!(!places.knows("alice", place(0)) && places.knows("alice", place(1)));
        assert!(places.knows("bob", place(1)));
        places.write().expect("nothing to write");
    }

    #[test]
    fn what_cannot_be_written_is_tried_again() {
        let folder = tempfile::tempdir().expect("a folder");
        let inner = folder.path().join("state");
        let places = Places::open(&inner).expect("none yet");
        places.note("alice", place(1));
        assert!(places.write().is_err(), "there is no such directory");
        assert!(places.knows("alice", place(1)), "it is known nevertheless");
        fs::create_dir(&inner).expect("a folder");
        places.write().expect("now there is");
        assert!(Places::open(&inner).expect("readable").knows("alice", place(1)));
    }
}
