//! The lines of a file from its end, and the place of a line by its number.

use std::fs::File;
use std::io::{self, ErrorKind, Read, Seek, SeekFrom};

use super::fact::LONGEST;

/// What is read at once.
const BLOCK: u64 = 64 * 1024;

/// More than this without a line end is not a line of an audit log.
const NO_LINE: usize = 16 * LONGEST;

/// Reads lines from the end of a file towards its beginning.
#[derive(Debug)]
pub(super) struct BackwardLines {
    file: File,
    /// Where `unread` begins in the file.
    start: u64,
    unread: Vec<u8>,
}

impl BackwardLines {
    /// Those lines of a file whose number is below `before`, which rises from line to line.
    ///
    /// # Errors
    /// What the system says.
    pub(super) fn open(mut file: File, before: u64) -> io::Result<BackwardLines> {
        let start = end_below(&mut file, before)?;
        Ok(BackwardLines {
            file,
            start,
            unread: Vec::new(),
        })
    }

    /// The next line without its end, and how many bytes were read for it; none at the file's beginning.
    ///
    /// # Errors
    /// What the system says.
    pub(super) fn next(&mut self) -> io::Result<(Option<Vec<u8>>, u64)> {
        let mut read = 0;
        loop {
            if self.unread.last() == Some(&b'\n') {
                self.unread.pop();
            }
            if let Some(end) = self.unread.iter().rposition(|byte| *byte == b'\n') {
                return Ok((Some(self.unread.split_off(end + 1)), read));
            }
            if self.start == 0 {
                let last = std::mem::take(&mut self.unread);
                return Ok(((!last.is_empty()).then_some(last), read));
            }
            if self.unread.len() > NO_LINE {
                self.unread.clear();
            }
            read += self.read_block()?;
        }
    }

    fn read_block(&mut self) -> io::Result<u64> {
        let from = self.start.saturating_sub(BLOCK);
        let mut block = read_at(&mut self.file, from, self.start - from)?;
        self.start = from;
        // Its last line goes on in what is not read yet.
        let goes_on = !self.unread.is_empty();
        let read = block.len() as u64;
        if goes_on || block.last() == Some(&b'\n') {
            block.append(&mut self.unread);
        }
        self.unread = block;
        Ok(read)
    }
}

/// Where the first line begins whose number is not below `before`.
fn end_below(file: &mut File, before: u64) -> io::Result<u64> {
    let (mut low, mut high) = (0, file.metadata()?.len());
    if before == u64::MAX {
        return Ok(high);
    }
    if seq_at(file, 0, high)?.is_some_and(|(_, seq)| seq >= before) {
        return Ok(0);
    }
    // What is left is read line by line, and those that are not wanted are left out.
    while high - low > 2 * LONGEST as u64 {
        let middle = low + (high - low) / 2;
        match seq_at(file, middle, high)? {
            Some((at, seq)) if seq >= before => high = at,
            Some((at, _)) => low = at,
            None => break,
        }
    }
    Ok(high)
}

/// The first line that begins at an offset or after it and before `end`, and its number.
fn seq_at(file: &mut File, offset: u64, end: u64) -> io::Result<Option<(u64, u64)>> {
    let bytes = read_at(file, offset, (3 * LONGEST as u64).min(end - offset))?;
    let mut at = 0;
    for line in bytes.split_inclusive(|byte| *byte == b'\n') {
        let whole = line.last() == Some(&b'\n');
        // What begins before the offset is not looked at; the file begins with a line.
        if let Some(seq) = seq_of(line).filter(|_| whole && (at > 0 || offset == 0)) {
            return Ok(Some((offset + at, seq)));
        }
        at += line.len() as u64;
    }
    Ok(None)
}

/// The number of a line; none for what is not a line.
pub(super) fn seq_of(line: &[u8]) -> Option<u64> {
    serde_json::from_slice::<serde_json::Value>(line).ok()?["seq"].as_u64()
}

/// So many bytes, or fewer at the end of the file.
fn read_at(file: &mut File, offset: u64, most: u64) -> io::Result<Vec<u8>> {
    file.seek(SeekFrom::Start(offset))?;
    let mut bytes = Vec::new();
    match file.take(most).read_to_end(&mut bytes) {
        Err(error) if error.kind() != ErrorKind::UnexpectedEof => Err(error),
        _ => Ok(bytes),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn file(text: &str) -> File {
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(text.as_bytes()).unwrap();
        file
    }

    fn lines(text: &str, before: u64) -> Vec<String> {
        let mut lines = BackwardLines::open(file(text), before).unwrap();
        let next = || {
            lines
                .next()
                .unwrap()
                .0
                .map(|line| String::from_utf8(line).unwrap())
        };
        std::iter::from_fn(next).collect()
    }

    #[test]
    fn lines_come_from_the_end() {
        assert!(lines("", u64::MAX).is_empty());
        assert_eq!(lines("a\nb\n", u64::MAX), ["b", "a"]);
        assert_eq!(lines("a\n\nbc", u64::MAX), ["bc", "", "a"]);
        let long = "x".repeat(3 * BLOCK as usize);
        assert_eq!(lines(&format!("a\n{long}\nc\n"), u64::MAX).first().unwrap(), "c");
        let many: Vec<String> = (0..50_000).map(|number| number.to_string()).collect();
        let read = lines(&(many.join("\n") + "\n"), u64::MAX);
        assert!(read.iter().eq(many.iter().rev()), "{}", read.len());
    }

    #[test]
    fn those_below_a_number_are_found_without_reading_all() {
        let many = |count: u64| -> String {
            let line = |seq| {
                format!(
                    "{{\"seq\":{seq},\"text\":\"{}\"}}\n",
                    "y".repeat(seq as usize % 300)
                )
            };
            (10..10 + count).map(line).collect()
        };
        for count in [1, 5, 5000] {
            let text = many(count);
            for before in [0, 10, 11, 12, 1234, 4999, 5009, 5010, 9000] {
                let read = lines(&text, before);
                let below: Vec<u64> = read.iter().filter_map(|line| seq_of(line.as_bytes())).collect();
                let wanted: Vec<u64> = (10..10 + count).filter(|seq| *seq < before).rev().collect();
                let found: Vec<u64> = below.iter().copied().filter(|seq| *seq < before).collect();
                assert_eq!(found, wanted, "{count} {before}");
                assert!(below.len() - found.len() < 3000, "{count} {before}");
            }
        }
    }
}
