//! Asking the owner of a token to hand it over.

use std::fmt;
use std::future::{Future, IntoFuture};
use std::pin::Pin;
use std::time::Duration;

use mom_proto::{Family, Map};

use crate::contexts::membership::Membership;
use crate::control::owning::owning;
use crate::peer::shared::verb;
use crate::words::millis;
use crate::{ClientError, TokenGuard};

/// How long an owner may take to answer, by default.
const WITHIN: Duration = Duration::from_secs(30);

/// A builder of a request to a token's owner, from [`Token::request`](crate::Token::request): await it to send it and
/// get the owner's answer.
///
/// ```no_run
/// # async fn example(token: mom_client::Token) -> Result<(), mom_client::ClientError> {
/// let guard = token.request().text("only to take the cup away").await?;
/// # Ok(())
/// # }
/// ```
#[must_use = "a request does nothing until it is awaited"]
#[derive(Clone)]
pub struct AskOwner<'a> {
    member: &'a Membership,
    within: Option<Duration>,
    text: Option<String>,
}

impl<'a> AskOwner<'a> {
    pub(crate) fn new(member: &'a Membership) -> AskOwner<'a> {
        AskOwner {
            member,
            within: None,
            text: None,
        }
    }

    /// How long the owner may take to answer; 30 s by default.
    pub fn within(mut self, within: Duration) -> AskOwner<'a> {
        self.within = Some(within);
        self
    }

    /// The reason, shown to the owner.
    pub fn text(mut self, text: impl Into<String>) -> AskOwner<'a> {
        self.text = Some(text.into());
        self
    }

    async fn run(self) -> Result<TokenGuard, ClientError> {
        let (shared, path) = (self.member.shared(), self.member.path());
        let mut content = Map::new();
        if let Some(within) = self.within {
            content.set("within", millis(within));
        }
        if let Some(text) = &self.text {
            content.set("text", text.as_str());
        }
        let (waiter, receiver) = owning(self.member);
        let parcel = verb(Family::Token, "request", path).content(content);
        shared.obtain(parcel, waiter)?;
        let more = self.within.unwrap_or(WITHIN);
        shared
            .late_answer(receiver, more, format!("token request {path}"))
            .await
    }
}

impl<'a> IntoFuture for AskOwner<'a> {
    type Output = Result<TokenGuard, ClientError>;
    type IntoFuture = Pin<Box<dyn Future<Output = Self::Output> + Send + 'a>>;

    fn into_future(self) -> Self::IntoFuture {
        Box::pin(self.run())
    }
}

impl fmt::Debug for AskOwner<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("AskOwner")
            .field("path", self.member.path())
            .field("within", &self.within)
            .field("text", &self.text)
            .finish()
    }
}
