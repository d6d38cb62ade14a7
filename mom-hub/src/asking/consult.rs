//! Asking the manager of a context (M24).

use std::panic::AssertUnwindSafe;
use std::sync::Arc;

use mom_managers::{
    Answer, Defer, GivenAnswer, Grant, Manager, Owner, PeerFacts, Question, TokenFacts, Tokens, Verdict,
};
use mom_proto::{Code, ContextNumber, Map, Path, Verb, WireError};

use super::refusal::{Deferred, Refusal};
use super::wish::Wish;
use crate::PeerId;
use crate::heard::Heard;
use crate::world::World;

/// Why a manager allowed, for the audit.
#[derive(Clone, Debug, Default)]
pub(crate) struct Allowed {
    pub(crate) grant: Grant,
    pub(crate) rule: Option<Arc<str>>,
}

impl World {
    /// Asks whether a peer may; a refusal comes explained. Nobody is refused giving up what it has.
    ///
    /// `answers` are those that the request has got so far from managing peers and chairs.
    pub(crate) fn ask(
        &mut self,
        peer: PeerId,
        wish: &Wish<'_>,
        answers: &[Heard],
    ) -> Result<Allowed, Refusal> {
        // Not even by a manager that fails, or has to ask.
        if wish.verb.gives_up() {
            return Ok(Allowed::default());
        }
        let verdict = self.consult(peer, wish, answers);
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
        let managing = self.tree.managing(wish.at);
        let (Some(context), Some(managing)) = (self.tree.get(wish.at), managing) else {
            self.fault::<()>("a manager that manages no context asks a question");
            let text = "no manager is set for this context, so it is closed";
            return WireError::new(Code::DENIED, text).rule(&defer.label).into();
        };
        Refusal::Defer(Box::new(Deferred {
            rule: rule.unwrap_or_else(|| Arc::clone(&defer.label)),
            defer,
            peer,
            verb: wish.verb,
            managing: managing.number,
            at: wish.at,
            path: wish.path.unwrap_or(&context.path).clone(),
            message: wish.message.map(str::to_owned),
            size: wish.size,
            age: wish.age,
            kind: wish.kind.unwrap_or(context.kind()).word(),
        }))
    }

    /// Whether a manager denies for good; one that defers, or says later, does not.
    pub(crate) fn refused(&mut self, peer: PeerId, verb: Verb, at: ContextNumber) -> bool {
        let verdict = self.suppose(peer, &Wish::new(verb, at));
        matches!(verdict.answer, Answer::Deny(denial) if !denial.code.may_retry())
    }

    /// The verdict of the manager of `wish.at`, or of the nearest one above that has one.
    pub(crate) fn consult(&mut self, peer: PeerId, wish: &Wish<'_>, answers: &[Heard]) -> Verdict {
        self.consult_again(peer, wish, answers, !answers.is_empty())
    }

    /// The same about a request that nobody makes: no manager counts it, nothing changes.
    pub(crate) fn suppose(&mut self, peer: PeerId, wish: &Wish<'_>) -> Verdict {
        self.consult_again(peer, wish, &[], true)
    }

    fn consult_again(&mut self, peer: PeerId, wish: &Wish<'_>, answers: &[Heard], repeated: bool) -> Verdict {
        let Some(facts) = self.peers.get(peer).map(|peer| Arc::clone(&peer.facts)) else {
            self.fault::<()>("asking a manager about a peer that does not exist");
            return nobody();
        };
        let grants = match answers.is_empty() {
            true => 0,
            false => self.grants_at(wish.at),
        };
        let managing = self.tree.managing(wish.at).map(|context| context.number);
        // Taken out while it is asked, because the question borrows the tree.
        let manager = managing.and_then(|managing| self.tree.get_mut(managing)?.manager.take());
        let (Some(managing), Some(mut manager)) = (managing, manager) else {
            self.fault::<()>("a context has no manager, not even the root's");
            return nobody();
        };
        let mine = answers.iter().filter(|heard| {
            heard.peer == peer && heard.verb == wish.verb && heard.at == wish.at && heard.grants == grants
        });
        let given: Vec<GivenAnswer> = mine.map(|heard| heard.given.clone()).collect();
        let others = Others {
            world: self,
            asks: peer,
        };
        let verdict = match self.question((managing, wish), (peer, &facts), (&given, repeated), &others) {
            // A third-party manager that panics must not end the hub, nor let anyone in.
            Some(question) => std::panic::catch_unwind(AssertUnwindSafe(|| manager.decide(&question)))
                .unwrap_or_else(|_| {
                    let text = "the manager of this context failed, so access is denied";
                    Verdict::deny(Code::DENIED, "failed manager", text)
                }),
            None => nobody(),
        };
        if let Some(context) = self.tree.get_mut(managing) {
            context.manager = Some(manager);
        }
        verdict
    }

