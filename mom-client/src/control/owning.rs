//! Asking for tokens, and giving them back.

use std::sync::Arc;
use std::time::Duration;

use mom_proto::{Family, Parcel, Path};
use parking_lot::MutexGuard;
use tokio::sync::{oneshot, watch};
use tokio::time::{Instant, timeout};

use crate::contexts::membership::Membership;
use crate::error::bad_reply;
use crate::peer::guards::Hold;
use crate::peer::handover::{Handover, HandoverPhase};
use crate::peer::holds::HoldingKind;
use crate::peer::pending::{AnswerTo, Answered, RequestResult};
use crate::peer::shared::{Shared, verb};
use crate::peer::state::State;
use crate::said::ownership::GrantTerms;
use crate::wire::outbox::Follows;
use crate::words::map_of;
use crate::{ClientError, InhibitGuard, Place, TokenGuard};

/// Where the answer to a request for the ownership goes, and where its guard comes: one that nobody takes any more is dropped, which
/// gives the token back.
pub(super) fn owning(member: &Membership) -> (AnswerTo, Answered<TokenGuard>) {
    let (sender, receiver) = oneshot::channel();
    let member = member.clone();
    let take = |id, answer| drop(sender.send(granted(member, id, answer)));
    (AnswerTo::taker(take), receiver)
}

/// The same for a part in a shared hold.
pub(super) fn inhibiting(member: &Membership) -> (AnswerTo, Answered<InhibitGuard>) {
    let (sender, receiver) = oneshot::channel();
    let member = member.clone();
    let take = |_, answer| drop(sender.send(inhibited(member, answer)));
    (AnswerTo::taker(take), receiver)
}

fn granted(member: Membership, id: Option<u64>, answer: RequestResult) -> Result<TokenGuard, ClientError> {
    let (shared, path) = (member.shared(), member.path());
    let granted =
        answer.and_then(|parcel| GrantTerms::read(&map_of(&parcel)).ok_or_else(|| bad_reply("fence")));
    let mut state = shared.lock();
    let withdrawn = id.is_some_and(|id| state.waits.answered(path, id));
    let hold = match granted {
        // The grant is released already: the hub was told while it was on its way.
        Ok(_) if withdrawn => Err(ClientError::Connection("the grab was taken back".to_owned())),
        Ok(grant) => Ok(state.guards.hold(path, grant, Instant::now())),
        Err(error) => Err(error),
    };
    shared.answered(state, HoldingKind::Ownership, path);
    hold.map(|hold| TokenGuard::new(hold, member))
}

fn inhibited(member: Membership, answer: RequestResult) -> Result<InhibitGuard, ClientError> {
    let (shared, path) = (member.shared(), member.path());
    let mut state = shared.lock();
    let hold = answer.map(|_| state.inhibits.hold(path, GrantTerms::default(), Instant::now()));
    shared.answered(state, HoldingKind::Shared, path);
    hold.map(|hold| InhibitGuard::new(hold, member))
}

impl Shared {
    /// Sends a request that may be answered with an ownership.
    pub(crate) fn obtain(&self, parcel: Parcel, waiter: AnswerTo) -> Result<(), ClientError> {
        self.begin(parcel, waiter, HoldingKind::Ownership, |_| ())
    }

    /// Sends a grab that may wait in the queue; gives its places there.
    pub(crate) fn obtain_waiting(
        &self,
        parcel: Parcel,
        id: u64,
        waiter: AnswerTo,
    ) -> Result<watch::Receiver<Option<Place>>, ClientError> {
        let path = parcel.context.clone().unwrap_or_else(Path::root);
        self.begin(parcel, waiter, HoldingKind::Ownership, |state| {
            state.waits.add(&path, id)
        })
    }

    /// Sends a request that may be answered with a part in a shared hold.
    pub(crate) fn inhibit(&self, parcel: Parcel, waiter: AnswerTo) -> Result<(), ClientError> {
        self.begin(parcel, waiter, HoldingKind::Shared, |_| ())
    }

