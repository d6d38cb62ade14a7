//! A session: a directory of contexts (M22).

use mom_proto::{Map, Path};

use crate::contexts::membership::Membership;
use crate::{ClientError, ContextInfo, Events};

/// A session that this peer has joined, until the last of its clones, its events and the proxies below it is dropped.
///
/// ```no_run
/// # async fn example(client: mom_client::Client) -> Result<(), mom_client::ClientError> {
/// use mom_client::Map;
/// let home = client.session("/home").await?;
/// let spec = Map::new().with("kind", "channel").with("manager", "open");
/// let made = home.create("alice", spec).await?;
/// assert_eq!(made.path.as_str(), "/home/alice");
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Session {
    member: Membership,
}

impl Session {
    pub(crate) fn new(member: Membership) -> Session {
        Session { member }
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        self.member.path()
    }

    /// Its details (M33).
    ///
    /// # Errors
    /// As [`Client::info`](crate::Client::info).
    pub async fn info(&self) -> Result<Map, ClientError> {
        self.member.client().info(self.path().as_str()).await
    }

    /// Its events from now on; the first subscriber gets those since the join too, if they are few.
    pub fn events(&self) -> Events {
        self.member.events()
    }

    /// The contexts in it.
    ///
    /// # Errors
    /// As [`Client::list`](crate::Client::list).
    pub async fn list(&self) -> Result<Vec<ContextInfo>, ClientError> {
        self.member.client().list(self.path().as_str()).await
    }

    /// Creates a context in it.
    ///
    /// # Errors
    /// As [`Client::create`](crate::Client::create).
    pub async fn create(&self, name: &str, spec: Map) -> Result<ContextInfo, ClientError> {
        let path = self.path().child(name)?;
        self.member.client().create(path.as_str(), spec).await
    }

    /// Leaves it and all below it, even if other proxies of it exist.
    ///
    /// # Errors
    /// `Refused` with `not-member`, a lost link, a time-out.
    pub async fn leave(self) -> Result<(), ClientError> {
        self.member.leave().await
    }
}
