//! A part in the shared hold of a token: for as long as it lasts, nobody drives.

use std::fmt;
use std::sync::Arc;

use mom_proto::Path;

use crate::contexts::membership::Membership;
use crate::control::holding::Holding;
use crate::peer::guards::Hold;
use crate::peer::holds::HoldingKind;
use crate::{ClientError, Lost};

/// A part in the shared hold of a token, from [`Token::inhibit`](crate::Token::inhibit) on: nobody can grab the token
/// while any peer has such a part. Dropping it ends the part; it is lost when the token is broken or deleted, and
/// with the link.
///
/// ```no_run
/// # async fn example(client: mom_client::Client) -> Result<(), mom_client::ClientError> {
/// let token = client.token("/robot/token").await?;
/// let pause = token.inhibit().await?;
/// println!("nobody drives while I am at the table");
/// pause.release().await?;
/// # Ok(())
/// # }
/// ```
pub struct InhibitGuard {
    holding: Holding,
}

impl InhibitGuard {
    pub(crate) fn new(hold: Arc<Hold>, member: Membership) -> InhibitGuard {
        InhibitGuard {
            holding: Holding::new(hold, HoldingKind::Shared, member),
        }
    }

    /// The token.
    pub fn path(&self) -> &Path {
        &self.holding.hold().path
    }

    /// Whether it is over.
    pub fn is_lost(&self) -> bool {
        self.holding.hold().is_lost()
    }

    /// Waits until it is over. Safe to cancel.
    pub async fn lost(&mut self) -> Lost {
        self.holding.lost().await
    }

    /// Ends the part and waits for the hub to say so. Does nothing if it is lost already.
    ///
    /// # Errors
    /// The hub's refusal, a lost link, a time-out.
    pub async fn release(self) -> Result<(), ClientError> {
        self.holding.release().await
    }
}

impl fmt::Debug for InhibitGuard {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("InhibitGuard")
            .field("path", self.path())
            .finish_non_exhaustive()
    }
}
