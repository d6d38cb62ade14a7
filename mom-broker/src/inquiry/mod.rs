//! Answers what peers ask and files say: `context audit`, `context explain` and `context what-if`.
//!
//! That they may ask is decided by the hub. What takes long (files, the parsing of a configuration, a whole recording) is
//! done by threads that give way to all others; the hub is asked by the tasks that serve, for a moment each time.

mod audit;
mod explain;
mod what_if;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;

use mom_config::Config;
use mom_hub::{Inquiry, PeerId};
use mom_proto::{Code, Content, Map, WireError};
use mom_system::Workers;
use parking_lot::Mutex;
use serde::de::DeserializeOwned;
use tokio::sync::{oneshot, watch};
use tokio::task::JoinSet;

use crate::traffic::inquiries::Inquired;
use crate::traffic::switchboard::{Switchboard, Touched, flush};

/// Bytes of one reply, about; lists end before that.
const MOST_BYTES: usize = 256 * 1024;

/// What answers.
#[derive(Debug)]
pub(crate) struct Answering {
    board: Arc<Switchboard>,
    /// The configuration that the broker goes by.
    running: Arc<Mutex<Config>>,
    /// For what is over soon.
    reading: Workers,
    /// For what-ifs, which take long: one after the other.
    trying: Workers,
    /// The what-ifs that wait or are decided.
    tried: AtomicUsize,
}

impl Answering {
    pub(crate) fn new(board: Arc<Switchboard>, running: Arc<Mutex<Config>>) -> Answering {
        Answering {
            board,
            running,
            reading: Workers::new(1),
            trying: Workers::new(1),
            tried: AtomicUsize::new(0),
        }
    }

    /// Answers until the broker stops.
    pub(crate) async fn run(self, mut stop: watch::Receiver<bool>) {
        let Some(mut waiting) = self.board.inquiries.take() else {
            return;
        };
        let answering = Arc::new(self);
        let mut tasks = JoinSet::new();
        loop {
            tokio::select! {
                _ = stop.changed() => return,
                Some(_) = tasks.join_next() => {}
                inquired = waiting.recv() => match inquired {
                    Some(inquired) => drop(tasks.spawn(Arc::clone(&answering).answer(inquired))),
                    None => return,
                },
            }
        }
    }

    async fn answer(self: Arc<Self>, inquired: Inquired) {
        let Inquired { to, reply, inquiry } = inquired;
        let open = Open {
            board: &self.board,
            to,
        };
        let user = self.user(to);
        let answer = match inquiry {
            Inquiry::Audit { path, content } => self.audit(to, path, content).await,
            Inquiry::Explain(asked) => self.explain(to, asked).await,
            Inquiry::WhatIf { content } => self.what_if(to, content).await,
        };
        // Before it has its answer, or its next question might come too soon.
        drop(open);
        // Another user on the same connection has not asked this.
        if self.user(to) != user {
            return;
        }
        let mut parcel = match answer {
            Ok(content) => {
                let mut parcel = (*reply).clone();
                parcel.content = Some(content.into());
                parcel
            }
            Err(error) => error.to_parcel(reply.reference),
        };
        parcel.reference = reply.reference;
        let mut touched = Touched::new();
        self.board.tell(to, parcel, &mut touched);
        flush(&mut touched);
    }

    fn user(&self, peer: PeerId) -> Option<String> {
        self.board
            .ask_hub(|hub, _| hub.user_of(peer))
            .map(|user| user.name)
    }

    /// Has something done by a thread that gives way, with the configuration that holds now.
    async fn with_config<T: Send + 'static>(
        &self,
        job: impl FnOnce(&Config) -> T + Send + 'static,
    ) -> Result<T, WireError> {
        let running = Arc::clone(&self.running);
        let job = move || {
            // Not under its lock: a thread that changes it must not wait for this one.
            let config = running.lock().clone();
            job(&config)
        };
        on(&self.reading, job).await
    }
}

/// A question that is not answered yet.
struct Open<'a> {
    board: &'a Switchboard,
    to: PeerId,
}

impl Drop for Open<'_> {
    fn drop(&mut self) {
        self.board.inquiries.answered(self.to);
    }
}

/// Has something done by these threads.
async fn on<T: Send + 'static>(
    workers: &Workers,
    job: impl FnOnce() -> T + Send + 'static,
) -> Result<T, WireError> {
    let (done, result) = oneshot::channel();
    workers.run(move || {
        // A fault in it must not end the thread; the receiver may have stopped waiting.
        if let Ok(result) = catch_unwind(AssertUnwindSafe(job)) {
            let _ = done.send(result);
        }
    });
    let failed = || {
        WireError::new(
            Code::TRY_LATER,
            "internal error in the broker while answering this request",
        )
    };
    result.await.map_err(|_| failed())
}

/// What stands in the content of a request that may have none.
fn read<T: DeserializeOwned + Default>(content: Option<&Content>) -> Result<T, WireError> {
    content.map_or_else(|| Ok(T::default()), Content::read)
}

/// An error about a key of the content.
fn bad(key: &str, text: impl Into<String>) -> WireError {
    WireError::new(Code::BAD_CONTENT, text).slot(&format!("content/{key}"))
}

/// A number for the wire.
fn int(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

/// About what a map takes of a reply.
fn size(map: &Map) -> usize {
    Content::Value(map.clone().into()).size()
}
