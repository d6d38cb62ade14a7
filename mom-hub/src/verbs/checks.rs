//! A request, and what several verbs look at before they change anything.

use std::sync::Arc;
use std::time::Duration;

use mom_managers::Answer;
use mom_proto::{Code, ContextKind, ContextNumber, Family, Map, Parcel, Path, Verb, WireError};

use crate::asking::consult::Allowed;
use crate::asking::questions::Due;
use crate::asking::refusal::Refusal;
use crate::asking::wish::Wish;
use crate::heard::Heard;
use crate::tree::context::Context;
use crate::world::World;
use crate::{Effect, Inquiry, PeerId};

/// Children or members that one reply names: each costs the hub's time, and often a question to a manager.
pub(super) const PAGE: usize = 128;

/// A request with its context's path resolved.
pub(crate) struct Request {
    pub(crate) peer: PeerId,
    pub(crate) verb: Verb,
    pub(crate) path: Path,
    pub(crate) parcel: Parcel,
    /// What managing peers and chairs have answered about it.
    pub(crate) answers: Vec<Heard>,
    /// As in [`Due`].
    pub(crate) waiter: Option<(ContextNumber, u64)>,
}

impl Request {
    /// The request as it is carried out again.
    pub(super) fn into_due(self) -> Due {
        Due {
            peer: self.peer,
            parcel: self.parcel,
            answers: self.answers,
            waiter: self.waiter,
        }
    }

    /// Answers it with `ok`.
    pub(super) fn push_ok(&self, world: &World, content: Option<Map>, out: &mut Vec<Effect>) {
        world.push_ok(self.peer, self.parcel.id, &self.path, content, out);
    }

    /// Leaves the answer to the broker.
    pub(super) fn push_inquiry(&self, world: &World, inquiry: Inquiry, out: &mut Vec<Effect>) {
        let mut parcel = world.hub_parcel(Family::Reply, "ok", &self.path);
        parcel.reference = self.parcel.id;
        out.push(Effect::Inquire {
            to: self.peer,
            parcel: Arc::new(parcel),
            inquiry: Box::new(inquiry),
        });
    }
}

impl World {
    /// The path that a request is about.
    pub(crate) fn path_of(&self, parcel: &Parcel, verb: Verb) -> Result<Path, WireError> {
        if let Some(path) = &parcel.context {
            return Ok(path.clone());
        }
        match parcel.number {
            Some(number) => self
                .tree
                .get(number)
                .map(|context| context.path.clone())
                .ok_or_else(|| no_number(number)),
            None if matches!(verb, Verb::Logout | Verb::Verdict) => Ok(Path::root()),
            None => {
                let text = format!("{verb} needs the slot context");
                Err(WireError::new(Code::BAD_SLOT, text).slot("context"))
            }
        }
    }

    /// The context of a request, once its manager has allowed the verb there.
    ///
    /// Where nothing is, [`World::nothing_at`] says what the peer may know.
    pub(crate) fn allowed(&mut self, request: &Request) -> Result<ContextNumber, Refusal> {
        match self.tree.find(&request.path).map(|context| context.number) {
            Some(number) => {
                self.ask(request.peer, &Wish::new(request.verb, number), &request.answers)?;
                Ok(number)
            }
            None => Err(self.nothing_at(request)),
        }
    }

    /// The error for a path that nothing is at; what the peer may not look up is not suggested to it.
    pub(crate) fn unknown_to(&mut self, peer: PeerId, path: &Path, answers: &[Heard]) -> WireError {
        let near = self
            .tree
            .nearest_path(path)
            .and_then(|near| self.tree.find(&near))
            .map(|near| near.number);
        match near {
            Some(near) if self.ask(peer, &Wish::new(Verb::Lookup, near), answers).is_err() => {
                no_context(path)
            }
            _ => self.tree.unknown_path(path, None),
        }
    }

