//! Asking the manager of a context (M24).

use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::Duration;

use mom_managers::{
    Answer, Defer, Denial, GivenAnswer, Grant, Micros, Owner, PeerFacts, Question, TokenFacts, Verdict,
};
use mom_proto::{Code, ContextKind, ContextNumber, Path, Verb, WireError};

use crate::admit::refusal;
use crate::age::Aged;
use crate::context::Context;
use crate::ownership::{fence_value, millis};
use crate::pending::{Deferred, Refusal};
use crate::token::Token;
use crate::waiting::{Turns, place_of};
use crate::{Hub, PeerId};

/// What a request wants, for the manager's question.
pub(crate) struct Wish<'a> {
    pub(crate) verb: Verb,
    /// The context whose manager is asked.
    pub(crate) at: ContextNumber,
    /// The path acted on, where it is not that context's own.
    pub(crate) path: Option<&'a Path>,
    pub(crate) kind: Option<ContextKind>,
    pub(crate) message: Option<&'a str>,
    pub(crate) size: usize,
    /// The age of the message and its error, µs, where they are known.
    pub(crate) age: Option<Aged>,
}

impl Wish<'_> {
    pub(crate) fn new(verb: Verb, at: ContextNumber) -> Wish<'static> {
        Wish {
            verb,
            at,
            path: None,
            kind: None,
            message: None,
            size: 0,
            age: None,
        }
    }
}

/// Why a manager allowed, for the audit.
#[derive(Clone, Debug, Default)]
pub(crate) struct Allowed {
    pub(crate) grant: Grant,
    pub(crate) rule: Option<Arc<str>>,
}

impl Hub {
    /// Asks whether a peer may; a refusal comes explained. Nobody is refused giving up what it has.
    pub(crate) fn ask(&mut self, peer: PeerId, wish: &Wish<'_>) -> Result<Allowed, Refusal> {
        // Not even by a manager that fails, or has to ask.
        if wish.verb.gives_up() {
            return Ok(Allowed::default());
        }
        let verdict = self.consult(peer, wish);
        match verdict.answer {
            Answer::Allow(grant) => Ok(Allowed {
                grant,
                rule: verdict.rule,
            }),
            Answer::Deny(denial) => Err(self.explain(peer, wish, &denial).into()),
            Answer::Queue(wait) => Err(self.explain(peer, wish, &wait.denial).into()),
            Answer::Defer(defer) => Err(self.defer(peer, wish, defer, verdict.rule)),
        }
    }

    /// What has to be asked before a request can be decided.
    pub(crate) fn defer(
        &self,
        peer: PeerId,
        wish: &Wish<'_>,
        defer: Defer,
        rule: Option<Arc<str>>,
    ) -> Refusal {
        let managing = self.managing(wish.at);
        let (Some(context), Some(managing)) = (self.tree.get(wish.at), managing) else {
            let text = "nobody manages this context, so it is closed";
            return WireError::new(Code::DENIED, text).rule(&defer.label).into();
        };
        debug_assert!(self.peers.get(peer).is_some(), "who asks is there");
        Refusal::Defer(Box::new(Deferred {
            rule: rule.unwrap_or_else(|| Arc::clone(&defer.label)),
            defer,
            peer,
            verb: wish.verb,
            managing,
            at: wish.at,
            path: wish.path.unwrap_or(&context.path).clone(),
            message: wish.message.map(str::to_owned),
            size: wish.size,
            age: wish.age,
            kind: wish.kind.unwrap_or(context.kind()).word(),
        }))
    }

    /// The verdict of the manager of `wish.at`, or of the nearest one above that has one.
    pub(crate) fn consult(&mut self, peer: PeerId, wish: &Wish<'_>) -> Verdict {
        let Some(facts) = self.peers.get(peer).map(|peer| peer.facts.clone()) else {
            return nobody();
        };
        let Some(managing) = self.managing(wish.at) else {
            return nobody();
        };
        // Taken out while it is asked, because the question borrows the tree.
        let Some(mut manager) = self
            .tree
            .get_mut(managing)
            .and_then(|context| context.manager.take())
        else {
            return nobody();
        };
        let mine = self
            .answers
            .iter()
            .filter(|heard| heard.peer == peer && heard.verb == wish.verb && heard.at == wish.at);
        let answers: Vec<GivenAnswer> = mine.map(|heard| heard.given.clone()).collect();
        let verdict = match self.question(managing, peer, &facts, &answers, wish) {
            // A manager of somebody else's making that panics must not end the hub, nor let anybody in.
            Some(question) => std::panic::catch_unwind(AssertUnwindSafe(|| manager.decide(&question)))
                .unwrap_or_else(|_| {
                    let text = "the manager of this context failed, so nobody may";
                    Verdict::deny(Code::DENIED, "failed manager", text)
                }),
            None => nobody(),
        };
        if let Some(context) = self.tree.get_mut(managing) {
            context.manager = Some(manager);
        }
        verdict
    }

