//! A token: what one peer at a time owns (M28).

use mom_proto::{ContextKind, Family, Map, Path};

use crate::contexts::membership::Membership;
use crate::control::owning::{inhibiting, owning};
use crate::peer::shared::verb;
use crate::words::{map_of, name_list, owned};
use crate::{AskOwner, Client, ClientError, Events, Grab, InhibitGuard, TokenGuard, TokenInfo};

/// A token that this peer has joined, until the last of its clones, its events and its guards is dropped.
///
/// ```no_run
/// # async fn example(client: mom_client::Client) -> Result<(), mom_client::ClientError> {
/// let token = client.token("/robot/token").await?;
/// match token.grab().await {
///     Ok(guard) => println!("driving with fence {}", guard.fence()),
///     Err(error) => match error.refusal() {
///         // bob (level 1) holds it for 2 min 3 s more; you would be 2nd in the queue
///         Some(refusal) => println!("{refusal}"),
///         None => return Err(error),
///     },
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Token {
    member: Membership,
}

impl Client {
    /// Joins a token, parents first; this gives its events, not ownership.
    ///
    /// # Errors
    /// As [`Client::session`].
    pub async fn token(&self, path: &str) -> Result<Token, ClientError> {
        self.enter_kind(path, ContextKind::Token, None)
            .await
            .map(Token::new)
    }
}

impl Token {
    pub(crate) fn new(member: Membership) -> Token {
        Token { member }
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        self.member.path()
    }

    /// Its events from now on; the first subscriber gets those since the join too, if they are few. Offers to this
    /// peer and requests to it as the owner are among them.
    pub fn events(&self) -> Events {
        self.member.events()
    }

    /// Its details as the hub sends them (M33); typed: [`Token::status`].
    ///
    /// # Errors
    /// As [`Client::info`](crate::Client::info).
    pub async fn info(&self) -> Result<Map, ClientError> {
        self.member.client().info(self.path().as_str()).await
    }

    /// Its owner, queue, offers and requests (M33).
    ///
    /// # Errors
    /// As [`Client::info`](crate::Client::info).
    pub async fn status(&self) -> Result<TokenInfo, ClientError> {
        self.info().await.map(|info| TokenInfo::read(&info))
    }

    /// Grabs it (M28, M29), at once or, with [`Grab::wait`], by way of the queue. A dropped grab leaves the queue, or
    /// is released if it has been granted.
    ///
    /// # Errors
    /// `Refused` with `held` (owner, level, retry-after, place), `timed-out` after the wait, or `denied` (rule), a
    /// lost link, a time-out.
    pub fn grab(&self) -> Grab<'_> {
        Grab::new(&self.member)
    }

    /// Asks its owner to hand it over, and waits for the answer; a free token is granted at once. A dropped request
    /// stays with the owner; if it is granted, the token is released.
    ///
    /// # Errors
    /// `Refused` with `declined` (the owner's words), `timed-out`, `withdrawn` or `denied`, a lost link, a time-out.
    pub fn request(&self) -> AskOwner<'_> {
        AskOwner::new(&self.member)
    }

    /// Accepts the owner's offer ([`Event::Offer`](crate::Event::Offer)).
    ///
    /// # Errors
    /// `Refused` with `no-offer` or `denied`, a lost link, a time-out.
    pub async fn accept(&self) -> Result<TokenGuard, ClientError> {
        let (waiter, receiver) = owning(&self.member);
        let shared = self.member.shared();
        shared.obtain(verb(Family::Token, "accept", self.path()), waiter)?;
        shared
            .answer(receiver, format!("token accept {}", self.path()))
            .await
    }

    /// Declines an offer.
    ///
    /// # Errors
    /// `Refused` with `no-offer`, a lost link, a time-out.
    pub async fn decline(&self) -> Result<(), ClientError> {
        self.ask("decline", Map::new()).await
    }

    /// Hands it over to a peer that has asked for it ([`Event::Requested`](crate::Event::Requested)). The owner's
    /// guard is lost with the reason `given`.
    ///
    /// # Errors
    /// `Refused` with `no-offer` or `not-owner`, a lost link, a time-out.
    pub async fn accept_request(&self, peer: &str) -> Result<(), ClientError> {
        self.ask("accept", Map::new().with("peer", peer)).await
    }

    /// Declines a peer's request; `text` is the reason and may be empty.
    ///
    /// # Errors
    /// `Refused` with `no-offer`, a lost link, a time-out.
    pub async fn decline_request(&self, peer: &str, text: &str) -> Result<(), ClientError> {
        let mut content = Map::new().with("peer", peer);
        if !text.is_empty() {
            content.set("text", text);
        }
        self.ask("decline", content).await
    }

    /// Takes it away from its owner, or ends all parts in its shared hold, and returns the peers that had it; the
    /// first in the queue then gets it. This needs a right of its own.
    ///
    /// # Errors
    /// `Refused` with `denied`, a lost link, a time-out.
    pub async fn break_hold(&self) -> Result<Vec<String>, ClientError> {
        let parcel = verb(Family::Token, "break", self.path());
        let map = map_of(&self.member.shared().request(parcel).await?);
        let mut had = name_list(&map, "holders");
        had.extend(owned(&map, "owner"));
        Ok(had)
    }

    /// Joins its shared hold: nobody can grab it meanwhile. An owner gives up its ownership by this.
    ///
    /// # Errors
    /// `Refused` with `held` if another peer owns it, or `denied`, a lost link, a time-out.
    pub async fn inhibit(&self) -> Result<InhibitGuard, ClientError> {
        let (waiter, receiver) = inhibiting(&self.member);
        let shared = self.member.shared();
        shared.inhibit(verb(Family::Token, "inhibit", self.path()), waiter)?;
        shared
            .answer(receiver, format!("token inhibit {}", self.path()))
            .await
    }

    /// Leaves it, even if other proxies of it exist. Ownership ends with it.
    ///
    /// # Errors
    /// `Refused` with `not-member`, a lost link, a time-out.
    pub async fn leave(self) -> Result<(), ClientError> {
        self.member.leave().await
    }

    async fn ask(&self, name: &str, content: Map) -> Result<(), ClientError> {
        let mut parcel = verb(Family::Token, name, self.path());
        if !content.is_empty() {
            parcel.content = Some(content.into());
        }
        self.member.shared().request(parcel).await.map(drop)
    }
}