    /// What the manager of a context knows of it; nothing if it fails, as a third-party one may.
    pub(crate) fn facts(&self, number: ContextNumber) -> Map {
        self.ask_manager(number, |manager, path| manager.facts(path))
    }

    /// The tokens to whose grants the ownership of this one may matter.
    pub(crate) fn neighbours(&self, number: ContextNumber) -> Vec<Path> {
        self.ask_manager(number, |manager, path| manager.neighbours(path))
    }

    /// A number that changes when this token, or one of its neighbours, is granted to anybody; 0 for other contexts.
    pub(crate) fn grants_at(&self, number: ContextNumber) -> u64 {
        let Some(own) = self.token(number) else { return 0 };
        let neighbours = self.neighbours(number);
        let others = neighbours.iter().filter_map(|path| self.tree.find(path)?.token());
        // Fences only rise, so that each change shows in their sum.
        others.fold(own.fence.into(), |sum: u64, token| {
            sum.wrapping_add(token.fence.into())
        })
    }

    fn ask_manager<T: Default>(&self, number: ContextNumber, ask: impl Fn(&dyn Manager, &Path) -> T) -> T {
        let manager = self
            .tree
            .managing(number)
            .and_then(|context| context.manager.as_ref());
        let (Some(manager), Some(context)) = (manager, self.tree.get(number)) else {
            return T::default();
        };
        std::panic::catch_unwind(AssertUnwindSafe(|| ask(&**manager, &context.path))).unwrap_or_default()
    }

    fn question<'a>(
        &'a self,
        (managing, wish): (ContextNumber, &'a Wish<'_>),
        (peer, facts): (PeerId, &'a PeerFacts),
        (answers, repeated): (&'a [GivenAnswer], bool),
        others: &'a Others<'a>,
    ) -> Option<Question<'a>> {
        let context = self.tree.get(wish.at)?;
        // A member that came in by an invitation needs no other to stay.
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
            others,
            invited,
            created: creator == Some(peer),
            answers,
            repeated,
            now: self.now,
            wall: self.civil(),
        })
    }
}

/// The tokens of the tree, as they are to the peer that asks.
struct Others<'a> {
    world: &'a World,
    asks: PeerId,
}

impl std::fmt::Debug for Others<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Others")
            .field("asks", &self.asks)
            .finish_non_exhaustive()
    }
}

impl Tokens for Others<'_> {
    fn token(&self, path: &Path) -> Option<TokenFacts<'_>> {
        let context = self.world.tree.find(path)?;
        let facts = self.world.token_facts(context, self.asks)?;
        let granting = context.token()?.granting.as_ref();
        // Until its record is durable nobody is told of a grant, but no other may begin beside it.
        let Some(to) = granting
            .and_then(|granting| granting.change.as_ref())
            .map(|change| change.to)
        else {
            return Some(facts);
        };
        let peer = self.world.peers.get(to)?;
        Some(TokenFacts {
            owner: Some(Owner {
                name: &peer.facts.name,
                user: &peer.facts.user,
                groups: &peer.facts.groups,
                level: peer.facts.level,
                asks: to == self.asks,
            }),
            lease_end: None,
            ..facts
        })
    }
}

fn nobody() -> Verdict {
    Verdict::deny(
        Code::DENIED,
        "no manager",
        "no manager is set for this context, so it is closed",
    )
}
