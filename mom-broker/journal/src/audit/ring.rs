//! The last facts in memory, where no file keeps them.

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;

use parking_lot::Mutex;

use super::sink::{LineSink, TracingSink};

/// The most lines, and the most bytes of them.
const MOST: usize = 4096;
const MOST_BYTES: usize = 4 * 1024 * 1024;

/// The last lines of an audit log.
#[derive(Debug, Default)]
pub(super) struct Ring(Mutex<RingLines>);

#[derive(Debug, Default)]
struct RingLines {
    lines: VecDeque<Arc<[u8]>>,
    bytes: usize,
}

impl Ring {
    fn push(&self, line: &[u8]) {
        let mut ring = self.0.lock();
        ring.bytes += line.len();
        ring.lines.push_back(line.into());
        while ring.lines.len() > MOST || ring.bytes > MOST_BYTES {
            let oldest = ring.lines.pop_front();
            ring.bytes -= oldest.map_or(ring.bytes, |oldest| oldest.len());
        }
    }

    /// The lines, the oldest first.
    pub(super) fn lines(&self) -> Vec<Arc<[u8]>> {
        self.0.lock().lines.iter().cloned().collect()
    }
}

/// Writes into the ordinary log, and remembers the last lines.
#[derive(Debug)]
pub(super) struct RingSink(pub(super) Arc<Ring>);

impl LineSink for RingSink {
    fn append(&mut self, lines: &[Vec<u8>]) -> (usize, io::Result<()>) {
        lines.iter().for_each(|line| self.0.push(line));
        TracingSink.append(lines)
    }

    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_lines_are_kept_within_both_bounds() {
        let ring = Ring::default();
        (0..MOST + 10).for_each(|number| ring.push(number.to_string().as_bytes()));
        let lines = ring.lines();
        assert_eq!((lines.len(), &*lines[0]), (MOST, &b"10"[..]));
        let long = vec![b'x'; MOST_BYTES / 2];
        (0..3).for_each(|_| ring.push(&long));
        assert_eq!(ring.lines().len(), 2);
    }
}
