//! The verdict about a request that nobody makes, for people who ask why.

use std::sync::Arc;

use mom_managers::{Answer, Terms, Verdict};
use mom_proto::event::Reason;
use mom_proto::{Code, ContextKind, ContextNumber, Family, Micros, Path, Verb, WireError};

use crate::asking::wish::Wish;
use crate::token::grant::Grantee;
use crate::tree::context::Context;
use crate::verbs::of_kind;
use crate::{Hub, PeerId, User};

/// The peers that a case supposes; the owners follow.
const ASKER: PeerId = PeerId(1);

/// A request that could be made.
#[derive(Clone, Copy, Debug)]
pub struct Case<'a> {
    /// The user that asks.
    pub user: &'a User,
    /// For what.
    pub verb: Verb,
    /// Where; for `create` the path to be made.
    pub path: &'a Path,
    /// The kind to be made, for `create`.
    pub kind: Option<ContextKind>,
    /// The name of the message, for sends.
    pub message: Option<&'a str>,
    /// Who owns which token: since now, with the token's lease.
    pub owners: &'a [(Path, User)],
    /// Whether a member has invited the user there.
    pub invited: bool,
}

/// The hub's answer to a case.
#[derive(Clone, Debug, PartialEq)]
pub struct Judgement {
    /// The manager's verdict.
    pub verdict: Verdict,
    /// The refusal that the peer would get, from the manager or, where that allows, because it cannot be; none if
    /// it would be done, or if the manager has to ask.
    pub refusal: Option<WireError>,
    /// The context at the path; none = there is none.
    pub place: Option<ContextOutline>,
    /// The context whose manager was asked.
    pub managed_at: Path,
    /// How that manager was named; empty where nobody manages.
    pub manager: String,
    /// The token that the sender has to own besides, for a guarded message.
    pub guard: Option<Path>,
    /// Who owns that token.
    pub guard_owner: Option<Arc<str>>,
    /// Who owns the token at the path, if it is one.
    pub owner: Option<Arc<str>>,
}

/// The parts of a context that do not depend on the peers in it.
#[derive(Clone, Debug, PartialEq)]
pub struct ContextOutline {
    /// Its path.
    pub path: Path,
    /// Its kind.
    pub kind: ContextKind,
    /// The context whose manager decides for it: itself, or one above.
    pub managed_at: Path,
    /// How that manager was named.
    pub manager: String,
    /// The terms of ownership, for a token.
    pub terms: Option<Terms>,
}

impl Hub {
    /// The context at a path.
    pub fn place(&self, path: &Path) -> Option<ContextOutline> {
        self.world.tree.find(path).map(|context| self.place_of(context))
    }

    fn place_of(&self, context: &Context) -> ContextOutline {
        let (managed_at, manager) = manager_of(self.world.tree.managing(context.number));
        ContextOutline {
            path: context.path.clone(),
            kind: context.kind(),
            managed_at,
            manager,
            terms: context.token().map(|token| token.terms),
        }
    }

    /// Asks the manager of a place as a request would, and says what would come of it. It consumes the hub, because the
    /// case changes it: make one for each case.
    pub fn judge(mut self, case: &Case<'_>) -> Judgement {
        self.suppose(case);
        self.judge_there(case)
    }

