//! Grabbing and releasing tokens, and the effects of events and answers on those that are held.

use std::sync::Arc;
use std::time::Duration;

use mom_proto::event as names;
use mom_proto::{Family, Map, Parcel, Path};
use tokio::sync::{oneshot, watch};
use tokio::time::{Instant, timeout};

use crate::contexts::membership::Membership;
use crate::control::holding::HoldingKind;
use crate::error::bad_reply;
use crate::peer::answers::RequestResult;
use crate::peer::guards::{GrantTerms, Guards, Hold};
use crate::peer::handover::{Handover, HandoverPhase};
use crate::peer::pending::{AnswerTo, Answering};
use crate::peer::shared::{Shared, State, verb};
use crate::said::info::{map_of, millis_of, number, text};
use crate::wire::outbox::Follows;
use crate::{ClientError, Given, InhibitGuard, Lost, Place, TokenGuard};

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
    pub(crate) async fn answer<T>(
        &self,
        receiver: oneshot::Receiver<Result<T, ClientError>>,
        what: String,
    ) -> Result<T, ClientError> {
        self.late_answer(receiver, Duration::ZERO, what).await
    }

    /// Waits for an answer that may come later than others by this time.
    pub(crate) async fn late_answer<T>(
        &self,
        receiver: oneshot::Receiver<Result<T, ClientError>>,
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

    /// Ends a hold without waiting, the one with this fence if it is known.
    pub(crate) fn end_in(&self, state: &mut State, kind: HoldingKind, path: &Path, fence: Option<u64>) {
        // Without a link the token is lost anyway.
        let _ = self.ask_in(state, kind.end(path, fence), &mut Some(AnswerTo::Nobody));
    }

    /// After a loss, says again that grabs are withdrawn: without a fence that was not sent again.
    pub(crate) fn withdraw_again(&self, state: &mut State) {
        for path in state.waits.withdrawn() {
            self.end_in(state, HoldingKind::Ownership, &path, None);
        }
    }

    /// Applies an event about a token's owner.
    pub(crate) fn note_ownership(&self, state: &mut State, path: &Path, parcel: &Parcel) {
        let map = map_of(parcel);
        let Some(fence) = number(&map, "fence") else {
            return;
        };
        if parcel.name() == names::RELEASED {
            let by = text(&map, "by").map(str::to_owned);
            let lost = Lost::new(text(&map, "reason").unwrap_or_default(), by);
            state.handovers.released(path, fence, &lost);
            state.guards.lose(path, fence, lost);
        } else {
            let owner = text(&map, "owner").unwrap_or_default();
            state.guards.outdate(path, fence, owner);
            let me = state.me.peer.clone();
            if let Some((handover, wanted)) = state.handovers.grabbed(path, fence, owner, &me) {
                self.take_back(state, &handover, wanted, &map);
            }
        }
    }

    /// A loan has returned to this client.
    fn take_back(&self, state: &mut State, handover: &Handover, wanted: bool, map: &Map) {
        let Some(grant) = GrantTerms::read(map) else {
            return;
        };
        let hold = state.guards.hold(&handover.path, grant, Instant::now());
        if wanted {
            handover.back(hold);
        } else if state.guards.let_go(&hold) {
            self.end_in(state, HoldingKind::Ownership, &handover.path, hold.fence());
        }
        self.outgoing.notify_one();
        self.keeping.notify_one();
    }

    /// The hub said which place a waiting grab has.
    pub(crate) fn note_place(&self, state: &mut State, path: &Path, parcel: &Parcel) {
        let map = map_of(parcel);
        let Some(place) = number(&map, "place") else {
            return;
        };
        let place = Place {
            place,
            expected: millis_of(&map, "expected"),
        };
        if state.waits.queued(path, place) {
            self.end_in(state, HoldingKind::Ownership, path, None);
            self.outgoing.notify_one();
        }
    }

    /// A request that may bring an ownership was answered.
    pub(crate) fn complete_obtain(
        &self,
        id: Option<u64>,
        member: Membership,
        sender: Answering<TokenGuard>,
        answer: RequestResult,
    ) {
        let path = member.path().clone();
        let granted =
            answer.and_then(|parcel| GrantTerms::read(&map_of(&parcel)).ok_or_else(|| bad_reply("fence")));
        let mut state = self.lock();
        let withdrawn = id.is_some_and(|id| state.waits.answered(&path, id));
        let hold = match granted {
            // The grant is released already: the hub was told while it was on its way.
            Ok(_) if withdrawn => Err(ClientError::Connection("the grab was taken back".to_owned())),
            Ok(grant) => Ok(state.guards.hold(&path, grant, Instant::now())),
            Err(error) => Err(error),
        };
        self.answered(state, HoldingKind::Ownership, &path);
        let guard = hold.map(|hold| TokenGuard::new(hold, member));
        // Dropping the guard of one that went away gives the token back.
        drop(sender.send(guard));
    }

    /// A request for a part in a shared hold was answered.
    pub(crate) fn complete_inhibit(
        &self,
        member: Membership,
        sender: Answering<InhibitGuard>,
        answer: RequestResult,
    ) {
        let path = member.path().clone();
        let mut state = self.lock();
        let hold = answer.map(|_| state.inhibits.hold(&path, GrantTerms::default(), Instant::now()));
        self.answered(state, HoldingKind::Shared, &path);
        let guard = hold.map(|hold| InhibitGuard::new(hold, member));
        // As above.
        drop(sender.send(guard));
    }

    /// An offer was made or refused.
    pub(crate) fn complete_give(
        &self,
        member: Membership,
        handover: Arc<Handover>,
        sender: Answering<Given>,
        answer: RequestResult,
    ) {
        let given = answer.map(|_| {
            self.lock().handovers.offer(Arc::clone(&handover));
            Given::new(handover, member)
        });
        drop(sender.send(given));
    }

    fn answered(&self, mut state: parking_lot::MutexGuard<'_, State>, kind: HoldingKind, path: &Path) {
        if let Some(hold) = state.holds(kind).answered(path) {
            self.end_in(&mut state, kind, path, hold.fence());
        }
        drop(state);
        self.outgoing.notify_one();
        self.keeping.notify_one();
    }
}

