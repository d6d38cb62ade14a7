//! The thread that writes: it may wait for a disk, the hub may not.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use mom_system::Clock;
use parking_lot::Mutex;
use tokio::sync::oneshot;

use super::Fact;
use super::refusals::Refusals;
use super::sink::LineSink;
use super::successes::Successes;

/// How often lines are made durable, and folded facts and refusals are written.
const TICK: Duration = Duration::from_secs(1);

/// Facts written in one batch.
const BATCH: usize = 256;

/// Messages to the writer.
#[derive(Debug)]
pub(super) enum AuditNote {
    /// A fact to write.
    Fact(Box<Fact>),
    /// Answered when everything before it is written.
    Written(oneshot::Sender<()>),
    /// Answered when everything before it is written and durable.
    Flush(oneshot::Sender<()>),
}

/// State shared by the writer and the senders of facts.
#[derive(Debug, Default)]
pub(super) struct AuditShared {
    pub(super) refusals: Mutex<Refusals>,
    pub(super) successes: Mutex<Successes>,
    /// Facts that the full queue did not take and that no line reports yet.
    pub(super) lost: AtomicU64,
}

/// Writes lines into a sink.
pub(super) struct AuditWriter<S> {
    sink: S,
    clock: Clock,
    shared: Arc<AuditShared>,
    seq: u64,
    lines: Vec<LogLine>,
    written: Vec<oneshot::Sender<()>>,
    flushes: Vec<oneshot::Sender<()>>,
    /// What went wrong since it was last logged.
    failure: Option<std::io::Error>,
}

struct LogLine {
    bytes: Vec<u8>,
    /// The facts that are lost with this line.
    facts: u64,
}

impl<S: LineSink> AuditWriter<S> {
    /// A writer whose first line has the number after `seq`.
    pub(super) fn new(sink: S, clock: Clock, shared: Arc<AuditShared>, seq: u64) -> AuditWriter<S> {
        AuditWriter {
            sink,
            clock,
            shared,
            seq,
            lines: Vec::new(),
            written: Vec::new(),
            flushes: Vec::new(),
            failure: None,
        }
    }

    /// Writes until all senders are gone.
    pub(super) fn run(mut self, notes: &Receiver<AuditNote>) {
        let mut next = Instant::now() + TICK;
        loop {
            match notes.recv_timeout(next.saturating_duration_since(Instant::now())) {
                Ok(note) => {
                    self.take(note);
                    notes.try_iter().take(BATCH - 1).for_each(|note| self.take(note));
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    self.unfold(notes);
                    self.tick();
                    return;
                }
            }
            self.write();
            for done in self.written.drain(..) {
                // The receiver may have stopped waiting.
                let _ = done.send(());
            }
            if Instant::now() >= next || !self.flushes.is_empty() {
                self.unfold(notes);
                self.tick();
                next = Instant::now() + TICK;
            }
        }
    }

    fn take(&mut self, note: AuditNote) {
        match note {
            AuditNote::Fact(fact) => self.push(&fact, 1),
            AuditNote::Written(done) => self.written.push(done),
            AuditNote::Flush(done) => self.flushes.push(done),
        }
    }

    /// Writes folded facts, after all facts sent before them.
    fn unfold(&mut self, notes: &Receiver<AuditNote>) {
        let shared = Arc::clone(&self.shared);
        let mut successes = shared.successes.lock();
        notes.try_iter().for_each(|note| self.take(note));
        successes
            .drain()
            .iter()
            .for_each(|fact| self.push(fact, fact.count.unwrap_or(1)));
    }

    fn push(&mut self, fact: &Fact, facts: u64) {
        self.seq += 1;
        let bytes = fact.line(self.seq);
        self.lines.push(LogLine { bytes, facts });
    }

    /// What is due each second.
    fn tick(&mut self) {
        let counted = self.shared.refusals.lock().drain();
        counted.iter().for_each(|fact| self.push(fact, 1));
        self.write();
        if let Err(error) = self.sink.sync() {
            self.failure = Some(error);
        }
        if let Some(error) = self.failure.take() {
            let lost = self.shared.lost.load(Ordering::Relaxed);
            tracing::error!(%error, lost, "the audit log cannot be written");
        }
        for done in self.flushes.drain(..) {
            // The receiver may have stopped waiting.
            let _ = done.send(());
        }
    }

