//! Who was given what, refused what, lost what, by which rule: one line of JSON each, for whoever asks later.
//!
//! A fact goes into a bounded queue that a thread of its own empties into a file or the log, so that nobody who
//! decides ever waits for a disk. What the queue or the disk does not take is counted, and the log says so.

mod fact;
mod file;
mod refusals;
mod settings;
mod sink;
mod successes;
mod writer;

use std::io;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::time::Duration;

use dashmap::DashMap;
use mom_hub::{Effect, PeerId};
use mom_proto::{Time, Verb};
use tokio::sync::oneshot;

pub use fact::Fact;
pub use settings::AuditConfig;

use file::RotatingFile;
use mom_system::Clock;
use sink::{LineSink, TracingSink};
use writer::{AuditNote, AuditShared, AuditWriter};

/// Facts that wait for the writer.
const QUEUE: usize = 16 * 1024;

/// What was told may take so long to be durable before a stopping broker gives up.
const PATIENCE: Duration = Duration::from_secs(5);

/// What is known of a connection that facts about it do not say themselves.
#[derive(Debug, Default)]
struct AuditedPeer {
    from: Option<IpAddr>,
    user: Option<Arc<str>>,
}

/// The audit log of a broker.
#[derive(Debug)]
pub struct AuditLog {
    queue: SyncSender<AuditNote>,
    shared: Arc<AuditShared>,
    connections: DashMap<PeerId, AuditedPeer>,
    dead: AtomicBool,
}

impl AuditLog {
    /// Opens the log and starts its writer, which ends with the last of those who can tell it something.
    ///
    /// # Errors
    /// What the system says about the file, or that another broker writes it.
    pub fn start(config: &AuditConfig, clock: Clock) -> io::Result<AuditLog> {
        match &config.path {
            Some(path) => {
                let (file, seq) = RotatingFile::open(path, config.size, config.keep)?;
                AuditLog::write_to(file, clock, seq)
            }
            None => AuditLog::write_to(TracingSink, clock, 0),
        }
    }

    fn write_to(sink: impl LineSink + 'static, clock: Clock, seq: u64) -> io::Result<AuditLog> {
        let shared = Arc::new(AuditShared::default());
        let (queue, notes) = sync_channel(QUEUE);
        let writer = AuditWriter::new(sink, clock, Arc::clone(&shared), seq);
        std::thread::Builder::new()
            .name("audit".to_owned())
            .spawn(move || writer.run(&notes))?;
        Ok(AuditLog {
            queue,
            shared,
            connections: DashMap::new(),
            dead: AtomicBool::new(false),
        })
    }

    /// Writes a fact down, or folds it with others alike; never waits for the disk.
    pub fn note(&self, fact: Fact) {
        // Held until all is in the queue: the writer takes what was folded under it, and must not come in between.
        let mut successes = self.shared.successes.lock();
        successes.take(fact).into_iter().for_each(|fact| self.queue(fact));
    }

    fn queue(&self, fact: Fact) {
        let count = fact.count.unwrap_or(1);
        match self.queue.try_send(AuditNote::Fact(Box::new(fact))) {
            Ok(()) => {}
            // The writer tells how many, as soon as it can.
            Err(TrySendError::Full(_)) => drop(self.shared.lost.fetch_add(count, Ordering::Relaxed)),
            Err(TrySendError::Disconnected(_)) => {
                if !self.dead.swap(true, Ordering::Relaxed) {
                    tracing::error!("the audit log's writer has ended: nothing is audited any more");
                }
            }
        }
    }

    /// Writes a refusal down: the first of its kind at once, more of them once a second with their count.
    pub fn refused(&self, fact: Fact) {
        let first = self.shared.refusals.lock().take(fact);
        if let Some(fact) = first {
            self.queue(fact);
        }
    }

    /// Takes the facts out of what the hub decided on an input of this peer; `complete` may add to them.
    pub fn take(&self, at: Time, peer: Option<PeerId>, effects: &mut [Effect], complete: impl Fn(&mut Fact)) {
        for effect in effects {
            if let Effect::Audit(audit) = effect {
                let mut fact = Fact::new(at, std::mem::take(&mut **audit));
                complete(&mut fact);
                let login = fact.audit.what == "login" || fact.audit.verb == Some(Verb::Login);
                match peer {
                    Some(peer) if login => self.login(peer, fact),
                    _ if fact.audit.what == "refused" => self.refused(fact),
                    _ => self.note(fact),
                }
            }
        }
    }

    /// Writes down what became of a login on this connection.
    pub fn login(&self, peer: PeerId, mut fact: Fact) {
        if let Some(known) = self.connections.get(&peer) {
            fact.from = known.from;
            // Whom the hub does not let in has proven who it is all the same.
            fact.audit.user = fact.audit.user.or_else(|| known.user.clone());
        }
        match fact.audit.what {
            "refused" => self.refused(fact),
            _ => self.note(fact),
        }
    }

    /// A connection from somewhere has come.
    pub fn arrived(&self, peer: PeerId, from: Option<IpAddr>) {
        let connection = AuditedPeer { from, user: None };
        self.connections.insert(peer, connection);
    }

    /// Somebody has logged in on it.
    pub fn is_user(&self, peer: PeerId, user: &str) {
        if let Some(mut known) = self.connections.get_mut(&peer) {
            known.user = Some(user.into());
        }
    }

    /// The user that has logged in on it last.
    pub fn user(&self, peer: PeerId) -> Option<Arc<str>> {
        self.connections.get(&peer)?.user.clone()
    }

    /// It is no more.
    pub fn left(&self, peer: PeerId) {
        self.connections.remove(&peer);
    }

    /// Waits until all that was told is written and durable, for a while at most.
    pub async fn flush(&self) {
        let (done, written) = oneshot::channel();
        let queue = self.queue.clone();
        // The queue may be full. A thread of its own, because a disk that hangs must not hold up the program's end.
        let sent = std::thread::Builder::new()
            .name("audit-flush".to_owned())
            .spawn(move || queue.send(AuditNote::Flush(done)).is_ok());
        if sent.is_err() || tokio::time::timeout(PATIENCE, written).await.is_err() {
            tracing::error!("the audit log could not be written to its end");
        }
    }
}

#[cfg(test)]
mod tests;
