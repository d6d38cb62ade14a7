//! Detects changes of the configuration by polling its files twice a second.
//!
//! Polling costs two system calls and works for files that are written in place, replaced by rename (as editors and
//! `mom-broker passwd` do), behind symbolic links of whole folders (as deployments do), on network file systems and
//! in containers; kernel notifications cover only the first two.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

const EVERY: Duration = Duration::from_millis(500);

/// Distinguishes states of a file without reading it.
type Stamp = Option<(u64, Option<SystemTime>, (u64, u64), (i64, i64))>;

/// The configuration file, and the files that it names.
pub(super) struct FileWatch {
    /// The configuration file first.
    files: Vec<WatchedFile>,
    /// The files had changed at the last poll; they are read once they stay unchanged.
    moving: bool,
}

struct WatchedFile {
    path: PathBuf,
    stamp: Stamp,
    content: Option<Vec<u8>>,
}

impl FileWatch {
    /// Notes the present state of the files.
    pub(super) fn new(config: PathBuf) -> FileWatch {
        let mut watch = FileWatch {
            files: vec![WatchedFile::look(config)],
            moving: false,
        };
        watch.look();
        watch
    }

    /// Returns when the content has changed since the last poll, and nobody has written for half a second.
    ///
    /// Nothing is lost if this is dropped and called again.
    pub(super) async fn changed(&mut self) {
        loop {
            tokio::time::sleep(EVERY).await;
            if self.tick() {
                return;
            }
        }
    }

    fn tick(&mut self) -> bool {
        let mut moved = false;
        for file in &mut self.files {
            let stamp = stamp(&file.path);
            moved |= stamp != file.stamp;
            file.stamp = stamp;
        }
        if moved {
            self.moving = true;
            return false;
        }
        std::mem::take(&mut self.moving) && self.look()
    }

    /// Marks the present state as known; gives whether the content has changed since the last poll.
    pub(super) fn look(&mut self) -> bool {
        let config = WatchedFile::look(self.files[0].path.clone());
        // A half-written file may not name the other files.
        let others = config.others();
        let known = || self.files.iter().skip(1).map(|file| file.path.clone()).collect();
        let others: Vec<PathBuf> = others.unwrap_or_else(known);
        let files: Vec<WatchedFile> = std::iter::once(config)
            .chain(others.into_iter().map(WatchedFile::look))
            .collect();
        let said = |file: &WatchedFile| (file.path.clone(), file.content.clone());
        let changed = !files.iter().map(said).eq(self.files.iter().map(said));
        self.files = files;
        self.moving = false;
        changed
    }
}

impl WatchedFile {
    fn look(path: PathBuf) -> WatchedFile {
        // The stamp is taken before the content: a write in between is seen at the next poll.
        let stamp = stamp(&path);
        let content = fs::read(&path).ok();
        WatchedFile { path, stamp, content }
    }

    /// The files that a configuration names; none if its text cannot be parsed.
    fn others(&self) -> Option<Vec<PathBuf>> {
        let text = std::str::from_utf8(self.content.as_ref()?).ok()?;
        let table: toml::Table = text.parse().ok()?;
        let key = table.get("login").and_then(|login| login.get("jwt")?.get("key"));
        let tls = |key: &str| table.get("tls").and_then(|tls| tls.get(key));
        let named = [table.get("users"), key, tls("certificate"), tls("key")];
        let named = named.into_iter().flatten();
        let folder = self.path.parent().unwrap_or(Path::new("."));
        Some(
            named
                .filter_map(|name| Some(folder.join(name.as_str()?)))
                .collect(),
        )
    }
}

fn stamp(file: &Path) -> Stamp {
    use std::os::unix::fs::MetadataExt;

    let known = fs::metadata(file).ok()?;
    Some((
        known.len(),
        known.modified().ok(),
        (known.dev(), known.ino()),
        // The time of the inode change: a copy may keep an old modification time.
        (known.ctime(), known.ctime_nsec()),
    ))
}