    fn begin<T>(
        &self,
        parcel: Parcel,
        waiter: AnswerTo,
        kind: HoldingKind,
        note: impl FnOnce(&mut State) -> T,
    ) -> Result<T, ClientError> {
        let path = parcel.context.clone().unwrap_or_else(Path::root);
        // The waiter may hold the last handle: on an error it is dropped after the lock is given back.
        let mut waiter = Some(waiter);
        let mut state = self.lock();
        let asked = self.ask_in(&mut state, parcel, &mut waiter);
        let noted = asked.map(|()| {
            state.holds(kind).ask(&path);
            note(&mut state)
        });
        drop(state);
        self.outgoing.notify_one();
        noted
    }

    /// Waits for an answer.
    pub(crate) async fn answer<T>(&self, receiver: Answered<T>, what: String) -> Result<T, ClientError> {
        self.late_answer(receiver, Duration::ZERO, what).await
    }

    /// Waits for an answer that may come later than others by this time.
    pub(crate) async fn late_answer<T>(
        &self,
        receiver: Answered<T>,
        later: Duration,
        what: String,
    ) -> Result<T, ClientError> {
        let after = self.settings.request_timeout.saturating_add(later);
        match timeout(after, receiver).await {
            Ok(Ok(answer)) => answer,
            Ok(Err(_)) => Err(ClientError::Connection("the link was lost".to_owned())),
            Err(_) => Err(ClientError::TimedOut { what, after }),
        }
    }

    /// The caller of a grab is gone.
    pub(crate) fn give_up(&self, path: &Path, id: u64) {
        let mut state = self.lock();
        if state.waits.give_up(path, id) {
            self.end_in(&mut state, HoldingKind::Ownership, path, None);
        }
        drop(state);
        self.outgoing.notify_one();
    }

    /// Ends a hold and waits for the hub to say so.
    pub(crate) async fn release(&self, hold: &Arc<Hold>, kind: HoldingKind) -> Result<(), ClientError> {
        let lost = hold.is_lost();
        self.lock().holds(kind).let_go(hold);
        match lost {
            true => Ok(()),
            false => self.request(kind.end(&hold.path, hold.fence())).await.map(drop),
        }
    }

    /// Waits until the hub has taken or refused all messages that were said under an ownership, as it takes what a peer says in
    /// order.
    ///
    /// # Errors
    /// `TimedOut` if that takes longer; a lost link.
    pub(crate) async fn answer_of_all(&self, hold: &Hold, most: Duration) -> Result<(), ClientError> {
        if hold.is_lost() {
            return Ok(());
        }
        let (sender, receiver) = oneshot::channel();
        let mut waiter = Some(AnswerTo::Caller(sender));
        let renew = verb(Family::Token, "renew", &hold.path);
        let asked = self.ask_behind(&mut self.lock(), renew, &mut waiter, Follows::Token);
        self.outgoing.notify_one();
        asked?;
        match timeout(most, receiver).await {
            Err(_) => Err(ClientError::TimedOut {
                what: format!("what was said under {}", hold.path),
                after: most,
            }),
            // Why nobody answers, or that the token is lost, is what the release says, too.
            Ok(_) => Ok(()),
        }
    }

    /// Ends a hold, if this was its last guard, without waiting.
    pub(crate) fn let_go(&self, hold: &Arc<Hold>, kind: HoldingKind) {
        let mut state = self.lock();
        if state.holds(kind).let_go(hold) {
            self.end_in(&mut state, kind, &hold.path, hold.fence());
        }
        drop(state);
        self.outgoing.notify_one();
    }

    /// Nobody waits any more for a token's return.
    pub(crate) fn forget(&self, handover: &Arc<Handover>) {
        self.lock().handovers.unwant(handover);
        if let HandoverPhase::Back(hold) = handover.phase() {
            self.let_go(&hold, HoldingKind::Ownership);
        }
    }

    /// A request for a hold was answered.
    fn answered(&self, mut state: MutexGuard<'_, State>, kind: HoldingKind, path: &Path) {
        if let Some(hold) = state.holds(kind).answered(path) {
            self.end_in(&mut state, kind, path, hold.fence());
        }
        drop(state);
        self.outgoing.notify_one();
        self.keeping.notify_one();
    }
}
