//! Whether the configuration has changed, by looking at its files twice a second.
//!
//! Looking costs two system calls and works for files that are written in place, replaced by rename (as editors and
//! `mom-broker passwd` do), behind symbolic links of whole folders (as deployments do), on network file systems and
//! in containers; news from the kernel covers the first two alone.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

const EVERY: Duration = Duration::from_millis(500);

/// What tells one state of a file from the next without reading it.
type Stamp = Option<(u64, Option<SystemTime>, (u64, u64), (i64, i64))>;

/// The configuration file, and the files that it names.
pub(super) struct FileWatch {
    /// The configuration file first.
    files: Vec<WatchedFile>,
    /// The files were different at the last look; they are read when they are at rest.
    moving: bool,
}

struct WatchedFile {
    path: PathBuf,
    stamp: Stamp,
    content: Option<Vec<u8>>,
}

impl FileWatch {
    /// Looks at the files as they are now.
    pub(super) fn new(config: PathBuf) -> FileWatch {
        let mut watch = FileWatch {
            files: vec![WatchedFile::look(config)],
            moving: false,
        };
        watch.look();
        watch
    }

    /// Returns when the files say something else than at the last look, and nobody has written for half a second.
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

    /// Takes the files as they are for known; says whether they say something else than at the last look.
    pub(super) fn look(&mut self) -> bool {
        let config = WatchedFile::look(self.files[0].path.clone());
        // A half-written file does not say which others there are.
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
        // The stamp before the content: what is written in between is seen the next time.
        let stamp = stamp(&path);
        let content = fs::read(&path).ok();
        WatchedFile { path, stamp, content }
    }

    /// The files that a configuration names; none for text that does not say.
    fn others(&self) -> Option<Vec<PathBuf>> {
        let text = std::str::from_utf8(self.content.as_ref()?).ok()?;
        let table: toml::Table = text.parse().ok()?;
        let key = table.get("login").and_then(|login| login.get("jwt")?.get("key"));
        let named = [table.get("users"), key].into_iter().flatten();
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
        // The time of the change itself: a copy may bring an old time of modification along.
        (known.ctime(), known.ctime_nsec()),
    ))
}
