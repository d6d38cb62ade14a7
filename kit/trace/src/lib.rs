//! Where a simulated body is, every 10 ms, in a file: for tests that watch bodies, and not what devices say of them.
//!
//! Between two calls of its program a simulated body is a function of time. So the program calls [`Trace::until`] before each call that
//! may change what the body does, and that writes each place where the body has been since the last one. Nothing is missed while the
//! program stands still (SIGSTOP): what the body did meanwhile is written when the program goes on, with the times at
//! which the body did it.
//!
//! The file has a line `begin` for each body, and then a line for each place: µs of `CLOCK_MONOTONIC`, and the numbers of the place.
//!
//! ```text
//! begin
//! 8342170000 2500.000 2500.000 0.000
//! 8342180000 2500.312 2500.000 0.000
//! ```

use std::fmt::Write as _;
use std::fs::{File, OpenOptions};
use std::io::{self, Write as _};
use std::path::Path;

use rustix::time::{ClockId, clock_gettime};

/// µs between two places.
pub const PERIOD: i64 = 10_000;

/// µs before the latest call of which places are written at most: of a program that stood still for longer, the last minute.
const MOST: i64 = 60_000_000;

/// The file of one body. Its time is that of the body's program, in µs, which never goes back.
#[derive(Debug)]
pub struct Trace {
    /// None once it cannot be written any more.
    file: Option<File>,
    /// By how much the system's clock is ahead of the program's time: the least that was seen, as a call comes after
    /// the time that it names.
    ahead: i64,
    /// The time of the next place; none before the first call.
    next: Option<i64>,
}

impl Trace {
    /// Appends a new body to this file, which is made if it is not there.
    ///
    /// # Errors
    ///
    /// A file that cannot be written.
    pub fn open(file: &Path) -> io::Result<Self> {
        let mut file = OpenOptions::new().append(true).create(true).open(file)?;
        file.write_all(b"begin\n")?;
        Ok(Self {
            file: Some(file),
            ahead: i64::MAX,
            next: None,
        })
    }

    /// Writes where the body was, by `place`, from the latest call until `now`. `place` is asked for times in their order, none of them
    /// later than `now`. A program's time begins at 0, and what it calls before that begins is not written.
    pub fn until<const N: usize>(&mut self, now: i64, mut place: impl FnMut(i64) -> [f64; N]) {
        if now <= 0 {
            return;
        }
        self.ahead = self.ahead.min(monotonic().saturating_sub(now));
        let first = *self.next.get_or_insert(now);
        let mut at = first.max(now.saturating_sub(MOST));
        let mut lines = String::new();
        while at <= now {
            // Writing to a string does not fail.
            let _ = write!(lines, "{}", at.saturating_add(self.ahead));
            for number in place(at) {
                let _ = write!(lines, " {number:.3}");
            }
            lines.push('\n');
            at = at.saturating_add(PERIOD);
        }
        self.next = Some(at);
        if let Some(file) = &mut self.file
            && let Err(error) = file.write_all(lines.as_bytes())
        {
            tracing::error!(%error, "the trace could not be written any further");
            self.file = None;
        }
    }
}

/// µs of the system's clock that is never set.
fn monotonic() -> i64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec
        .saturating_mul(1_000_000)
        .saturating_add(now.tv_nsec / 1000)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(file: &Path) -> Vec<Vec<f64>> {
        let text = std::fs::read_to_string(file).unwrap();
        let numbers = |line: &str| line.split(' ').filter_map(|word| word.parse().ok()).collect();
        text.lines().map(numbers).collect()
    }

    #[test]
    fn each_place_since_the_last_call_is_written_with_its_time() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("trace");
        let mut trace = Trace::open(&file).unwrap();
        let before = monotonic();
        trace.until(0, |at| [at as f64]);
        trace.until(5_000, |at| [at as f64]);
        trace.until(4_000, |at| [at as f64]);
        trace.until(36_000, |at| [at as f64, 1.0]);
        let lines = lines(&file);
        assert_eq!(lines.len(), 5, "{lines:?}");
        assert!(lines[0].is_empty());
        let places: Vec<f64> = lines[1..].iter().map(|line| line[1]).collect();
        assert_eq!(places, [5_000.0, 15_000.0, 25_000.0, 35_000.0]);
        assert!(lines[1][0] >= before as f64, "{lines:?}");
        // The second call has named a time that is nearer to the clock's: none is later than the call that wrote it.
        assert!(lines[4][0] <= monotonic() as f64, "{lines:?}");
    }

    #[test]
    fn of_a_long_pause_the_last_minute_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("trace");
        let mut trace = Trace::open(&file).unwrap();
        trace.until(1, |_| [0.0]);
        trace.until(3_600_000_001, |_| [0.0]);
        assert_eq!(lines(&file).len(), 1 + 1 + 6_001);
        Trace::open(&file).unwrap();
        assert_eq!(lines(&file).len(), 1 + 1 + 6_001 + 1, "a body behind the other");
    }
}
