//! What a waiting client is told, and what it says.

use std::time::Duration;

use rmcp::model::{ProgressNotificationParam, ProgressToken};
use rmcp::service::RequestContext;
use rmcp::{Peer, RoleServer};
use tokio::sync::watch;
use tokio::time::timeout;

/// So long a client may take to read how far a call is.
const PATIENCE: Duration = Duration::from_millis(200);

/// One call as its client follows it.
pub(crate) struct Progress {
    context: RequestContext<RoleServer>,
    token: Option<ProgressToken>,
    peer: Peer<RoleServer>,
    last: f64,
    gone: watch::Receiver<bool>,
}

impl Progress {
    pub(crate) fn of(context: RequestContext<RoleServer>, gone: watch::Receiver<bool>) -> Progress {
        Progress {
            token: context.meta.get_progress_token(),
            peer: context.peer.clone(),
            context,
            last: -1.0,
            gone,
        }
    }

    /// Tells a client that has asked for it how far the call is; each number is higher than the last.
    pub(crate) async fn tell(&mut self, done: f64, of: Option<f64>, words: String) {
        let Some(token) = self.token.clone().filter(|_| done > self.last) else {
            return;
        };
        self.last = done;
        let mut told = ProgressNotificationParam::new(token, done).with_message(words);
        told.total = of.filter(|of| *of > 0.0);
        // A client that reads nothing must not hold up what is under way.
        if let Ok(Err(error)) = timeout(PATIENCE, self.peer.notify_progress(told)).await {
            tracing::debug!("progress cannot be told: {error}");
        }
    }

    /// Done when the client wants the call no more.
    pub(crate) async fn unwanted(&self) {
        self.context.ct.cancelled().await;
    }

    /// Done when the client wants the call no more, or is gone.
    pub(crate) async fn cancelled(&mut self) {
        tokio::select! {
            () = self.context.ct.cancelled() => {}
            // Without a sender the program ends as well.
            _ = self.gone.wait_for(|gone| *gone) => {}
        }
    }
}
