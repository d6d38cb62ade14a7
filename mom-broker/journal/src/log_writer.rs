//! The way of log lines to standard error: a thread of its own writes them, so that logging never waits for their
//! reader.
//!
//! What waits is bounded. Lines beyond that, and those that could not be written, are dropped and counted, and a line
//! says how many as soon as one can be written again.

use std::io::{self, ErrorKind, Write};
use std::sync::{Arc, OnceLock};
use std::thread::{self, ThreadId};
use std::time::{Duration, Instant};

use parking_lot::{Condvar, Mutex};

/// Bytes that may wait; as many again may be under way.
const WAITING: usize = 256 * 1024;

/// How soon a standard error that blocks nobody is tried again; the system does not say when it takes more.
const AGAIN: Duration = Duration::from_millis(20);

/// Takes whole log lines, one with each write, and never waits.
#[derive(Clone, Debug)]
pub struct LogWriter {
    shared: Arc<LogShared>,
}

#[derive(Debug, Default)]
struct LogShared {
    state: Mutex<LogState>,
    /// Something waits, or nothing does any more.
    changed: Condvar,
    thread: OnceLock<ThreadId>,
}

#[derive(Debug, Default)]
struct LogState {
    waiting: Vec<u8>,
    /// Whether the thread has lines in hand.
    busy: bool,
    /// Lines that are lost and that no line reports yet.
    dropped: u64,
}

impl LogWriter {
    /// Starts the thread; it reports in the log how many lines were dropped.
    ///
    /// # Errors
    /// No thread.
    pub fn start(sink: impl Write + Send + 'static) -> io::Result<LogWriter> {
        LogWriter::start_with(sink, |_, dropped| {
            tracing::error!(
                dropped,
                "log lines were lost: they were not read in time, or could not be written"
            );
        })
    }

    fn start_with(
        sink: impl Write + Send + 'static,
        report: impl Fn(&LogWriter, u64) + Send + 'static,
    ) -> io::Result<LogWriter> {
        let writer = LogWriter {
            shared: Arc::default(),
        };
        let own = writer.clone();
        thread::Builder::new()
            .name("log".to_owned())
            .spawn(move || own.run(sink, report))?;
        Ok(writer)
    }

    /// Waits, for so long at most, until all that was logged is written.
    pub fn finish(&self, patience: Duration) {
        let until = Instant::now() + patience;
        let mut state = self.shared.state.lock();
        while state.busy || !state.waiting.is_empty() {
            if self.shared.changed.wait_until(&mut state, until).timed_out() {
                return;
            }
        }
    }

    fn run(&self, sink: impl Write, report: impl Fn(&LogWriter, u64)) {
        let _ = self.shared.thread.set(thread::current().id());
        let mut sink = WholeLines { sink, torn: false };
        loop {
            let lines = self.next();
            let written = sink.write(&lines);
            let dropped = {
                let mut state = self.shared.state.lock();
                state.dropped += count(&lines[written..]);
                // Not after a failure: the report would fail too.
                match written == lines.len() {
                    true => std::mem::take(&mut state.dropped),
                    false => 0,
                }
            };
            if dropped > 0 {
                report(self, dropped);
            }
        }
    }

    /// Waits for lines.
    fn next(&self) -> Vec<u8> {
        let mut state = self.shared.state.lock();
        while state.waiting.is_empty() {
            state.busy = false;
            self.shared.changed.notify_all();
            self.shared.changed.wait(&mut state);
        }
        state.busy = true;
        std::mem::take(&mut state.waiting)
    }
}

impl Write for LogWriter {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        // The thread's own report always finds place.
        let own = self.shared.thread.get() == Some(&thread::current().id());
        let mut state = self.shared.state.lock();
        if state.waiting.len() + line.len() > WAITING && !own {
            state.dropped += 1;
            return Ok(line.len());
        }
        if state.waiting.is_empty() {
            self.shared.changed.notify_all();
        }
        state.waiting.extend_from_slice(line);
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A sink in which a line always begins on a line of its own.
struct WholeLines<S> {
    sink: S,
    /// Whether the last line was written only in part.
    torn: bool,
}

impl<S: Write> WholeLines<S> {
    /// Gives how many bytes were written.
    fn write(&mut self, lines: &[u8]) -> usize {
        if self.torn {
            self.torn = self.write_all(b"\n") == 0;
        }
        let written = match self.torn {
            true => return 0,
            false => self.write_all(lines),
        };
        self.torn = written > 0 && written < lines.len() && lines[written - 1] != b'\n';
        written
    }

