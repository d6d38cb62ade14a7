//! Giving a token to another peer (M41).

use std::fmt;
use std::future::{Future, IntoFuture};
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use mom_proto::event::Reason;
use mom_proto::{Family, Map, Value};
use tokio::sync::{oneshot, watch};

use crate::contexts::membership::Membership;
use crate::peer::guards::Hold;
use crate::peer::handover::{Handover, HandoverPhase};
use crate::peer::pending::{AnswerTo, RequestResult};
use crate::peer::shared::verb;
use crate::words::millis;
use crate::{ClientError, Lost, TokenGuard};

/// A builder of an offer, from [`TokenGuard::give`]: await it to make the offer.
///
/// ```no_run
/// # async fn example(guard: mom_client::TokenGuard) -> Result<(), mom_client::ClientError> {
/// use std::time::Duration;
/// let given = guard.give("visual-servo").time(Duration::from_secs(60)).commands(20).await?;
/// match given.returned().await {
///     Ok(guard) => println!("driving again, with fence {}", guard.fence()),
///     Err(lost) => println!("it does not come back: {}", lost.reason),
/// }
/// # Ok(())
/// # }
/// ```
#[must_use = "an offer does nothing until it is awaited"]
#[derive(Clone)]
pub struct Give<'a> {
    hold: &'a Arc<Hold>,
    member: &'a Membership,
    to: String,
    within: Option<Duration>,
    time: Option<Duration>,
    commands: Option<u64>,
}

impl<'a> Give<'a> {
    pub(crate) fn new(hold: &'a Arc<Hold>, member: &'a Membership, to: String) -> Give<'a> {
        Give {
            hold,
            member,
            to,
            within: None,
            time: None,
            commands: None,
        }
    }

    /// How long the other peer may take to accept; 10 s by default.
    pub fn within(mut self, within: Duration) -> Give<'a> {
        self.within = Some(within);
        self
    }

    /// Gives it only for this time from the acceptance on; then the token returns by itself.
    pub fn time(mut self, time: Duration) -> Give<'a> {
        self.time = Some(time);
        self
    }

    /// Gives it only for so many guarded messages; then it returns by itself.
    pub fn commands(mut self, commands: u64) -> Give<'a> {
        self.commands = Some(commands);
        self
    }

    async fn run(self) -> Result<Given, ClientError> {
        let shared = self.member.shared();
        let mut content = Map::new().with("to", self.to.as_str());
        for (key, time) in [("within", self.within), ("for", self.time)] {
            if let Some(time) = time {
                content.set(key, millis(time));
            }
        }
        if let Some(commands) = self.commands {
            content.set(
                "commands",
                Value::Int(i64::try_from(commands).unwrap_or(i64::MAX)),
            );
        }
        let delegated = self.time.is_some() || self.commands.is_some();
        let path = self.member.path();
        let handover = Handover::new(path, self.to, delegated, Arc::clone(self.hold));
        let (sender, receiver) = oneshot::channel();
        let member = self.member.clone();
        let offered = |_| {
            let handover = Arc::new(handover);
            member.shared().lock().handovers.offer(Arc::clone(&handover));
            Given::new(handover, member)
        };
        // Before the next parcel is read, so that it misses no event.
        let waiter = AnswerTo::taker(|_, answer: RequestResult| drop(sender.send(answer.map(offered))));
        let parcel = verb(Family::Token, "give", path).content(content);
        shared.ask(parcel, waiter)?;
        shared.answer(receiver, format!("token give {path}")).await
    }
}

impl<'a> IntoFuture for Give<'a> {
    type Output = Result<Given, ClientError>;
    type IntoFuture = Pin<Box<dyn Future<Output = Self::Output> + Send + 'a>>;

    fn into_future(self) -> Self::IntoFuture {
        Box::pin(self.run())
    }
}

impl fmt::Debug for Give<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Give")
            .field("path", self.member.path())
            .field("to", &self.to)
            .field("within", &self.within)
            .field("time", &self.time)
            .field("commands", &self.commands)
            .finish()
    }
}

/// A token that this client has offered to another peer, or given to it.
///
/// The [`TokenGuard`] that made the offer owns the token until the other peer accepts. Dropping this does not
/// withdraw the offer; a token that returns while nobody waits for it is released.
pub struct Given {
    handover: Arc<Handover>,
    phase: watch::Receiver<HandoverPhase>,
    member: Membership,
    /// Whether a guard took over the returned token.
    taken: bool,
}

/// Why the other peer does not get the token.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the offer to {to} failed: {reason}")]
pub struct Lapsed {
    /// To whom it was offered.
    pub to: String,
    /// `declined`, `timed-out`, `withdrawn` by another offer, `lost` with the ownership, `left`, or
    /// `disconnected` for a lost link.
    pub reason: String,
}

impl Given {
    pub(crate) fn new(handover: Arc<Handover>, member: Membership) -> Given {
        Given {
            phase: handover.watch(),
            handover,
            member,
            taken: false,
        }
    }

    /// To whom it is offered.
    pub fn to(&self) -> &str {
        &self.handover.to
    }

    /// Waits until the other peer owns it. Safe to cancel.
    ///
    /// # Errors
    /// [`Lapsed`] if it does not get it.
    pub async fn accepted(&mut self) -> Result<(), Lapsed> {
        match self.wait(|phase| !matches!(phase, HandoverPhase::Offered)).await {
            HandoverPhase::Lapsed(reason) => Err(Lapsed {
                to: self.handover.to.clone(),
                reason,
            }),
            _ => Ok(()),
        }
    }

    /// Waits until the token is this client's again, because the loan has ended or the other peer did not take it.
    ///
    /// # Errors
    /// [`Lost`] if it does not return: it was given for good, or another peer has it.
    pub async fn returned(mut self) -> Result<TokenGuard, Lost> {
        let end = self
            .wait(|phase| !matches!(phase, HandoverPhase::Offered | HandoverPhase::Taken))
            .await;
        let hold = match end {
            HandoverPhase::Back(hold) => {
                self.taken = true;
                hold
            }
            HandoverPhase::Over(lost) => return Err(lost),
            // It never left: another guard of the same ownership.
            _ => self.still_held()?,
        };
        Ok(TokenGuard::new(hold, self.member.clone()))
    }

    fn still_held(&self) -> Result<Arc<Hold>, Lost> {
        let hold = &self.handover.hold;
        let shared = self.member.shared().lock().guards.share(&hold.path, hold.fence);
        shared.ok_or_else(|| {
            hold.lost()
                .unwrap_or_else(|| Lost::new(Reason::Released.word(), None))
        })
    }

    async fn wait(&mut self, until: impl Fn(&HandoverPhase) -> bool) -> HandoverPhase {
        match self.phase.wait_for(until).await {
            Ok(phase) => phase.clone(),
            // The sender lives in `handover`.
            Err(_) => self.handover.phase(),
        }
    }
}

impl Drop for Given {
    fn drop(&mut self) {
        if !self.taken {
            self.member.shared().forget(&self.handover);
        }
    }
}

impl fmt::Debug for Given {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Given")
            .field("handover", &self.handover)
            .finish_non_exhaustive()
    }
}
