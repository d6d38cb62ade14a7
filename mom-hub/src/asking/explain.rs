//! Refusals with all that helps the refused peer (M29).

use std::time::Duration;

use mom_managers::{Denial, Owner, PeerFacts, TokenFacts};
use mom_proto::{Code, ContextNumber, Micros, Verb, WireError};

use super::wish::Wish;
use crate::PeerId;
use crate::messages::admit::refusal;
use crate::token::queue::Turns;
use crate::token::state::Token;
use crate::tree::context::Context;
use crate::values::{count, millis};
use crate::world::World;

impl World {
    /// What managers are told of a token; none for other contexts.
    pub(super) fn token_facts<'a>(&'a self, context: &'a Context, asks: PeerId) -> Option<TokenFacts<'a>> {
        let token = context.token()?;
        let others = token.queue.iter().filter(|waiter| waiter.peer != asks);
        let mut facts = TokenFacts {
            waiting: others.count(),
            ..TokenFacts::default()
        };
        let Some(ownership) = &token.owner else {
            return Some(facts);
        };
        // A delegate has it on behalf of the giver.
        let giver = token.giver();
        let peer = self.peers.get(ownership.peer)?;
        let principal = giver.and_then(|giver| self.peers.get(giver)).unwrap_or(peer);
        facts.owner = Some(Owner {
            name: &peer.facts.name,
            user: &principal.facts.user,
            groups: &principal.facts.groups,
            level: self.owner_level(token)?,
            asks: ownership.peer == asks,
        });
        facts.lease_end = ownership.lease_end;
        facts.since = ownership.since;
        Some(facts)
    }

    /// A refusal with all that helps: rule, owner, both levels, when to try again, the place in the queue (M29).
    pub(crate) fn explain(&self, peer: PeerId, wish: &Wish<'_>, denial: &Denial) -> WireError {
        let Some(asked) = self.peers.get(peer).map(|peer| &peer.facts) else {
            self.fault::<()>("explaining a refusal to a peer that does not exist");
            return WireError::new(denial.code.clone(), denial.text.as_str());
        };
        let error = refusal(denial, asked, self.now);
        let context = self.tree.get(wish.at);
        match (context, self.token(wish.at)) {
            (Some(context), Some(token)) if denial.code == Code::HELD => {
                let error = self.with_place(error, token, peer);
                let error = match self.token_facts(context, peer) {
                    Some(TokenFacts {
                        owner: Some(owner),
                        lease_end,
                        ..
                    }) => held(error, &owner, lease_end, asked, self.now),
                    _ => error,
                };
                self.with_loss(error, token)
            }
            _ => error,
        }
    }

    /// Adds until when an owner may come back that has lost its connection, if its lease is not over before.
    fn with_loss(&self, mut error: WireError, token: &Token) -> WireError {
        let owner = token.owner.as_ref();
        let lost = owner.and_then(|owner| Some((owner, self.lost_until(owner.peer)?)));
        let Some((owner, until)) = lost else {
            return error;
        };
        let free = owner.lease_end.map_or(until, |lease| lease.min(until));
        let left = Duration::from_micros(free.saturating_sub(self.now));
        error.text = format!(
            "{}; its connection is lost, and it may come back for {} s",
            error.text,
            until.saturating_sub(self.now).div_ceil(1_000_000)
        );
        error
            .retry_after(left)
            .detail("owner-lost", self.millis_until(until))
    }

    /// Adds the place in the queue that the peer has, or would have.
    fn with_place(&self, error: WireError, token: &Token, peer: PeerId) -> WireError {
        let level = self.level_of(peer).unwrap_or_default();
        let index = token.place_of(peer).unwrap_or_else(|| token.place_for(level));
        let error = error.detail("place", count(index + 1));
        match Turns::of(token, self.now).expected(index) {
            Some(expected) => error.detail("expected", millis(expected)),
            None => error,
        }
    }

    /// The refusal of a grab that the manager allows, but not to take the token from its owner or its holders.
    pub(crate) fn held(&self, peer: PeerId, token: ContextNumber) -> WireError {
        let context = self.tree.get(token);
        let path = context
            .map(|context| context.path.to_string())
            .unwrap_or_default();
        let found = context.and_then(|context| context.token());
        let holders = found.map(|found| self.holders_value(found)).unwrap_or_default();
        let kept = found.and_then(|found| self.kept_by_restart(found, peer));
        let (rule, text) = match (holders.is_empty(), kept) {
            (false, _) => (
                "shared hold",
                format!("{path} is inhibited: nobody can own it until every inhibitor releases it"),
            ),
            (true, Some(_)) => (
                "restart",
                format!("{path} is reserved for its owner from before the hub restarted"),
            ),
            (true, None) => {
                let owner = found.and_then(|found| found.owner.as_ref());
                let by = owner.map(|owner| format!(" by {}", self.name_of(owner.peer)));
                let text = format!("{path} is held{}", by.unwrap_or_default());
                ("one owner at most", text)
            }
        };
        let lease_end = found.and_then(|found| found.owner.as_ref()?.lease_end);
        let denial = Denial {
            code: Code::HELD,
            text,
            rule: rule.to_owned(),
            earliest: kept.or(lease_end),
        };
        let error = self.explain(peer, &Wish::new(Verb::Grab, token), &denial);
        match holders.is_empty() {
            true => error,
            false => error.detail("holders", holders),
        }
    }
}

fn held(
    mut error: WireError,
    owner: &Owner<'_>,
    lease_end: Option<Micros>,
    asked: &PeerFacts,
    now: Micros,
) -> WireError {
    let left = lease_end.map(|end| Duration::from_micros(end.saturating_sub(now)));
    let lease = match left {
        Some(left) => format!(
            "the lease ends in {} s unless {} renews it",
            left.as_micros().div_ceil(1_000_000),
            owner.name
        ),
        None => format!("{} holds it without a time limit", owner.name),
    };
    error.text = format!(
        "{} at level {}, yours is {}; {lease}",
        error.text, owner.level, asked.level
    );
    error.owner(owner.name, owner.level)
}
