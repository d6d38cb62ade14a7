//! A token while work is done under it.

use std::future::Future;
use std::pin::pin;
use std::time::Duration;

use mom_client::{Client, Lost, Token, TokenGuard};
use tokio::time::{Instant, timeout};

use crate::asking::ANSWER;
use crate::end::{How, ended_words};
use crate::failure::Doing as _;
use crate::scope::{beyond_scope, scope_end_words};
use crate::{Commander, VerbFailure};

/// A token that we own, or have lost.
#[derive(Debug)]
pub struct Holding {
    token: Token,
    guard: TokenGuard,
    since: Instant,
}

/// How the work under a token ended.
#[derive(Debug)]
pub enum WorkEnd<T> {
    /// By itself.
    Ended(T),
    /// Because the user wanted it.
    Interrupted,
    /// Because the token was lost.
    Lost(Lost),
}

impl Holding {
    /// Grabs a token, at once or after at most so long in its queue.
    ///
    /// # Errors
    /// The hub's refusal, a lost connection.
    pub async fn grab(client: &Client, path: &str, wait: Option<Duration>) -> Result<Holding, VerbFailure> {
        let token = client.token(path).await.doing(format!("join {path}"))?;
        let grab = match wait {
            Some(time) => token.grab().wait(time),
            None => token.grab(),
        };
        let guard = grab.await.doing(format!("grab {path}"))?;
        let since = Instant::now();
        Ok(Holding { token, guard, since })
    }

    /// Accepts a token that another peer offers.
    ///
    /// # Errors
    /// The hub's refusal, a lost connection.
    pub async fn accept(token: Token) -> Result<Holding, VerbFailure> {
        let guard = token.accept().await.doing(format!("accept {}", token.path()))?;
        let since = Instant::now();
        Ok(Holding { token, guard, since })
    }

    /// The fence of the ownership.
    #[must_use]
    pub fn fence(&self) -> u64 {
        self.guard.fence()
    }

    /// Its guard.
    #[must_use]
    pub fn guard(&self) -> &TokenGuard {
        &self.guard
    }

    /// Works until the work is done, or the user wants no more, or the token is lost. What was lent ends with its
    /// scope, also where the hub is silent, and with who lent it.
    pub async fn during<T>(
        &mut self,
        interrupt: impl Future<Output = ()>,
        work: impl Future<Output = Result<T, VerbFailure>>,
    ) -> WorkEnd<Result<T, VerbFailure>> {
        let (interrupt, work) = (pin!(interrupt), pin!(work));
        let loan = self.guard.delegation().cloned();
        let beyond = pin!(beyond_scope(&self.token, loan.as_ref(), self.since));
        let ended = tokio::select! {
            biased;
            lost = self.guard.lost() => return WorkEnd::Lost(lost),
            () = interrupt => WorkEnd::Interrupted,
            why = beyond => return WorkEnd::Ended(Err(VerbFailure::plain(why))),
            ended = work => WorkEnd::Ended(ended),
        };
        // Who interrupts wants the token back at once, and has no refusal that is to be explained.
        if !matches!(ended, WorkEnd::Ended(Err(_))) {
            return ended;
        }
        // A device that refuses because the token is lost may say so before the hub does.
        let _asked = timeout(ANSWER, self.token.info()).await;
        match self.guard.is_lost() {
            true => WorkEnd::Lost(self.guard.lost().await),
            false => ended,
        }
    }

    /// Why the token is gone, in words; that its scope is used up, if that is it.
    #[must_use]
    pub fn lost_words(&self, lost: &Lost) -> String {
        scope_end_words(self.guard.path().as_str(), lost, self.guard.delegation())
    }

    /// That the token is lost, and what the device has said of what ran under it.
    pub async fn loss(&self, lost: &Lost, commander: &mut Commander) -> VerbFailure {
        let end = commander.lost(lost).await;
        let (ended, hint) = match end.map(|end| end.how) {
            Some(How::Lost { ended, .. }) => ended_words(ended),
            _ => ("", None),
        };
        VerbFailure::Failed {
            text: format!("{}{ended}", self.lost_words(lost)),
            hint: hint.map(str::to_owned),
        }
    }

    /// Gives the token back, so that the hub halts the robot; a command of ours that runs is heard to have ended.
    ///
    /// # Errors
    /// The hub's refusal, a lost connection; a robot that did not end its command, and was stopped or is silent.
    pub async fn end(mut self, commander: &mut Commander) -> Result<(), VerbFailure> {
        if self.guard.is_lost() {
            let lost = self.guard.lost().await;
            commander.lost(&lost).await;
        }
        commander.end(self.release()).await
    }

    /// Gives the token back. Does nothing if it is lost.
    ///
    /// # Errors
    /// The hub's refusal, a lost connection.
    pub async fn release(self) -> Result<(), VerbFailure> {
        let what = format!("release {}", self.guard.path());
        self.guard.release().await.doing(what)
    }
}
