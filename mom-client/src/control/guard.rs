//! Ownership of a token, released on drop.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use mom_proto::Path;

use crate::contexts::membership::Membership;
use crate::control::holding::{After, Holding};
use crate::peer::guards::Hold;
use crate::peer::holds::HoldingKind;
use crate::{ClientError, Give, Loan, Lost};

/// Exclusive control of what a token guards (M28), from [`Token::grab`](crate::Token::grab) on.
///
/// It renews at a third of its lease, or of its deadman time if that is shorter, for as long as it lives; dropping it
/// releases the token. It is lost when the hub says so, when a renewal is refused, and with the link. The guards of
/// one ownership (grabbed again while held) share it: dropping the last one releases it.
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
    holding: Holding,
}

impl TokenGuard {
    pub(crate) fn new(hold: Arc<Hold>, member: Membership) -> TokenGuard {
        TokenGuard {
            holding: Holding::new(hold, HoldingKind::Ownership, member),
        }
    }

    /// The token.
    pub fn path(&self) -> &Path {
        &self.holding.hold().path
    }

    /// The fence of this ownership, for [`Message::fence`](crate::Message::fence).
    pub fn fence(&self) -> u64 {
        self.holding.hold().fence
    }

    /// How long the ownership lasts without renewal; none = unlimited.
    pub fn lease(&self) -> Option<Duration> {
        self.holding.hold().terms().lease
    }

    /// The deadman time, after which it ends without a renewal; none = no such limit.
    pub fn deadman(&self) -> Option<Duration> {
        self.holding.hold().terms().deadman
    }

    /// The terms of the loan, if another peer gave it for a time or a number of commands.
    pub fn delegation(&self) -> Option<&Loan> {
        self.holding.hold().delegation.as_ref()
    }

    /// Whether it is over.
    pub fn is_lost(&self) -> bool {
        self.holding.hold().is_lost()
    }

    /// Waits until it is over. Safe to cancel.
    pub async fn lost(&mut self) -> Lost {
        self.holding.lost().await
    }

    /// Offers the token to another peer (M41), for good unless the offer says otherwise. This guard owns it until the
    /// other peer accepts; then it is lost with the reason `given`.
    pub fn give(&self, to: impl Into<String>) -> Give<'_> {
        Give::new(self.holding.hold(), self.holding.member(), to.into())
    }

    /// Releases the token, after all messages sent before, and waits for the hub's answer. Does nothing if it is lost
    /// already.
    ///
    /// # Errors
    /// The hub's refusal, a lost link, a time-out.
    pub async fn release(self) -> Result<(), ClientError> {
        self.holding.release().await
    }

    /// Releases the token once what was said under it has come so far, and after `most` anyhow. A release halts the device, and what
    /// has not left the hub by then does not leave it any more; so [`TokenGuard::release`] may leave no time for the last command.
    ///
    /// # Errors
    /// As [`TokenGuard::release`]; `TimedOut` if it had not come so far in time, though the token is released then.
    pub async fn release_after(self, after: After, most: Duration) -> Result<(), ClientError> {
        self.holding.release_after(after, most).await
    }
}

impl fmt::Debug for TokenGuard {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("TokenGuard")
            .field("hold", self.holding.hold())
            .finish_non_exhaustive()
    }
}