impl State {
    /// The holds of a kind.
    pub(crate) fn holds(&mut self, kind: HoldingKind) -> &mut Guards {
        match kind {
            HoldingKind::Ownership => &mut self.guards,
            HoldingKind::Shared => &mut self.inhibits,
        }
    }

    /// All holds are over, and all requests for one.
    pub(crate) fn lose_holds(&mut self, lost: &Lost) {
        self.guards.lose_all(lost);
        self.inhibits.lose_all(lost);
        self.handovers.lose_all(lost);
        self.waits.clear();
    }

    /// A part in a shared hold is over; if it is this client's, its guards are told.
    pub(crate) fn note_uninhibited(&mut self, path: &Path, parcel: &Parcel) {
        let map = map_of(parcel);
        if text(&map, "peer") == Some(self.me.peer.as_str()) {
            let by = text(&map, "by").map(str::to_owned);
            let lost = Lost::new(text(&map, "reason").unwrap_or_default(), by);
            self.inhibits.lose(path, GrantTerms::default().fence, lost);
        }
    }

    /// An offer or a request came to nothing.
    pub(crate) fn note_lapsed(&mut self, path: &Path, parcel: &Parcel) {
        let map = map_of(parcel);
        if text(&map, "what") == Some("offer") && text(&map, "by") == Some(self.me.peer.as_str()) {
            let (to, reason) = (text(&map, "to"), text(&map, "reason"));
            self.handovers
                .lapsed(path, to.unwrap_or_default(), reason.unwrap_or_default());
        }
    }
}