    fn write(&mut self) {
        // They did not fit because of the facts that are written now.
        let lost = self.shared.lost.swap(0, Ordering::Relaxed);
        if lost > 0 {
            let mut fact = Fact::of(self.clock.civil(), "audit-lost");
            fact.count = Some(lost);
            self.push(&fact, lost);
        }
        if self.lines.is_empty() {
            return;
        }
        let lines = std::mem::take(&mut self.lines);
        let (bytes, facts): (Vec<Vec<u8>>, Vec<u64>) =
            lines.into_iter().map(|line| (line.bytes, line.facts)).unzip();
        let (written, result) = self.sink.append(&bytes);
        let unwritten: u64 = facts[written..].iter().sum();
        self.shared.lost.fetch_add(unwritten, Ordering::Relaxed);
        match result {
            Err(error) => self.failure = Some(error),
            Ok(()) if lost > 0 => tracing::error!(lost, "the audit log has lost entries"),
            Ok(()) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io;
    use std::sync::mpsc;

    use super::*;
    use mom_hub::Audit;
    use mom_proto::Time;
    use serde_json::Value as Json;

    /// A disk with space for so many more lines.
    #[derive(Debug, Default)]
    struct Disk {
        room: usize,
        lines: Vec<Json>,
        syncs: u32,
    }

    impl LineSink for &mut Disk {
        fn append(&mut self, lines: &[Vec<u8>]) -> (usize, io::Result<()>) {
            let written = lines.len().min(self.room);
            self.room -= written;
            let read = lines[..written]
                .iter()
                .map(|line| serde_json::from_slice(line).unwrap());
            self.lines.extend(read);
            match written < lines.len() {
                true => (written, Err(io::ErrorKind::StorageFull.into())),
                false => (written, Ok(())),
            }
        }

        fn sync(&mut self) -> io::Result<()> {
            self.syncs += 1;
            Ok(())
        }
    }

    fn writer<'a>(disk: &'a mut Disk, shared: &Arc<AuditShared>) -> AuditWriter<&'a mut Disk> {
        AuditWriter::new(disk, Clock::manual(Time::default()), Arc::clone(shared), 10)
    }

    fn fact(what: &'static str) -> AuditNote {
        AuditNote::Fact(Box::new(Fact::new(Time::default(), Audit::new(what))))
    }

    fn told(disk: &Disk) -> Vec<String> {
        let told = |line: &Json| {
            let count = line
                .get("count")
                .map(|count| format!(" {count}"))
                .unwrap_or_default();
            format!("{} {}{count}", line["seq"], line["what"].as_str().unwrap())
        };
        disk.lines.iter().map(told).collect()
    }

    #[test]
    fn what_a_full_disk_did_not_take_is_counted() {
        let shared = Arc::new(AuditShared::default());
        let mut disk = Disk {
            room: 2,
            ..Disk::default()
        };
        let mut writer = writer(&mut disk, &shared);
        for _ in 0..4 {
            writer.take(fact("granted"));
        }
        writer.write();
        writer.take(fact("lost"));
        writer.tick();
        assert_eq!(shared.lost.load(Ordering::Relaxed), 3);
        writer.sink.room = 10;
        writer.take(fact("login"));
        writer.tick();
        writer.tick();
        assert_eq!(shared.lost.load(Ordering::Relaxed), 0);
        // The numbers show the gap, too: 13 and 14, and the failed attempts.
        let told = told(&disk);
        assert_eq!(told[..2], ["11 granted", "12 granted"]);
        assert_eq!(told[2..], ["17 login", "18 audit-lost 3"]);
    }

    #[test]
    fn what_found_no_place_is_told_next() {
        let shared = Arc::new(AuditShared::default());
        let mut disk = Disk {
            room: 10,
            ..Disk::default()
        };
        let mut writer = writer(&mut disk, &shared);
        shared.lost.store(7, Ordering::Relaxed);
        writer.take(fact("granted"));
        writer.write();
        assert_eq!(told(&disk), ["11 granted", "12 audit-lost 7"]);
    }

    #[test]
    fn the_end_writes_all_and_counts_up() {
        let shared = Arc::new(AuditShared::default());
        let mut disk = Disk {
            room: 1000,
            ..Disk::default()
        };
        let refused = |_| {
            shared
                .refusals
                .lock()
                .take(Fact::new(Time::default(), Audit::new("refused")))
        };
        let first = (0..5).filter_map(refused).count();
        assert_eq!(first, 1, "the others are counted");
        let (sender, notes) = mpsc::sync_channel(600);
        for _ in 0..600 {
            sender.try_send(fact("granted")).unwrap();
        }
        drop(sender);
        writer(&mut disk, &shared).run(&notes);
        let told = told(&disk);
        assert_eq!(told.len(), 601);
        assert_eq!(told[600], "611 refused 4");
        assert!(disk.syncs > 0);
    }
}
