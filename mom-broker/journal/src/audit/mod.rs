//! The audit log: who was granted or refused what, or lost it, by which rule. Each fact is one line of JSON.
//!
//! Facts go into a bounded queue. A thread of its own writes them to a file or the log, so that no decision ever
//! waits for a disk. Facts that queue or disk do not take are counted, and the log says so.

mod backwards;
mod fact;
mod file;
mod refusals;
mod ring;
mod scan;
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
pub use scan::{AuditQuery, AuditScan};
pub use settings::AuditConfig;

use crate::kept_files::KeptFiles;
use file::RotatingFile;
use mom_system::Clock;
use ring::{Ring, RingSink};
use scan::Kept;
use sink::LineSink;
use writer::{AuditNote, AuditShared, AuditWriter};

/// Facts that wait for the writer.
const QUEUE: usize = 16 * 1024;

/// How long a stopping broker waits for its facts to be durable.
const PATIENCE: Duration = Duration::from_secs(5);

/// How long a reader of the log waits for what was just noted.
const SOON: Duration = Duration::from_secs(1);

/// Details of a connection that its facts do not carry.
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
    kept: Kept,
}

impl AuditLog {
    /// Opens the log and starts its writer, which ends when the last sender of facts is dropped.
    ///
    /// # Errors
    /// What the system says about the file, or that another broker writes it.
    pub fn start(config: &AuditConfig, clock: Clock) -> io::Result<AuditLog> {
        match &config.path {
            Some(path) => {
                let files = KeptFiles::new(path, config.keep, config.reserve);
                let (file, seq) = RotatingFile::open(files, config.size)?;
                AuditLog::write_to(file, Kept::Files(path.clone()), clock, seq)
            }
            None => {
                let ring = Arc::new(Ring::default());
                AuditLog::write_to(RingSink(Arc::clone(&ring)), Kept::Memory(ring), clock, 0)
            }
        }
    }

    fn write_to(sink: impl LineSink + 'static, kept: Kept, clock: Clock, seq: u64) -> io::Result<AuditLog> {
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
            kept,
        })
    }

    /// Writes a fact, or folds it with identical ones; never waits for the disk.
    pub fn note(&self, fact: Fact) {
        // Held until all facts are in the queue: the writer takes folded facts under the same lock and must not
        // interleave.
        let mut successes = self.shared.successes.lock();
        successes.take(fact).into_iter().for_each(|fact| self.queue(fact));
    }

    fn queue(&self, fact: Fact) {
        let count = fact.count.unwrap_or(1);
        match self.queue.try_send(AuditNote::Fact(Box::new(fact))) {
            Ok(()) => {}
            // The writer reports their number as soon as it can.
            Err(TrySendError::Full(_)) => drop(self.shared.lost.fetch_add(count, Ordering::Relaxed)),
            Err(TrySendError::Disconnected(_)) => {
                if !self.dead.swap(true, Ordering::Relaxed) {
                    tracing::error!("the audit log's writer has ended: auditing has stopped");
                }
            }
        }
    }

    /// Writes a refusal: the first of its kind at once, later ones once a second with their count.
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

    /// Writes the outcome of a login on this connection.
    pub fn login(&self, peer: PeerId, mut fact: Fact) {
        if let Some(known) = self.connections.get(&peer) {
            fact.from = known.from;
            // A peer that the hub does not let in has authenticated all the same.
            fact.audit.user = fact.audit.user.or_else(|| known.user.clone());
        }
        match fact.audit.what {
            "refused" => self.refused(fact),
            _ => self.note(fact),
        }
    }

    /// A connection was opened from this address.
    pub fn arrived(&self, peer: PeerId, from: Option<IpAddr>) {
        let connection = AuditedPeer { from, user: None };
        self.connections.insert(peer, connection);
    }

    /// A peer has come back from this address.
    pub fn moved(&self, peer: PeerId, from: Option<IpAddr>) {
        if let Some(mut known) = self.connections.get_mut(&peer) {
            known.from = from;
        }
    }

    /// A user has logged in on it.
    pub fn is_user(&self, peer: PeerId, user: &str) {
        if let Some(mut known) = self.connections.get_mut(&peer) {
            known.user = Some(user.into());
        }
    }

    /// The user that has logged in on it last.
    pub fn user(&self, peer: PeerId) -> Option<Arc<str>> {
        self.connections.get(&peer)?.user.clone()
    }

    /// The connection has ended.
    pub fn left(&self, peer: PeerId) {
        self.connections.remove(&peer);
    }

    /// Looks through it, from the newest fact on.
    pub fn scan(&self, query: AuditQuery) -> AuditScan {
        AuditScan::new(self.kept.clone(), query)
    }

    /// Waits, for a short time, until what was noted is where a scan finds it; it need not be durable.
    pub async fn written(&self) {
        let (done, written) = oneshot::channel();
        // A queue that is full says that the disk is slow, and nobody waits for that.
        if self.queue.try_send(AuditNote::Written(done)).is_ok() {
            let _ = tokio::time::timeout(SOON, written).await;
        }
    }

    /// Waits, for a bounded time, until all facts are written and durable.
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
