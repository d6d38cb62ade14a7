//! Tokens that this client has offered to other peers, and their outcomes.

use std::sync::Arc;

use mom_proto::Path;
use mom_proto::event::Reason;
use tokio::sync::watch;

use crate::Lost;
use crate::peer::guards::Hold;

/// One offer, from the hub's confirmation to its end.
#[derive(Debug)]
pub(crate) struct Handover {
    pub(crate) path: Path,
    pub(crate) to: String,
    /// Whether the token comes back by itself.
    pub(crate) delegated: bool,
    /// The ownership that is offered.
    pub(crate) hold: Arc<Hold>,
    phase: watch::Sender<HandoverPhase>,
}

/// How far it has come.
#[derive(Clone, Debug)]
pub(crate) enum HandoverPhase {
    /// The other peer has not answered.
    Offered,
    /// It does not get it, and why.
    Lapsed(String),
    /// It owns the token.
    Taken,
    /// The token has returned: one guard of this ownership.
    Back(Arc<Hold>),
    /// The token does not return.
    Over(Lost),
}

impl Handover {
    pub(crate) fn new(path: &Path, to: String, delegated: bool, hold: Arc<Hold>) -> Handover {
        Handover {
            path: path.clone(),
            to,
            delegated,
            hold,
            phase: watch::Sender::new(HandoverPhase::Offered),
        }
    }

    pub(crate) fn watch(&self) -> watch::Receiver<HandoverPhase> {
        self.phase.subscribe()
    }

    pub(crate) fn phase(&self) -> HandoverPhase {
        self.phase.borrow().clone()
    }

    pub(crate) fn back(&self, hold: Arc<Hold>) {
        self.phase.send_replace(HandoverPhase::Back(hold));
    }

    fn enter(&self, phase: HandoverPhase) {
        self.phase.send_replace(phase);
    }
}

/// All that are not over.
#[derive(Debug, Default)]
pub(crate) struct Handovers {
    entries: Vec<OpenHandover>,
}

#[derive(Debug)]
struct OpenHandover {
    handover: Arc<Handover>,
    stage: HandoverStage,
    /// Whether a caller still needs the token.
    wanted: bool,
}

/// What the hub has reported so far.
#[derive(Debug)]
enum HandoverStage {
    Offered,
    /// This client's ownership is over; the next event names the new owner.
    Leaving,
    /// The other peer owns it with this fence.
    With(u64),
    /// The other peer's ownership is over; the next event names the new owner.
    Ended(u64, Lost),
}

/// The effect of an event on one offer.
enum OfferEvent {
    Keep(HandoverStage),
    End(HandoverPhase),
    Back,
}

impl Handovers {
    pub(crate) fn offer(&mut self, handover: Arc<Handover>) {
        self.entries.push(OpenHandover {
            handover,
            stage: HandoverStage::Offered,
            wanted: true,
        });
    }

    /// Nobody waits any more for the token's return.
    pub(crate) fn unwant(&mut self, handover: &Arc<Handover>) {
        let entries = self.entries.iter_mut();
        entries
            .filter(|entry| Arc::ptr_eq(&entry.handover, handover))
            .for_each(|entry| entry.wanted = false);
    }

    /// The hub said that an offer came to nothing.
    pub(crate) fn lapsed(&mut self, path: &Path, to: &str, reason: &str) {
        // A second offer to the same peer withdraws the first, so the oldest is meant.
        let place = self.entries.iter().position(|entry| {
            entry.handover.path == *path
                && entry.handover.to == to
                && matches!(entry.stage, HandoverStage::Offered)
        });
        if let Some(place) = place {
            let entry = self.entries.remove(place);
            entry.handover.enter(HandoverPhase::Lapsed(reason.to_owned()));
        }
    }

