//! The audit log's file: lines are appended, and a new file is begun when it is full.

use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom, Write};

use mom_system::{numbered, open_own};

use super::fact::LONGEST;
use super::sink::LineSink;
use crate::kept_files::KeptFiles;

/// A file of bounded size, and its predecessors.
#[derive(Debug)]
pub(super) struct RotatingFile {
    files: KeptFiles,
    file: File,
    length: u64,
    size: u64,
    unsynced: bool,
    /// Whether the disk had too little space when that was looked at.
    full: bool,
    /// Whether the file is larger than it should be, because there could be no new one.
    oversized: bool,
}

impl RotatingFile {
    /// Opens the file for appending; also gives the number of its last line, 0 for none.
    pub(super) fn open(files: KeptFiles, size: u64) -> io::Result<(RotatingFile, u64)> {
        let mut file = open_own(files.path())?;
        let known = file.metadata()?;
        let mut length = known.len();
        if known.is_file() {
            files.trim()?;
        }
        let tail = tail(&mut file, length)?;
        if tail.last().is_some_and(|byte| *byte != b'\n') {
            // A crash cut off the last line: new lines must not continue it.
            file.write_all(b"\n")?;
            length += 1;
        }
        let opened = RotatingFile {
            files,
            file,
            length,
            size,
            unsynced: false,
            full: false,
            oversized: false,
        };
        Ok((opened, last_seq(&tail)))
    }

    /// Begins a new file; the present one becomes the youngest of the old ones.
    fn rotate(&mut self) -> io::Result<()> {
        self.file.sync_data()?;
        // Before anything is moved: if there is no space for a new file, the old ones stay as they are.
        let path = self.files.path();
        let new = numbered(path, "new");
        match fs::remove_file(&new) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let file = open_own(&new)?;
        self.files.shift()?;
        fs::rename(&new, path)?;
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            // Makes the names durable, too, where folders can be synced at all.
            let _ = File::open(folder).and_then(|folder| folder.sync_all());
        }
        (self.file, self.length, self.oversized) = (file, 0, false);
        Ok(())
    }

    /// Looks whether the disk has space for more.
    fn look(&mut self) -> io::Result<()> {
        let space = match self.file.metadata()?.is_file() {
            true => self.files.leave_space(),
            // A device has no space of its own.
            false => Ok(()),
        };
        self.full = space.is_err();
        space
    }

    /// Writes whole lines; gives how many are in the file.
    fn write(&mut self, lines: &[Vec<u8>]) -> (usize, io::Result<()>) {
        let bytes = lines.concat();
        let mut written = 0;
        let result = loop {
            if written == bytes.len() {
                break Ok(());
            }
            match self.file.write(&bytes[written..]) {
                Ok(0) => break Err(io::ErrorKind::WriteZero.into()),
                Ok(more) => written += more,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => break Err(error),
            }
        };
        self.unsynced |= written > 0;
        self.length += written as u64;
        if result.is_ok() {
            return (lines.len(), result);
        }
        let (count, whole) = whole_lines(lines, written);
        if written > whole {
            self.cut((written - whole) as u64);
        }
        (count, result)
    }

    /// Removes a partly written line, so that the next begins on a line of its own.
    fn cut(&mut self, bytes: u64) {
        let end = self.length.saturating_sub(bytes);
        match self.file.set_len(end) {
            Ok(()) => self.length = end,
            // If this fails, the next line continues the broken one; nothing better can be done here.
            Err(error) => tracing::error!(%error, "the audit log has a broken line"),
        }
    }
}

/// How many lines fit in so many bytes, and how many bytes they have.
fn whole_lines(lines: &[Vec<u8>], bytes: usize) -> (usize, usize) {
    let mut whole = (0, 0);
    for line in lines {
        if whole.1 + line.len() > bytes {
            break;
        }
        whole = (whole.0 + 1, whole.1 + line.len());
    }
    whole
}

