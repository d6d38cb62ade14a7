//! Gaining, renewing and losing a token.

use mom_proto::{Fence, Micros};
use std::sync::Arc;

use mom_managers::Expiry;
use mom_proto::event::Reason;

use super::state::{Change, Delegation, Ownership, Token};
use crate::PeerId;

/// A new owner, and what its ownership depends on.
#[derive(Clone, Debug)]
pub(crate) struct Grantee {
    pub(crate) peer: PeerId,
    /// When it ends, whatever the lease.
    pub(crate) until: Option<Micros>,
    pub(crate) delegation: Option<Delegation>,
    /// The rule that allowed it.
    pub(crate) rule: Option<Arc<str>>,
    /// The beginning of the turn that it continues.
    pub(crate) turn: Option<Micros>,
}

impl Grantee {
    /// A new owner on the terms of the token alone.
    pub(crate) fn plain(peer: PeerId) -> Grantee {
        Grantee {
            peer,
            until: None,
            delegation: None,
            rule: None,
            turn: None,
        }
    }
}

/// What a change of owner has ended.
pub(crate) struct Former {
    pub(crate) ownership: Ownership,
    pub(crate) fence: Fence,
}

/// What follows from the end of an ownership.
pub(crate) struct Ending {
    /// Why it ends, in the words of the wire.
    pub(crate) reason: Reason,
    /// The giver to whom the token returns, if that manager lets it.
    pub(crate) giver: Option<PeerId>,
    /// The turn that a return continues, and the end of the giver's own right.
    pub(crate) turn: Micros,
    pub(crate) until: Option<Micros>,
}

/// Why a change of owner that was decided cannot be carried out any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Overtaken {
    /// The owner who agreed is the owner no more.
    Moved,
    /// Several peers hold the token together meanwhile.
    Shared,
}

impl Token {
    /// The end of a lease that begins now.
    pub(crate) fn lease_from(&self, now: Micros) -> Option<Micros> {
        self.terms.lease.map(|lease| now.saturating_add(lease))
    }

    fn deadman_from(&self, now: Micros) -> Option<Micros> {
        self.terms.deadman.map(|deadman| now.saturating_add(deadman))
    }

    /// Whether the owner's lease is over, so that the next grab takes the token.
    pub(crate) fn lapsed(&self, now: Micros) -> bool {
        self.owner
            .as_ref()
            .and_then(|owner| owner.lease_end)
            .is_some_and(|end| now >= end)
    }

    /// When the hub has to end the ownership by itself.
    pub(crate) fn deadline(&self) -> Option<Micros> {
        let owner = self.owner.as_ref()?;
        let lease = owner
            .lease_end
            .filter(|_| self.terms.expiry == Expiry::Eager || !self.queue.is_empty());
        let delegated = owner.delegation.as_ref();
        let ends = [
            lease,
            owner.alive_until,
            owner.until,
            self.hold_end(),
            delegated.and_then(|delegation| delegation.until),
            delegated.and_then(|delegation| delegation.return_at),
        ];
        ends.into_iter().flatten().min()
    }

    /// Why the ownership ends at its deadline.
    pub(crate) fn reason_at_deadline(&self, now: Micros) -> Reason {
        let over = |at: Option<Micros>| at.is_some_and(|at| now >= at);
        let delegation = self.owner.as_ref().and_then(|owner| owner.delegation.as_ref());
        match delegation.is_some_and(|given| over(given.until) || over(given.return_at)) {
            true => Reason::Returned,
            false => Reason::Expired,
        }
    }

    /// The peer for which the ownership ends at its deadline: the first of those without whom it would go on.
    pub(crate) fn waited_for(&self, now: Micros) -> Option<PeerId> {
        let over = |at: Option<Micros>| at.is_some_and(|at| now >= at);
        let lease = self.owner.as_ref()?.lease_end;
        let lapsed = self.terms.expiry == Expiry::Lazy && over(lease);
        let first = self.queue.first().map(|waiter| waiter.peer);
        first.filter(|_| lapsed || over(self.hold_end()))
    }

    /// Puts another owner, or none, in the place of the present one. A grant raises the fence above `floor`.
    pub(crate) fn change_owner(&mut self, to: Option<Grantee>, now: Micros, floor: Fence) -> Option<Former> {
        let fence = self.fence;
        let old = self.owner.take();
        if let Some(grantee) = to {
            self.fence = self.fence.max(floor).next();
            self.reserved = None;
            self.owner = Some(Ownership {
                peer: grantee.peer,
                since: now,
                turn: grantee.turn.unwrap_or(now),
                lease: self.terms.lease,
                lease_end: self.lease_from(now),
                alive_until: self.deadman_from(now),
                until: grantee.until,
                noticed: None,
                delegation: grantee.delegation,
                halts: 0,
            });
        }
        old.map(|ownership| Former { ownership, fence })
    }