    /// What a peer is told in place of a refusal, if the context is one that it may not look up: what it would hear if
    /// nothing were there. Only who makes something there learns that the path is taken.
    pub(crate) fn veil(&mut self, request: &Request) -> Option<WireError> {
        let here = self.tree.find(&request.path)?.number;
        // What is explained is explained as if nothing were there already.
        let open = matches!(request.verb, Verb::Create | Verb::Explain);
        if open || !self.is_hidden(request.peer, here) {
            return None;
        }
        match (&request.parcel.context, request.parcel.number) {
            (None, Some(number)) => Some(no_number(number)),
            _ => match self.nothing_at(request) {
                Refusal::Error(error) => Some(error),
                Refusal::Defer(_) => Some(no_context(&request.path)),
            },
        }
    }

    /// What a peer hears of a path where nothing is, as far as it may know: the manager of the nearest context above that
    /// it may look up decides.
    fn nothing_at(&mut self, request: &Request) -> Refusal {
        let Some(at) = self.seen_above(request.peer, &request.path) else {
            return no_context(&request.path).into();
        };
        let wish = Wish {
            path: Some(&request.path),
            ..Wish::new(request.verb, at)
        };
        match self.ask(request.peer, &wish, &request.answers) {
            Ok(_) => self
                .unknown_to(request.peer, &request.path, &request.answers)
                .into(),
            Err(refusal) => refusal,
        }
    }

    /// The nearest context above a path that a peer may look up.
    pub(crate) fn seen_above(&mut self, peer: PeerId, path: &Path) -> Option<ContextNumber> {
        let above = path.parent().and_then(|above| self.tree.find_or_above(&above));
        let mut above = above.map(|context| context.number);
        while let Some(at) = above.filter(|at| self.is_hidden(peer, *at)) {
            above = self.tree.get(at).and_then(|context| context.parent);
        }
        above
    }

    /// The context at a path, if a peer may know of it.
    pub(crate) fn seen_at(&mut self, peer: PeerId, path: &Path) -> Option<ContextNumber> {
        let here = self.tree.find(path)?.number;
        (!self.is_hidden(peer, here)).then_some(here)
    }

    /// What is said to a request about something that is not there, or not for this peer.
    pub(super) fn absent(&mut self, request: &Request) -> WireError {
        match (&request.parcel.context, request.parcel.number) {
            (None, Some(number)) => no_number(number),
            _ => self.unknown_to(request.peer, &request.path, &request.answers),
        }
    }

    /// Whether a peer may not know that a context exists: it may neither look it up nor see nor enter it.
    pub(crate) fn is_hidden(&mut self, peer: PeerId, number: ContextNumber) -> bool {
        let ways = [Verb::Lookup, Verb::Info, Verb::Join];
        !self.tree.is_member(peer, number) && ways.into_iter().all(|way| self.refused(peer, way, number))
    }

    /// As [`World::allowed`], for verbs of tokens.
    pub(crate) fn allowed_token(&mut self, request: &Request) -> Result<ContextNumber, Refusal> {
        let number = self.find_token(request)?;
        self.allow(request, number)?;
        Ok(number)
    }

    /// The token of a request; the manager is asked only where there is none, whether the peer may know.
    pub(crate) fn find_token(&mut self, request: &Request) -> Result<ContextNumber, Refusal> {
        let Some(context) = self.tree.find(&request.path) else {
            return self.allowed(request);
        };
        let number = context.number;
        match of_kind(context, ContextKind::Token, request.verb) {
            Ok(()) => Ok(number),
            Err(error) => Err(self.unless_denied(request, number, error)),
        }
    }

    /// What is wrong with a request, told only to a peer that may make it: any other is refused as its manager says, and
    /// learns nothing of what is there. Nobody is asked about it in vain.
    pub(crate) fn unless_denied(
        &mut self,
        request: &Request,
        number: ContextNumber,
        error: WireError,
    ) -> Refusal {
        if request.verb.gives_up() {
            return error.into();
        }
        let wish = Wish::new(request.verb, number);
        match self.consult(request.peer, &wish, &request.answers).answer {
            Answer::Deny(denial) if !denial.code.may_retry() => {
                self.explain(request.peer, &wish, &denial).into()
            }
            _ => error.into(),
        }
    }