    /// An ownership of this token ended.
    pub(crate) fn released(&mut self, path: &Path, fence: u64, lost: &Lost) {
        self.turn(path, |entry, stage| match stage {
            HandoverStage::Offered if fence == entry.hold.fence => match Reason::from_word(&lost.reason) {
                Some(Reason::Given) => OfferEvent::Keep(HandoverStage::Leaving),
                _ => OfferEvent::End(HandoverPhase::Lapsed("lost".to_owned())),
            },
            HandoverStage::With(theirs) if fence == theirs => match Reason::from_word(&lost.reason) {
                Some(Reason::Preempted | Reason::Broken | Reason::Deleted) => {
                    OfferEvent::End(HandoverPhase::Over(lost.clone()))
                }
                // However else the other's ownership ends, the token comes back.
                _ => OfferEvent::Keep(HandoverStage::Ended(theirs, lost.clone())),
            },
            stage => OfferEvent::Keep(stage),
        });
    }

    /// The token has a new owner. Gives the offer after which it is this client's again, and whether anybody wants
    /// it: the caller notes the ownership.
    pub(crate) fn grabbed(
        &mut self,
        path: &Path,
        fence: u64,
        owner: &str,
        me: &str,
    ) -> Option<(Arc<Handover>, bool)> {
        self.turn(path, |entry, stage| match stage {
            HandoverStage::Leaving if owner == entry.to && entry.delegated => {
                entry.enter(HandoverPhase::Taken);
                OfferEvent::Keep(HandoverStage::With(fence))
            }
            HandoverStage::Leaving if owner == entry.to => {
                let lost = Lost::new(Reason::Given.word(), Some(owner.to_owned()));
                OfferEvent::End(HandoverPhase::Over(lost))
            }
            HandoverStage::Leaving => OfferEvent::End(HandoverPhase::Lapsed("lost".to_owned())),
            HandoverStage::With(theirs) | HandoverStage::Ended(theirs, _)
                if owner == me && fence > theirs =>
            {
                OfferEvent::Back
            }
            HandoverStage::With(theirs) if fence > theirs => {
                OfferEvent::End(HandoverPhase::Over(Lost::new("grabbed", Some(owner.to_owned()))))
            }
            HandoverStage::Ended(theirs, lost) if fence > theirs => {
                OfferEvent::End(HandoverPhase::Over(lost))
            }
            stage => OfferEvent::Keep(stage),
        })
    }

    /// The link is gone, and this client's part in all of them with it.
    pub(crate) fn lose_all(&mut self, lost: &Lost) {
        for entry in self.entries.drain(..) {
            entry.handover.enter(match entry.stage {
                HandoverStage::Offered => HandoverPhase::Lapsed(lost.reason.clone()),
                _ => HandoverPhase::Over(lost.clone()),
            });
        }
    }

    /// The same for the tokens within a path: who is not there any more hears nothing of them.
    pub(crate) fn lose_within(&mut self, top: &Path, lost: &Lost) {
        let (within, others) = std::mem::take(&mut self.entries)
            .into_iter()
            .partition(|entry| entry.handover.path.is_within(top));
        self.entries = within;
        self.lose_all(lost);
        self.entries = others;
    }

    /// Applies an event to each offer of a token; gives the one whose token has returned.
    fn turn(
        &mut self,
        path: &Path,
        turn: impl Fn(&Handover, HandoverStage) -> OfferEvent,
    ) -> Option<(Arc<Handover>, bool)> {
        let mut back = None;
        for entry in std::mem::take(&mut self.entries) {
            let OpenHandover {
                handover,
                stage,
                wanted,
            } = entry;
            if handover.path != *path {
                self.entries.push(OpenHandover {
                    handover,
                    stage,
                    wanted,
                });
                continue;
            }
            match turn(&handover, stage) {
                OfferEvent::Keep(stage) => self.entries.push(OpenHandover {
                    handover,
                    stage,
                    wanted,
                }),
                OfferEvent::End(phase) => handover.enter(phase),
                OfferEvent::Back => back = Some((handover, wanted)),
            }
        }
        back
    }
}