    fn question<'a>(
        &'a self,
        managing: ContextNumber,
        peer: PeerId,
        facts: &'a PeerFacts,
        answers: &'a [GivenAnswer],
        wish: &'a Wish<'_>,
    ) -> Option<Question<'a>> {
        let context = self.tree.get(wish.at)?;
        // Who came in by an invitation needs no other to stay.
        let invited = context.members.contains_key(&peer)
            || context.invited.get(&peer).is_some_and(|until| self.now < *until);
        let creator = self.tree.get(managing).and_then(|managing| managing.creator);
        Some(Question {
            peer: facts,
            verb: wish.verb,
            context: wish.path.unwrap_or(&context.path),
            kind: wish.kind.unwrap_or(context.kind()),
            message: wish.message,
            size: wish.size,
            age: wish.age,
            token: self.token_facts(context, peer),
            invited,
            created: creator == Some(peer),
            answers,
            repeated: !self.answers.is_empty(),
            now: self.now,
            wall: self.wall(),
        })
    }

    /// The context whose manager decides for this one.
    pub(crate) fn managing(&self, at: ContextNumber) -> Option<ContextNumber> {
        let mut context = self.tree.get(at)?;
        while context.manager.is_none() {
            context = self.tree.get(context.parent?)?;
        }
        Some(context.number)
    }

    fn token_facts<'a>(&'a self, context: &'a Context, asks: PeerId) -> Option<TokenFacts<'a>> {
        let token = context.token()?;
        let others = token.queue.iter().filter(|waiter| waiter.peer != asks);
        let mut facts = TokenFacts {
            waiting: others.count(),
            ..TokenFacts::default()
        };
        let Some(ownership) = &token.owner else {
            return Some(facts);
        };
        // Who was given it for a while has it on behalf of the giver.
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
            return WireError::new(denial.code.clone(), denial.text.as_str());
        };
        let error = refusal(denial, asked, self.now);
        let context = self.tree.get(wish.at);
        let token = context.and_then(|context| context.token());
        match (context, token) {
            (Some(context), Some(token)) if denial.code == Code::HELD => {
                let error = self.with_place(error, token, peer);
                match self.token_facts(context, peer) {
                    Some(TokenFacts {
                        owner: Some(owner),
                        lease_end,
                        ..
                    }) => held(error, &owner, lease_end, asked, self.now),
                    _ => error,
                }
            }
            _ => error,
        }
    }

    /// Adds the place in the queue that the peer has, or would have.
    fn with_place(&self, error: WireError, token: &Token, peer: PeerId) -> WireError {
        let level = self.peers.get(peer).map_or(0, |peer| peer.facts.level);
        let index = place_of(token, peer).unwrap_or_else(|| token.place_for(level));
        let error = error.detail("place", fence_value(index as u64 + 1));
        match Turns::of(token, self.now).expected(index) {
            Some(expected) => error.detail("expected", millis(expected)),
            None => error,
        }
    }

    /// The refusal of a grab that no manager denied but that takes nothing from who holds the token.
    pub(crate) fn held(&self, peer: PeerId, token: ContextNumber) -> WireError {
        let context = self.tree.get(token);
        let path = context
            .map(|context| context.path.to_string())
            .unwrap_or_default();
        let found = context.and_then(|context| context.token());
        let holders = self.holders_value(token);
        let kept = found.and_then(|found| self.kept_by_restart(found, peer));
        let (rule, text) = match (holders.is_empty(), kept) {
            (false, _) => (
                "shared hold",
                format!("{path} is inhibited: as long as somebody holds it so, nobody owns it"),
            ),
            (true, Some(_)) => (
                "restart",
                format!("{path} waits for who owned it before the hub was started anew"),
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

fn nobody() -> Verdict {
    Verdict::deny(
        Code::DENIED,
        "no manager",
        "nobody manages this context, so it is closed",
    )
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
            left.as_millis().div_ceil(1000),
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