    /// As [`World::check_parent_joined`]; a peer that the manager refuses anyway is told only that.
    pub(crate) fn check_near(&mut self, request: &Request, number: ContextNumber) -> Result<(), Refusal> {
        let near = self.check_parent_joined(request.peer, number);
        near.map_err(|error| self.unless_denied(request, number, error))
    }

    /// Asks the manager of a token, after all that can be wrong with the request itself.
    pub(crate) fn allow(&mut self, request: &Request, number: ContextNumber) -> Result<Allowed, Refusal> {
        self.ask(request.peer, &Wish::new(request.verb, number), &request.answers)
    }

    /// Checks that a peer has joined the parent of a context (M23).
    pub(crate) fn check_parent_joined(&self, peer: PeerId, number: ContextNumber) -> Result<(), WireError> {
        let Some(parent) = self.tree.get(number).and_then(|context| context.parent) else {
            return Ok(());
        };
        if self.tree.is_member(peer, parent) {
            return Ok(());
        }
        let path = self
            .tree
            .get(parent)
            .map(|parent| parent.path.to_string())
            .unwrap_or_default();
        let text = format!("join {path} first: a context is entered through its parent");
        Err(WireError::new(Code::NOT_MEMBER, text).slot("context"))
    }

    /// Checks that the asking peer owns the token.
    pub(crate) fn check_owner(&self, request: &Request, number: ContextNumber) -> Result<(), WireError> {
        let owner = self.owner_of(number);
        if owner == Some(request.peer) {
            return Ok(());
        }
        let text = match owner {
            None => format!("{} has no owner", request.path),
            Some(owner) => format!("{} is held by {}", request.path, self.name_of(owner)),
        };
        let error = WireError::new(Code::NOT_OWNER, text).rule("one owner at most");
        let error = match self.level_of(request.peer) {
            Some(level) => error.level(level),
            None => error,
        };
        let level = self.token(number).and_then(|token| self.owner_level(token));
        let error = match owner {
            Some(owner) => error.owner(&self.name_of(owner), level.unwrap_or_default()),
            None => error,
        };
        let end = self
            .token(number)
            .and_then(|token| token.owner.as_ref()?.lease_end);
        Err(match end.filter(|end| *end > self.now) {
            Some(end) => error.retry_after(Duration::from_micros(end - self.now)),
            None => error,
        })
    }

    /// Checks that the owner has the token for good, and not for a while from another peer.
    pub(crate) fn check_not_lent(&self, number: ContextNumber, what: &str) -> Result<(), WireError> {
        let owner = self.token(number).and_then(|token| token.owner.as_ref());
        if owner.is_some_and(|owner| owner.delegation.is_some()) {
            let text = format!("a token given for a limited time cannot be {what}; release it to return it");
            return Err(WireError::new(Code::DENIED, text).rule("delegation"));
        }
        Ok(())
    }
}

/// What is said where nothing is, or nothing that the peer may know of.
pub(crate) fn no_context(path: &Path) -> WireError {
    WireError::new(Code::UNKNOWN_PATH, format!("there is no context {path}")).slot("context")
}

fn no_number(number: ContextNumber) -> WireError {
    let text = format!("there is no context with the number {}", number.0);
    WireError::new(Code::UNKNOWN_PATH, text).slot("context")
}

/// Checks that a context knows a verb.
pub(crate) fn of_kind(context: &Context, kind: ContextKind, verb: Verb) -> Result<(), WireError> {
    match context.kind() == kind {
        true => Ok(()),
        false => {
            let text = format!("{} is a {}; {verb} is for a {kind}", context.path, context.kind());
            Err(WireError::new(Code::WRONG_KIND, text).slot("context"))
        }
    }
}
