//! A guard's part in a hold on a token, ended on drop.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::{Instant, timeout_at};

use crate::contexts::membership::Membership;
use crate::peer::guards::Hold;
use crate::peer::holds::HoldingKind;
use crate::{ClientError, Lost};

/// What a release waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum After {
    /// The hub has answered for all messages that were said before and need the token: it has put them into the queues of their
    /// receivers, or refused them. What a manager has to be asked about may be answered later.
    Taken,
    /// The device has said, too, how the last `command` ended: by a message `status` with its sender's name as `peer`, its `id`, and
    /// `finished` or `error` as `state`.
    Done,
}

/// A part in a hold. Dropping the last one ends the hold.
#[derive(Debug)]
pub(crate) struct Holding {
    hold: Arc<Hold>,
    kind: HoldingKind,
    lost: watch::Receiver<Option<Lost>>,
    member: Membership,
    held: bool,
}

impl Holding {
    pub(crate) fn new(hold: Arc<Hold>, kind: HoldingKind, member: Membership) -> Holding {
        Holding {
            lost: hold.watch(),
            hold,
            kind,
            member,
            held: true,
        }
    }

    pub(crate) fn hold(&self) -> &Arc<Hold> {
        &self.hold
    }

    pub(crate) fn member(&self) -> &Membership {
        &self.member
    }

    /// Waits until it is over. Safe to cancel.
    pub(crate) async fn lost(&mut self) -> Lost {
        match self.lost.wait_for(Option::is_some).await {
            Ok(lost) => lost.clone().unwrap_or_else(|| Lost::new("released", None)),
            // The sender lives in `hold`.
            Err(_) => Lost::new("released", None),
        }
    }

    /// Ends the hold and waits for the hub to say so.
    pub(crate) async fn release(mut self) -> Result<(), ClientError> {
        self.held = false;
        self.member.shared().release(&self.hold, self.kind).await
    }

    /// The same, after what was said under it has come so far or this time is over.
    pub(crate) async fn release_after(self, after: After, most: Duration) -> Result<(), ClientError> {
        let end = Instant::now() + most;
        let mut answered = self.member.shared().answer_of_all(&self.hold, most).await;
        if answered.is_ok() && after == After::Done && !self.hold.is_lost() {
            let mut lost = self.hold.watch();
            let waited = timeout_at(end, async {
                tokio::select! {
                    () = self.hold.done() => {}
                    _ = lost.wait_for(Option::is_some) => {}
                }
            });
            answered = waited.await.map_err(|_| ClientError::TimedOut {
                what: format!("the last command under {}", self.hold.path),
                after: most,
            });
        }
        self.release().await?;
        answered
    }
}

impl Drop for Holding {
    fn drop(&mut self) {
        if self.held {
            self.member.shared().let_go(&self.hold, self.kind);
        }
    }
}