impl Drop for RotatingFile {
    fn drop(&mut self) {
        // Closing alone would not unlock it while a forked child, which has inherited the file, has not called `exec`
        // yet. If unlocking fails, the file is closed all the same.
        let _ = self.file.unlock();
    }
}

impl LineSink for RotatingFile {
    fn append(&mut self, lines: &[Vec<u8>]) -> (usize, io::Result<()>) {
        if self.full
            && let Err(error) = self.look()
        {
            return (0, Err(error));
        }
        let mut done = 0;
        while done < lines.len() {
            let room = usize::try_from(self.size.saturating_sub(self.length)).unwrap_or(usize::MAX);
            let (mut fit, _) = whole_lines(&lines[done..], room);
            if fit == 0 && self.length > 0 {
                match self.rotate() {
                    Ok(()) => continue,
                    // An oversized file is better than a lost line, up to what all files may have.
                    Err(error) if self.length >= self.files.most(self.size) => return (done, Err(error)),
                    Err(error) => {
                        if !std::mem::replace(&mut self.oversized, true) {
                            tracing::error!(%error, "the audit log could not be rotated and grows on");
                        }
                        fit = lines.len() - done;
                    }
                }
            }
            let (written, result) = self.write(&lines[done..done + fit.max(1)]);
            done += written;
            if result.is_err() {
                return (done, result);
            }
        }
        (done, Ok(()))
    }

    fn sync(&mut self) -> io::Result<()> {
        if std::mem::take(&mut self.unsynced) {
            // What it says is said by the next line that is not written.
            let _ = self.look();
            // A device such as a terminal cannot be synced, and has nothing to lose.
            return match self.file.sync_data() {
                Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
                result => result,
            };
        }
        Ok(())
    }
}

/// The end of the file, long enough for its last line.
fn tail(file: &mut File, length: u64) -> io::Result<Vec<u8>> {
    let mut tail = Vec::new();
    if length > 0 {
        file.seek(SeekFrom::Start(length.saturating_sub(2 * LONGEST as u64)))?;
        file.read_to_end(&mut tail)?;
    }
    Ok(tail)
}

