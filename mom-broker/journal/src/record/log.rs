//! Reads a recording line by line.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use super::line::{RecordedLine, RecordingHead, VERSION};

/// The longest line: a parcel's content in base64, and the rest of the line.
const LONGEST: u64 = 64 * 1024 * 1024;

/// A recording that cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// It cannot be read at all.
    #[error("{file} cannot be read: {error}")]
    Read {
        /// The recording.
        file: String,
        /// What the system says.
        error: std::io::Error,
    },
    /// A line in it is damaged.
    #[error("{file}:{line}: {text}")]
    Line {
        /// The recording.
        file: String,
        /// The line, from 1.
        line: u64,
        /// What is wrong with it.
        text: String,
    },
    /// The configuration for the replay is wrong.
    #[error("{0}")]
    Config(String),
}

/// A recording that is being read.
#[derive(Debug)]
pub(super) struct RecordingReader {
    name: String,
    reader: BufReader<File>,
    next: Option<Vec<u8>>,
    line: u64,
    read: u64,
    length: u64,
    torn: bool,
}

impl RecordingReader {
    /// Opens a recording and reads its head.
    pub(super) fn open(path: &Path) -> Result<(RecordingReader, RecordingHead), RecordError> {
        let name = path.display().to_string();
        let failed = |error| RecordError::Read {
            file: name.clone(),
            error,
        };
        let file = File::open(path).map_err(failed)?;
        let length = file.metadata().map_err(failed)?.len();
        let mut log = RecordingReader {
            name,
            reader: BufReader::new(file),
            next: None,
            line: 0,
            read: 0,
            length,
            torn: false,
        };
        log.next = log.read_line()?;
        match log.next()? {
            Some(RecordedLine::Head(head)) if head.form == VERSION => Ok((log, *head)),
            Some(RecordedLine::Head(head)) => Err(log.error(format!(
                "a recording of form {}; this program reads form {VERSION}",
                head.form
            ))),
            _ => Err(log.error("this is not a recording: its head is missing".to_owned())),
        }
    }

    /// The next line. A truncated last line is skipped, see [`RecordingReader::is_torn`].
    pub(super) fn next(&mut self) -> Result<Option<RecordedLine>, RecordError> {
        let Some(bytes) = self.next.take() else {
            return Ok(None);
        };
        self.line += 1;
        self.next = self.read_line()?;
        match serde_json::from_slice(&bytes) {
            Ok(line) => Ok(Some(line)),
            // A line that was cut off by a power failure does not invalidate the lines before it.
            Err(_) if self.next.is_none() && self.line > 1 => {
                self.torn = true;
                Ok(None)
            }
            Err(error) if self.line == 1 => Err(self.error(format!("this is not a recording: {error}"))),
            Err(error) => Err(self.error(format!("this line is damaged: {error}"))),
        }
    }

    fn read_line(&mut self) -> Result<Option<Vec<u8>>, RecordError> {
        let mut bytes = Vec::new();
        let read = (&mut self.reader).take(LONGEST).read_until(b'\n', &mut bytes);
        let read = read.map_err(|error| RecordError::Read {
            file: self.name.clone(),
            error,
        })?;
        self.read += read as u64;
        if read as u64 == LONGEST {
            self.line += 1;
            return Err(self.error(format!("a line of more than {LONGEST} bytes")));
        }
        Ok((read > 0).then_some(bytes))
    }

    /// An error about the line that was read last.
    pub(super) fn error(&self, text: String) -> RecordError {
        RecordError::Line {
            file: self.name.clone(),
            line: self.line.max(1),
            text,
        }
    }

    /// The line that was read last, from 1.
    pub(super) fn line(&self) -> u64 {
        self.line
    }

    /// Whether its last line is damaged.
    pub(super) fn is_torn(&self) -> bool {
        self.torn
    }

    /// Bytes read, and bytes in all.
    pub(super) fn progress(&self) -> (u64, u64) {
        (self.read, self.length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use tempfile::TempDir;

    const HEAD: &str = r#"{"head":{"form":2,"version":"0.1.0","anchor":"2026-11-21T10:00:00Z","epoch":1,"durable":false,"limits":{}}}"#;
    const TICK: &str = r#"{"step":{"now":1,"input":"tick","decided":[]}}"#;

    fn read(text: &str) -> (Result<usize, String>, bool) {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("control.jsonl");
        fs::write(&path, text).unwrap();
        let (mut log, _) = match RecordingReader::open(&path) {
            Ok(opened) => opened,
            Err(error) => return (Err(error.to_string()), false),
        };
        let mut count = 0;
        loop {
            match log.next() {
                Ok(Some(_)) => count += 1,
                Ok(None) => return (Ok(count), log.is_torn()),
                Err(error) => return (Err(error.to_string()), log.is_torn()),
            }
        }
    }

    #[test]
    fn a_torn_end_is_forgiven_a_damaged_middle_is_not() {
        assert_eq!(read(&format!("{HEAD}\n{TICK}\n{TICK}\n")), (Ok(2), false));
        assert_eq!(read(&format!("{HEAD}\n{TICK}\n{TICK}")), (Ok(2), false));
        assert_eq!(read(&format!("{HEAD}\n{TICK}\n{}", &TICK[..20])), (Ok(1), true));
        assert_eq!(read(&format!("{HEAD}\n{TICK}\n\0\0\0\0\n")), (Ok(1), true));
        let (damaged, _) = read(&format!("{HEAD}\n{TICK}\n{}\n{TICK}\n", &TICK[..20]));
        let words = damaged.unwrap_err();
        assert!(words.contains("control.jsonl:3: this line is damaged"), "{words}");
    }

    #[test]
    fn another_file_is_no_recording() {
        for (text, words) in [
            (String::new(), "head is missing"),
            ("[listen]\n".to_owned(), ":1: this is not a recording"),
            (format!("{TICK}\n"), ":1: this is not a recording: its head"),
            (HEAD.replace("\"form\":2", "\"form\":9"), "form 9"),
            (
                HEAD.replace("\"form\":2", "\"form\":1"),
                "form 1; this program reads form 2",
            ),
        ] {
            let (read, _) = read(&text);
            let said = read.unwrap_err();
            assert!(said.contains(words), "{said}");
        }
    }
}
