//! The effects of events and losses on tokens that are held, asked for and offered.

use mom_proto::event as names;
use mom_proto::{Family, Map, Parcel, Path};
use tokio::time::Instant;

use crate::peer::guards::Guards;
use crate::peer::handover::Handover;
use crate::peer::pending::AnswerTo;
use crate::peer::shared::{Shared, verb};
use crate::peer::state::State;
use crate::said::ownership::GrantTerms;
use crate::words::{map_of, millis_of, number, text};
use crate::{Lost, Place};

/// How a token is held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum HoldingKind {
    /// By one peer, which drives.
    Ownership,
    /// By several, so that nobody drives.
    Shared,
}

impl HoldingKind {
    /// The request that ends it, for the ownership with this fence if it is known: then it cannot end a later one.
    pub(crate) fn end(self, path: &Path, fence: Option<u64>) -> Parcel {
        let name = match self {
            HoldingKind::Ownership => "release",
            HoldingKind::Shared => "uninhibit",
        };
        let mut parcel = verb(Family::Token, name, path);
        parcel.fence = fence;
        parcel
    }
}

impl Shared {
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
