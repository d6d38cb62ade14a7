//! Ownership of a token, given back when it is dropped.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;

use crate::ClientError;
use crate::guards::Hold;
use crate::membership::Membership;

/// Exclusive control of what a token guards (M28), from [`Token::grab`](crate::Token::grab) on.
///
/// It renews its lease at a third of it, for as long as it lives; dropping it gives the token back. It is
/// lost when the hub says so, when a renewal is refused, and with the link. The guards of one ownership
/// (grabbed again while held) share it: the last one dropped gives it back.
///
/// ```no_run
/// # async fn example(client: mom_client::Client) -> Result<(), mom_client::ClientError> {
/// let mut guard = client.token("/robot/token").await?.grab().await?;
/// let arm = client.channel("/robot/arm").await?;
/// tokio::select! {
///     sent = arm.send("command", "grip open") => sent?,
///     lost = guard.lost() => println!("lost: {}", lost.reason),
/// }
/// guard.release().await?;
/// # Ok(())
/// # }
/// ```
pub struct TokenGuard {
    hold: Arc<Hold>,
    lost: watch::Receiver<Option<Lost>>,
    member: Membership,
    held: bool,
}

/// Why and through whom an ownership ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lost {
    /// A word of [`Reason`](crate::event::Reason), `disconnected` for a lost link, or the code's word of a
    /// refused renewal.
    pub reason: String,
    /// The peer that caused it, if one did.
    pub by: Option<String>,
}

impl Lost {
    pub(crate) fn new(reason: &str, by: Option<String>) -> Lost {
        Lost {
            reason: reason.to_owned(),
            by,
        }
    }
}

impl TokenGuard {
    pub(crate) fn new(hold: Arc<Hold>, member: Membership) -> TokenGuard {
        TokenGuard {
            lost: hold.watch(),
            hold,
            member,
            held: true,
        }
    }

    /// The fence of this ownership, for [`Message::fence`](crate::Message::fence).
    pub fn fence(&self) -> u64 {
        self.hold.fence
    }

    /// How long the ownership lasts without renewal; none = without end.
    pub fn lease(&self) -> Option<Duration> {
        self.hold.lease()
    }

    /// Whether it is over.
    pub fn is_lost(&self) -> bool {
        self.hold.is_lost()
    }

    /// Waits until it is over. Safe to cancel.
    pub async fn lost(&mut self) -> Lost {
        match self.lost.wait_for(Option::is_some).await {
            Ok(lost) => lost.clone().unwrap_or_else(|| Lost::new("released", None)),
            // The sender lives in `hold`.
            Err(_) => Lost::new("released", None),
        }
    }

    /// Gives the token back, after all messages sent before, and waits for the hub to say so. What is lost
    /// already needs no giving back.
    ///
    /// # Errors
    /// The hub's refusal, a lost link, a time-out.
    pub async fn release(mut self) -> Result<(), ClientError> {
        self.held = false;
        self.member.shared().release(&self.hold).await
    }
}

impl Drop for TokenGuard {
    fn drop(&mut self) {
        if self.held {
            self.member.shared().let_go(&self.hold);
        }
    }
}

impl fmt::Debug for TokenGuard {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("TokenGuard")
            .field("hold", &self.hold)
            .finish_non_exhaustive()
    }
}