    fn write_all(&mut self, bytes: &[u8]) -> usize {
        let mut written = 0;
        while written < bytes.len() {
            match self.sink.write(&bytes[written..]) {
                Ok(0) => break,
                Ok(more) => written += more,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                // Another holder of it has made it so.
                Err(error) if error.kind() == ErrorKind::WouldBlock => thread::sleep(AGAIN),
                Err(_) => break,
            }
        }
        written
    }
}

fn count(lines: &[u8]) -> u64 {
    lines.iter().filter(|byte| **byte == b'\n').count() as u64
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Receiver, Sender, channel};

    use super::*;

    /// A reader that takes so many bytes for each that it is told to; with the last order it fails for good.
    struct Reader {
        orders: Receiver<usize>,
        read: Sender<Vec<u8>>,
    }

    impl Write for Reader {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let most = self.orders.recv().map_err(|_| ErrorKind::BrokenPipe)?;
            if most == 0 {
                return Err(ErrorKind::StorageFull.into());
            }
            let taken = bytes.len().min(most);
            let _ = self.read.send(bytes[..taken].to_vec());
            Ok(taken)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn start() -> (LogWriter, Sender<usize>, Receiver<Vec<u8>>) {
        let (order, orders) = channel();
        let (read, lines) = channel();
        let report = |writer: &LogWriter, dropped| {
            log(writer, &format!("{dropped} lost"));
        };
        let writer = LogWriter::start_with(Reader { orders, read }, report).expect("a thread");
        (writer, order, lines)
    }

    fn log(writer: &LogWriter, line: &str) {
        // At once, as tracing does: each write is a line.
        let line = format!("{line}\n");
        writer.clone().write_all(line.as_bytes()).expect("it takes all");
    }

    fn text(lines: &Receiver<Vec<u8>>) -> String {
        let bytes = lines
            .recv_timeout(Duration::from_secs(60))
            .expect("it is written");
        String::from_utf8(bytes).expect("text")
    }

    const ALL: usize = usize::MAX;

    #[test]
    fn who_logs_never_waits_for_who_reads() {
        const LINES: usize = 100_000;
        let (writer, order, lines) = start();
        for number in 0..LINES {
            log(&writer, &format!("line number {number}"));
        }
        writer.finish(Duration::from_millis(1));
        for _ in 0..10 {
            order.send(ALL).expect("it lives");
        }
        let (mut read, mut kept, mut lost) = (0, Vec::new(), 0);
        while kept.len() + lost < LINES {
            let text = text(&lines);
            read += text.len();
            for line in text.lines() {
                match line.strip_prefix("line number ") {
                    Some(number) => kept.push(number.parse::<usize>().expect("a whole line")),
                    None => lost += line.trim_end_matches(" lost").parse::<usize>().expect("a number"),
                }
            }
        }
        assert_eq!(kept.len() + lost, LINES, "each is written or counted");
        assert!(kept.is_sorted() && lost > 0);
        assert!(read <= 3 * WAITING, "{read}");
        writer.finish(Duration::from_secs(60));
        assert!(!writer.shared.state.lock().busy, "all is written");
    }

    #[test]
    fn what_was_not_written_is_counted_and_told_on_a_line_of_its_own() {
        let (writer, order, lines) = start();
        log(&writer, "first");
        for taken in [2, 0] {
            order.send(taken).expect("it lives");
        }
        assert_eq!(text(&lines), "fi");
        writer.finish(Duration::from_secs(60));
        log(&writer, "second");
        // The end of the broken line, which fails once more.
        order.send(0).expect("it lives");
        writer.finish(Duration::from_secs(60));
        log(&writer, "third");
        for _ in 0..3 {
            order.send(ALL).expect("it lives");
        }
        let read: Vec<String> = (0..3).map(|_| text(&lines)).collect();
        assert_eq!(read, ["\n", "third\n", "2 lost\n"]);
    }

    #[test]
    fn it_lives_where_nobody_reads_any_more() {
        let (writer, order, _lines) = start();
        drop(order);
        for _ in 0..100 {
            log(&writer, "no more");
            writer.finish(Duration::from_secs(60));
        }
        assert_eq!(writer.shared.state.lock().dropped, 100);
    }
}
