//! The verdict about a request that nobody makes, for people who ask why.

use mom_managers::{Answer, Terms, Verdict};
use mom_proto::event::Reason;
use mom_proto::{Code, ContextKind, ContextNumber, Family, Micros, Path, Verb, WireError};

use crate::asking::wish::Wish;
use crate::token::grant::Grantee;
use crate::tree::context::Context;
use crate::verbs::of_kind;
use crate::{Hub, PeerId, User};

/// The peers that a case supposes.
const ASKER: PeerId = PeerId(1);
const OWNER: PeerId = PeerId(2);

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
    /// The owner of the token: since now, with the token's lease.
    pub owner: Option<&'a User>,
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
        let place = self.place(case.path);
        // Where nothing is, the manager of the nearest context above decides.
        let at = self.world.tree.find_or_above(case.path);
        let at = at
            .map(|context| context.number)
            .expect("the root is always there");
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
        let verdict = self.world.consult(ASKER, &wish, &[]);
        Judgement {
            refusal: self.refusal_of(&verdict, case, &wish),
            place,
            managed_at,
            manager,
            guard: self.guard_of(case, at),
            verdict,
        }
    }

    /// Lets the asking peer in, and the owner of the token, who has just got it.
    fn suppose(&mut self, case: &Case<'_>) {
        self.world
            .peers
            .add(ASKER, case.user.clone(), &case.user.name, self.world.now);
        let found = self.world.tree.find(case.path).map(|context| context.number);
        let Some(number) = found else { return };
        if let Some(context) = self.world.tree.get_mut(number).filter(|_| case.invited) {
            context.invited.insert(ASKER, Micros::MAX);
        }
        let Some(owner) = case.owner.filter(|_| self.world.token(number).is_some()) else {
            return;
        };
        let peer = if owner.name == case.user.name {
            ASKER
        } else {
            OWNER
        };
        if peer == OWNER {
            self.world
                .peers
                .add(OWNER, owner.clone(), &owner.name, self.world.now);
        }
        let grantee = Grantee::plain(peer);
        let mut nobody_hears = Vec::new();
        let reason = Reason::Released;
        self.world
            .change_owner(number, Some(grantee), reason, None, false, &mut nobody_hears);
    }

    fn refusal_of(&mut self, verdict: &Verdict, case: &Case<'_>, wish: &Wish<'_>) -> Option<WireError> {
        match &verdict.answer {
            Answer::Deny(denial) => Some(self.world.explain(ASKER, wish, denial)),
            Answer::Queue(wait) => Some(self.world.explain(ASKER, wish, &wait.denial)),
            Answer::Defer(_) => None,
            // A manager that allows a grab takes nothing from a living owner by that alone.
            Answer::Allow(grant) => {
                let owner = self.world.owner_of(wish.at).filter(|owner| *owner != ASKER);
                match owner.filter(|_| case.verb == Verb::Grab && !grant.displace) {
                    Some(_) => Some(self.world.held(ASKER, wish.at)),
                    None => self.impossible(case),
                }
            }
        }
    }

    /// Why a request comes to nothing although its manager allows it.
    fn impossible(&mut self, case: &Case<'_>) -> Option<WireError> {
        match (case.verb, self.world.tree.find(case.path)) {
            (Verb::Create, None) => self.world.tree.parent_for(case.path).err(),
            (Verb::Create, Some(_)) => {
                let text = format!("there is a context {} already", case.path);
                Some(WireError::new(Code::EXISTS, text).slot("context"))
            }
            (_, None) => Some(self.world.unknown_to(ASKER, case.path, &[])),
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
