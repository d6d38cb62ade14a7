//! A token: what one peer at a time owns (M28).

use mom_proto::{Map, Path};
use tokio::sync::oneshot;
use tokio::time::timeout;

use crate::membership::Membership;
use crate::pending::Waiter;
use crate::{ClientError, Events, TokenGuard};

/// A token that this peer has joined, until the last of its clones, its events and its guards goes.
///
/// ```no_run
/// # async fn example(client: mom_client::Client) -> Result<(), mom_client::ClientError> {
/// use mom_client::{ClientError, Code};
/// let token = client.token("/robot/token").await?;
/// match token.grab().await {
///     Ok(guard) => println!("driving with fence {}", guard.fence()),
///     Err(ClientError::Refused(error)) if error.code == Code::HELD => {
///         println!("{}, free in {:?} at the latest", error.text, error.retry_in());
///     }
///     Err(error) => return Err(error),
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Token {
    member: Membership,
}

impl Token {
    pub(crate) fn new(member: Membership) -> Token {
        Token { member }
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        self.member.path()
    }

    /// Its events from now on; the first subscriber gets those since the join too, if they are few.
    pub fn events(&self) -> Events {
        self.member.events()
    }

    /// All about it: owner, fence, lease (M33).
    ///
    /// # Errors
    /// As [`Client::info`](crate::Client::info).
    pub async fn info(&self) -> Result<Map, ClientError> {
        self.member.client().info(self.path().as_str()).await
    }

    /// Grabs it (M28, M29). A grab that is given up while it waits is given back should it be granted.
    ///
    /// # Errors
    /// `Refused` with `held` (owner, level, retry-after) or `denied` (rule), a lost link, a time-out.
    pub async fn grab(&self) -> Result<TokenGuard, ClientError> {
        let (sender, receiver) = oneshot::channel();
        let waiter = Waiter::Grab {
            member: self.member.clone(),
            answer: sender,
        };
        let shared = self.member.shared();
        shared.grab(self.path(), waiter)?;
        let after = shared.settings.request_timeout;
        match timeout(after, receiver).await {
            Ok(Ok(guard)) => guard,
            Ok(Err(_)) => Err(ClientError::Connection("the link was lost".to_owned())),
            Err(_) => Err(ClientError::TimedOut {
                what: format!("token grab {}", self.path()),
                after,
            }),
        }
    }

    /// Leaves it, whatever other proxies of it there are. Ownership ends with it.
    ///
    /// # Errors
    /// `Refused` with `not-member`, a lost link, a time-out.
    pub async fn leave(self) -> Result<(), ClientError> {
        self.member.leave().await
    }
}
