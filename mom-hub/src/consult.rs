//! Asking the manager of a context (M24).

use std::time::Duration;

use mom_managers::{Answer, Denial, Grant, Micros, Owner, PeerFacts, Question, TokenFacts, Verdict};
use mom_proto::{Code, ContextKind, ContextNumber, Path, Verb, WireError};

use crate::admit::refusal;
use crate::context::Context;
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
        }
    }
}

impl Hub {
    /// Asks whether a peer may; a refusal comes explained.
    pub(crate) fn ask(&mut self, peer: PeerId, wish: &Wish<'_>) -> Result<Grant, WireError> {
        match self.consult(peer, wish).answer {
            Answer::Allow(grant) => Ok(grant),
            Answer::Deny(denial) => Err(self.explain(peer, wish, &denial)),
            Answer::Queue(wait) => Err(self.explain(peer, wish, &wait.denial)),
            Answer::Defer(defer) => {
                Err(WireError::new(Code::DENIED, "nobody can be asked").rule(&defer.label))
            }
        }
    }

    /// The verdict of the manager of `wish.at`, or of the nearest one above that has one.
    pub(crate) fn consult(&mut self, peer: PeerId, wish: &Wish<'_>) -> Verdict {
        let nobody = || {
            Verdict::deny(
                Code::DENIED,
                "no manager",
                "nobody manages this context, so it is closed",
            )
        };
        let Some(facts) = self.peers.get(peer).map(|peer| peer.facts.clone()) else {
            return nobody();
        };
        let Some(managing) = self.managing(wish.at) else {
            return nobody();
        };
        let now = self.now;
        // Taken out while it is asked, because the question borrows the tree.
        let Some(mut manager) = self
            .tree
            .get_mut(managing)
            .and_then(|context| context.manager.take())
        else {
            return nobody();
        };
        let verdict = match self.tree.get(wish.at) {
            Some(context) => manager.decide(&Question {
                peer: &facts,
                verb: wish.verb,
                context: wish.path.unwrap_or(&context.path),
                kind: wish.kind.unwrap_or(context.kind()),
                message: wish.message,
                size: wish.size,
                age: None,
                token: self.token_facts(context, peer),
                invited: false,
                created: false,
                answers: &[],
                now,
                wall: self.wall(),
            }),
            None => nobody(),
        };
        if let Some(context) = self.tree.get_mut(managing) {
            context.manager = Some(manager);
        }
        verdict
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
        let ownership = match &context.token()?.owner {
            Some(ownership) => ownership,
            None => return Some(TokenFacts::default()),
        };
        let facts = &self.peers.get(ownership.peer)?.facts;
        Some(TokenFacts {
            owner: Some(Owner {
                name: &facts.name,
                user: &facts.user,
                groups: &facts.groups,
                level: facts.level,
                asks: ownership.peer == asks,
            }),
            lease_end: ownership.lease_end,
            since: ownership.since,
            waiting: 0,
        })
    }

    /// A refusal with all that helps: rule, owner, both levels, when to try again (M29).
    fn explain(&self, peer: PeerId, wish: &Wish<'_>, denial: &Denial) -> WireError {
        let Some(asked) = self.peers.get(peer).map(|peer| &peer.facts) else {
            return WireError::new(denial.code.clone(), denial.text.as_str());
        };
        let error = refusal(denial, asked, self.now);
        match self
            .tree
            .get(wish.at)
            .and_then(|context| self.token_facts(context, peer))
        {
            Some(TokenFacts {
                owner: Some(owner),
                lease_end,
                ..
            }) if denial.code == Code::HELD => held(error, &owner, lease_end, asked, self.now),
            _ => error,
        }
    }

    /// The refusal of a grab that no manager denied but that takes nothing from a living owner.
    pub(crate) fn held(&self, peer: PeerId, token: ContextNumber) -> WireError {
        let denial = Denial {
            code: Code::HELD,
            text: self
                .tree
                .get(token)
                .map(|context| format!("{} is held", context.path))
                .unwrap_or_default(),
            rule: "one owner at most".to_owned(),
            earliest: self
                .tree
                .get(token)
                .and_then(|context| context.token()?.owner.as_ref()?.lease_end),
        };
        self.explain(peer, &Wish::new(Verb::Grab, token), &denial)
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