    /// Begins a new lease for the owner.
    pub(crate) fn renew(&mut self, now: Micros) {
        let (lease, end) = (self.terms.lease, self.lease_from(now));
        let alive_until = self.deadman_from(now);
        if let Some(owner) = &mut self.owner {
            owner.lease = lease;
            owner.lease_end = end;
            owner.alive_until = alive_until;
        }
    }

    /// Takes over the terms and the safe state of a new configuration; whether the terms are others.
    ///
    /// A new deadman time holds for the owner of now too; a new lease begins with the next renewal.
    pub(crate) fn take_terms(&mut self, new: Token, now: Micros) -> bool {
        let (changed, deadman) = (self.terms != new.terms, self.terms.deadman != new.terms.deadman);
        self.terms = new.terms;
        self.safe = new.safe;
        self.safe_on_give = new.safe_on_give;
        self.stop_ends_grant = new.stop_ends_grant;
        let alive_until = self.deadman_from(now);
        if let Some(owner) = self.owner.as_mut().filter(|_| deadman) {
            owner.alive_until = alive_until;
        }
        changed
    }

    /// What follows if the ownership ends now for this reason; none if there is no owner.
    pub(crate) fn ending(&self, reason: Reason, now: Micros) -> Option<Ending> {
        let owner = self.owner.as_ref()?;
        let until = owner.delegation.as_ref().and_then(|lent| lent.giver_until);
        let giver = self.giver();
        let returns = !matches!(reason, Reason::Deleted | Reason::Broken | Reason::Preempted);
        let over = until.is_some_and(|until| now >= until);
        Some(Ending {
            // A delegate that gives the token back does what was agreed.
            reason: match reason {
                Reason::Released if giver.is_some() => Reason::Returned,
                reason => reason,
            },
            giver: giver.filter(|_| returns && !over),
            turn: owner.turn,
            until,
        })
    }

    /// Why a change that was decided before cannot be carried out any more.
    pub(crate) fn overtaken(&self, change: &Change) -> Option<Overtaken> {
        if change.from.is_some() && change.from != self.owner_peer() {
            return Some(Overtaken::Moved);
        }
        (!self.holders.is_empty()).then_some(Overtaken::Shared)
    }

    /// The new owner of a change, as the token stands now.
    pub(crate) fn grantee(&self, change: &Change, now: Micros) -> Grantee {
        let owner = self.owner.as_ref();
        let given = change
            .given
            .filter(|(time, commands)| time.is_some() || commands.is_some());
        let delegation = given.zip(owner).map(|((time, commands), giver)| Delegation {
            from: Some(giver.peer),
            giver_until: giver.until,
            until: time.map(|time| now.saturating_add(time)),
            commands,
            return_at: None,
        });
        Grantee {
            peer: change.to,
            until: change.until,
            delegation,
            rule: change.rule.clone(),
            turn: match change.reason {
                Reason::Given => owner.map(|owner| owner.turn),
                _ => change.turn,
            },
        }
    }

    /// Counts one command of an owner that has only so many; the token returns at `return_at` after the last one.
    pub(crate) fn count_command(&mut self, return_at: Micros) {
        let owner = self.owner.as_mut();
        if let Some(delegation) = owner.and_then(|owner| owner.delegation.as_mut()) {
            let left = delegation.commands.map(|left| left.saturating_sub(1));
            delegation.commands = left;
            if left == Some(0) {
                delegation.return_at = Some(return_at);
            }
        }
    }

    /// Calls off the change under way if it is one to this peer.
    pub(crate) fn call_off_for(&mut self, peer: PeerId) -> Option<Change> {
        if self.promised() != Some(peer) {
            return None;
        }
        self.granting.as_mut()?.change.take()
    }

    /// Forgets a giver that has left; whether it was this one.
    pub(crate) fn forget_giver(&mut self, peer: PeerId) -> bool {
        let owner = self.owner.as_mut();
        let lent = owner.and_then(|owner| owner.delegation.as_mut());
        match lent.filter(|delegation| delegation.from == Some(peer)) {
            Some(delegation) => {
                delegation.from = None;
                true
            }
            None => false,
        }
    }
}