    /// The same for one user, whom it supposes by `case`, at each of these paths: nothing is owned, and nobody invited.
    pub fn judge_at<'a>(
        mut self,
        case: &Case<'_>,
        paths: impl IntoIterator<Item = &'a Path>,
    ) -> Vec<Judgement> {
        self.suppose(case);
        let judge = |path: &Path| self.judge_there(&Case { path, ..*case });
        paths.into_iter().map(judge).collect()
    }

    fn judge_there(&mut self, case: &Case<'_>) -> Judgement {
        // Where nothing is, the manager of the nearest context above decides.
        let at = self.world.tree.find_or_above(case.path);
        let at = at
            .map(|context| context.number)
            .expect("the root is always there");
        self.judgement(ASKER, case, at)
    }

    /// The judgement by the manager of `at`: the context of the case, or one above.
    pub(super) fn judgement(&mut self, asker: PeerId, case: &Case<'_>, at: ContextNumber) -> Judgement {
        let there = self
            .world
            .tree
            .get(at)
            .is_some_and(|context| context.path == *case.path);
        let place = self.place(case.path).filter(|_| there);
        let (managed_at, manager) = manager_of(self.world.tree.managing(at));
        let wish = Wish {
            path: Some(case.path),
            kind: case.kind,
            message: case.message,
            size: case.message.map_or(0, str::len),
            // Created just now.
            age: case.message.map(|_| (0, 0)),
            ..Wish::new(case.verb, at)
        };
        let verdict = match case.verb.gives_up() {
            true => Verdict::allow(),
            false => self.world.suppose(asker, &wish),
        };
        let guard = self.guard_of(case, at);
        Judgement {
            refusal: self.refusal_of(asker, &verdict, case, &wish),
            place,
            managed_at,
            manager,
            guard_owner: guard.as_ref().and_then(|token| self.owner_at(token)),
            guard,
            owner: self.owner_at(case.path),
            verdict,
        }
    }

    /// Who owns the token at a path.
    fn owner_at(&self, path: &Path) -> Option<Arc<str>> {
        let token = self.world.tree.find(path)?.token()?;
        self.peer_name(token.owner_peer()?)
    }

    /// Lets the asking peer in, and the owners of tokens, who have just got them.
    fn suppose(&mut self, case: &Case<'_>) {
        self.world
            .peers
            .add(ASKER, case.user.clone(), &case.user.name, self.world.now);
        let found = self.world.tree.find(case.path).map(|context| context.number);
        if let Some(context) = found.and_then(|number| self.world.tree.get_mut(number))
            && case.invited
        {
            context.invited.insert(ASKER, Micros::MAX);
        }
        for (index, (token, owner)) in case.owners.iter().enumerate() {
            let found = self.world.tree.find(token).map(|context| context.number);
            let Some(number) = found.filter(|number| self.world.token(*number).is_some()) else {
                continue;
            };
            let grantee = Grantee::plain(self.owner(index, case, owner));
            let mut nobody_hears = Vec::new();
            let reason = Reason::Released;
            self.world
                .change_owner(number, Some(grantee), reason, None, false, &mut nobody_hears);
        }
    }

    /// The peer of this user, who is one peer whatever it owns.
    fn owner(&mut self, index: usize, case: &Case<'_>, user: &User) -> PeerId {
        if user.name == case.user.name {
            return ASKER;
        }
        let first = case.owners.iter().position(|(_, owner)| owner.name == user.name);
        let first = first.unwrap_or(index);
        let peer = PeerId(ASKER.0 + 1 + first as u64);
        if first == index {
            self.world
                .peers
                .add(peer, user.clone(), &user.name, self.world.now);
        }
        peer
    }

    fn refusal_of(
        &mut self,
        asker: PeerId,
        verdict: &Verdict,
        case: &Case<'_>,
        wish: &Wish<'_>,
    ) -> Option<WireError> {
        match &verdict.answer {
            Answer::Deny(denial) => Some(self.world.explain(asker, wish, denial)),
            Answer::Queue(wait) => Some(self.world.explain(asker, wish, &wait.denial)),
            Answer::Defer(_) => None,
            // A manager that allows a grab takes nothing from a living owner by that alone.
            Answer::Allow(grant) => {
                let owner = self.world.owner_of(wish.at).filter(|owner| *owner != asker);
                match owner.filter(|_| case.verb == Verb::Grab && !grant.displace) {
                    Some(_) => Some(self.world.held(asker, wish.at)),
                    None => self.impossible(asker, case),
                }
            }
        }
    }

    /// Why a request comes to nothing although its manager allows it.
    fn impossible(&mut self, asker: PeerId, case: &Case<'_>) -> Option<WireError> {
        match (case.verb, self.world.tree.find(case.path)) {
            (Verb::Create, None) => self.world.tree.parent_for(case.path).err(),
            (Verb::Create, Some(_)) => {
                let text = format!("there is a context {} already", case.path);
                Some(WireError::new(Code::EXISTS, text).slot("context"))
            }
            (_, None) => Some(self.world.unknown_to(asker, case.path, &[])),
            (Verb::Delete, Some(context)) => self.world.tree.check_not_permanent(context.number).err(),
            (verb, Some(context)) => kind_for(verb).and_then(|kind| of_kind(context, kind, verb).err()),
        }
    }

    /// The token that guards the message of a case.
    fn guard_of(&self, case: &Case<'_>, at: ContextNumber) -> Option<Path> {
        let guard = self.world.tree.get(at)?.channel()?.guard.as_ref()?;
        let message = case.message.filter(|_| case.verb == Verb::Send)?;
        let guarded = guard.names.iter().any(|name| name == message || name == "*");
        guarded.then(|| guard.token.clone())
    }
}

/// The path of a managing context, and how its manager was named.
fn manager_of(managing: Option<&Context>) -> (Path, String) {
    match managing {
        Some(context) => (
            context.path.clone(),
            context.manager_word.clone().unwrap_or_default(),
        ),
        None => (Path::root(), String::new()),
    }
}

/// The kind of context that a verb is for, where it is not for all.
fn kind_for(verb: Verb) -> Option<ContextKind> {
    match verb.family() {
        Family::Token => Some(ContextKind::Token),
        Family::Message => Some(ContextKind::Channel),
        _ if verb == Verb::List => Some(ContextKind::Session),
        _ => None,
    }
}