fn last_seq(tail: &[u8]) -> u64 {
    let seq = |line: &[u8]| serde_json::from_slice::<serde_json::Value>(line).ok()?["seq"].as_u64();
    tail.rsplit(|byte| *byte == b'\n')
        .find_map(seq)
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use mom_system::DiskSpace;
    use std::path::Path;
    use tempfile::TempDir;

    fn open(path: &Path, size: u64, keep: u32) -> io::Result<(RotatingFile, u64)> {
        RotatingFile::open(KeptFiles::new(path, keep, 0), size)
    }

    fn lines(from: u64, to: u64) -> Vec<Vec<u8>> {
        (from..to)
            .map(|seq| format!("{{\"seq\":{seq}}}\n").into_bytes())
            .collect()
    }

    fn read(path: &Path) -> String {
        fs::read_to_string(path).unwrap()
    }

    #[test]
    fn old_files_are_kept_as_far_as_wished() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("audit.jsonl");
        // Three lines of ten bytes each fit.
        let (mut file, last) = open(&path, 35, 2).unwrap();
        assert_eq!(last, 0);
        let (written, result) = file.append(&lines(10, 20));
        assert!(result.is_ok() && written == 10);
        file.sync().unwrap();
        let text = |from, to| String::from_utf8(lines(from, to).concat()).unwrap();
        assert_eq!(read(&path), text(19, 20));
        assert_eq!(read(&numbered(&path, 1)), text(16, 19));
        assert_eq!(read(&numbered(&path, 2)), text(13, 16));
        let names = fs::read_dir(folder.path()).unwrap().count();
        assert_eq!(names, 3, "the oldest is gone, and nothing else lies about");
        #[cfg(unix)]
        for entry in fs::read_dir(folder.path()).unwrap() {
            let mode =
                std::os::unix::fs::PermissionsExt::mode(&entry.unwrap().metadata().unwrap().permissions());
            assert_eq!(mode & 0o777, 0o600);
        }
    }

    #[test]
    fn none_is_kept_if_none_is_wished() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("a");
        let (mut file, _) = open(&path, 25, 0).unwrap();
        assert_eq!(file.append(&lines(10, 13)).0, 3);
        assert_eq!(read(&path), "{\"seq\":12}\n");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn it_goes_on_after_a_crash() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("audit.jsonl");
        fs::write(&path, "{\"seq\":41}\n{\"seq\":42}\n{\"at\":\"2026").unwrap();
        let (mut file, last) = open(&path, 1000, 2).unwrap();
        assert_eq!(last, 42);
        assert_eq!(file.append(&lines(43, 44)).0, 1);
        assert!(read(&path).ends_with("{\"seq\":42}\n{\"at\":\"2026\n{\"seq\":43}\n"));
        let other = open(&path, 1000, 2).unwrap_err();
        assert!(other.to_string().contains("another broker"), "{other}");
    }

    #[test]
    fn a_line_longer_than_a_file_has_one_of_its_own() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("a");
        let (mut file, _) = open(&path, 4, 8).unwrap();
        assert_eq!(file.append(&lines(10, 13)).0, 3);
        assert_eq!(read(&numbered(&path, 2)), "{\"seq\":10}\n");
    }

    #[test]
    fn where_it_cannot_rotate_it_grows() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("a");
        // A folder in the way of the new file.
        fs::create_dir_all(numbered(&path, "new").join("x")).unwrap();
        fs::write(numbered(&path, 1), "old").unwrap();
        let (mut file, _) = open(&path, 25, 3).unwrap();
        for seq in 10..20 {
            assert_eq!(file.append(&lines(seq, seq + 1)).0, 1);
        }
        // To what four files may have.
        let (written, result) = file.append(&lines(20, 21));
        assert!(written == 0 && result.is_err());
        assert_eq!(read(&path).lines().count(), 10);
        assert_eq!(read(&numbered(&path, 1)), "old");
    }

    /// A disk of 100 bytes, which holds what is in the file's folder.
    fn small(path: &Path) -> io::Result<DiskSpace> {
        let mut used = 0;
        for entry in fs::read_dir(path.parent().unwrap())? {
            used += entry?.metadata()?.len();
        }
        let free = 100_u64.saturating_sub(used);
        Ok(DiskSpace { free, total: 100 })
    }

    #[test]
    fn a_disk_that_others_need_is_left_to_them() {
        let folder = TempDir::new().unwrap();
        let (path, other) = (folder.path().join("a"), folder.path().join("other"));
        let files = KeptFiles::new(&path, 8, 1000).on(small);
        let (mut file, _) = RotatingFile::open(files, 22).unwrap();
        for seq in 10..40 {
            assert_eq!(file.append(&lines(seq, seq + 1)).0, 1);
            file.sync().unwrap();
        }
        assert_eq!(read(&path), "{\"seq\":38}\n{\"seq\":39}\n");
        assert!(small(&path).unwrap().free >= 10 && numbered(&path, 3).exists());
        fs::write(&other, [b'x'; 85]).unwrap();
        assert_eq!(file.append(&lines(40, 41)).0, 1, "not looked at yet");
        file.sync().unwrap();
        assert!(!numbered(&path, 1).exists(), "the old ones are gone");
        let (written, result) = file.append(&lines(41, 42));
        assert_eq!(written, 0);
        assert_eq!(result.unwrap_err().kind(), io::ErrorKind::StorageFull);
        fs::remove_file(&other).unwrap();
        assert_eq!(file.append(&lines(42, 43)).0, 1);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_told() {
        let (mut file, _) = open(Path::new("/dev/full"), 1000, 2).unwrap();
        let (written, result) = file.append(&lines(1, 3));
        assert_eq!(written, 0);
        assert_eq!(result.unwrap_err().kind(), io::ErrorKind::StorageFull);
    }
}
