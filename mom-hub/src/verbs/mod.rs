//! One verb per file: what it needs, what it changes, what it answers.

mod accept;
mod breaking;
mod create;
mod decline;
mod delete;
mod expel;
mod give;
mod grab;
mod info;
mod inhibit;
mod invite;
mod join;
mod leave;
mod list;
mod logout;
mod lookup;
mod members;
mod release;
mod renew;
mod request;
mod send;
mod stats;
mod uninhibit;
mod verdict;

use mom_managers::Answer;
use mom_proto::{Code, ContextKind, ContextNumber, Family, Parcel, Path, Verb, WireError};

use crate::asking::consult::{Allowed, Wish};
use crate::asking::questions::{Refusal, take_parcel};
use crate::ownership::queue::MOST;
use crate::token::state::HeldBack;
use crate::tree::context::Context;

/// Requests of one peer that wait while a change of a token is being stored.
const MOST_OF_ONE: usize = 16;
use crate::{Effect, Hub, PeerId};

/// A request with its context's path resolved.
pub(crate) struct Request {
    pub(crate) peer: PeerId,
    pub(crate) verb: Verb,
    pub(crate) path: Path,
    pub(crate) parcel: Parcel,
}

/// Carries out a request. A refusal has changed nothing and has had no effect.
pub(crate) fn carry_out(hub: &mut Hub, request: &mut Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    if hub.hold_back(request)? {
        return Ok(());
    }
    match request.verb {
        Verb::Create => create::on(hub, request, out),
        Verb::Lookup => lookup::on(hub, request, out),
        Verb::List => list::on(hub, request, out),
        Verb::Info => info::on(hub, request, out),
        Verb::Join => join::on(hub, request, out),
        Verb::Leave => leave::on(hub, request, out),
        Verb::Delete => delete::on(hub, request, out),
        Verb::Members => members::on(hub, request, out),
        Verb::Stats => stats::on(hub, request, out),
        Verb::Invite => invite::on(hub, request, out),
        Verb::Expel => expel::on(hub, request, out),
        Verb::Grab => grab::on(hub, request, out),
        Verb::Release => release::on(hub, request, out),
        Verb::Renew => renew::on(hub, request, out),
        Verb::Give => give::on(hub, request, out),
        Verb::Accept => accept::on(hub, request, out),
        Verb::Decline => decline::on(hub, request, out),
        Verb::Request => request::on(hub, request, out),
        Verb::Break => breaking::on(hub, request, out),
        Verb::Inhibit => inhibit::on(hub, request, out),
        Verb::Uninhibit => uninhibit::on(hub, request, out),
        Verb::Send | Verb::Stop | Verb::Unstop => send::on(hub, request, out),
        Verb::Verdict => verdict::on(hub, request, out),
        Verb::Logout => {
            logout::on(hub, request, out);
            Ok(())
        }
        // Those need what the hub does not have: passwords, keys and clocks. The broker answers them.
        verb @ (Verb::Login | Verb::Answer | Verb::Ping | Verb::Pong) => {
            let text = format!("{verb} is not answered here");
            Err(WireError::new(Code::UNKNOWN_VERB, text).into())
        }
    }
}

impl Hub {
    /// Puts a request on a token aside while a change of its owner is being stored.
    fn hold_back(&mut self, request: &mut Request) -> Result<bool, WireError> {
        let about_token = matches!(request.verb.family(), Family::Token);
        let storing = self
            .tree
            .find(&request.path)
            .filter(|context| about_token && context.token().is_some_and(|token| token.storing.is_some()));
        let Some(number) = storing.map(|context| context.number) else {
            return Ok(false);
        };
        let answers = self.answers.clone();
        let Some(token) = self.token_mut(number) else {
            return Ok(false);
        };
        // Each of one peer a few: nobody else's renewal may fail for them.
        let mine = token.held_back.iter().filter(|held| held.peer == request.peer);
        if token.held_back.len() >= MOST || mine.count() >= MOST_OF_ONE {
            let text = "too many requests wait for this token";
            return Err(WireError::new(Code::TRY_LATER, text));
        }
        token.held_back.push_back(HeldBack {
            peer: request.peer,
            parcel: take_parcel(&mut request.parcel),
            answers,
        });
        self.involve(request.peer, number);
        Ok(true)
    }

    pub(crate) fn path_of(&self, parcel: &Parcel, verb: Verb) -> Result<Path, WireError> {
        if let Some(path) = &parcel.context {
            return Ok(path.clone());
        }
        match parcel.number {
            Some(number) => self
                .tree
                .get(number)
                .map(|context| context.path.clone())
                .ok_or_else(|| {
                    let text = format!("there is no context of number {}", number.0);
                    WireError::new(Code::UNKNOWN_PATH, text).slot("context")
                }),
            None if matches!(verb, Verb::Logout | Verb::Verdict) => Ok(Path::root()),
            None => {
                let text = format!("{verb} needs the slot context");
                Err(WireError::new(Code::BAD_SLOT, text).slot("context"))
            }
        }
    }

    /// The context of a request, once its manager has allowed the verb there.
    ///
    /// Where nothing is, the manager of the nearest context above decides whether the peer may know.
    pub(crate) fn allowed(&mut self, request: &Request) -> Result<ContextNumber, Refusal> {
        match self.tree.find(&request.path).map(|context| context.number) {
            Some(number) => {
                self.ask(request.peer, &Wish::new(request.verb, number))?;
                Ok(number)
            }
            None => {
                let above = self
                    .tree
                    .find_or_above(&request.path)
                    .map(|context| context.number);
                let at = above.ok_or_else(|| self.unknown_path(&request.path, None))?;
                self.ask(
                    request.peer,
                    &Wish {
                        path: Some(&request.path),
                        ..Wish::new(request.verb, at)
                    },
                )?;
                Err(self.unknown_to(request.peer, &request.path).into())
            }
        }
    }

    /// The error for a path that nothing is at; what the peer may not look up is not suggested to it.
    pub(crate) fn unknown_to(&mut self, peer: PeerId, path: &Path) -> WireError {
        let near = self
            .nearest_path(path)
            .and_then(|near| self.tree.find(&near))
            .map(|near| near.number);
        match near {
            Some(near) if self.ask(peer, &Wish::new(Verb::Lookup, near)).is_err() => {
                WireError::new(Code::UNKNOWN_PATH, format!("there is no context {path}")).slot("context")
            }
            _ => self.unknown_path(path, None),
        }
    }

    /// As [`Hub::allowed`], for verbs of tokens.
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

    /// What is wrong with a request, for who could make it rightly; who may not is told that, and not what it has found
    /// there. Nobody is asked about it in vain.
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
        match self.consult(request.peer, &wish).answer {
            Answer::Deny(denial) if !denial.code.may_retry() => {
                self.explain(request.peer, &wish, &denial).into()
            }
            _ => error.into(),
        }
    }

    /// As [`Hub::check_parent_joined`], for who may know.
    pub(crate) fn check_near(&mut self, request: &Request, number: ContextNumber) -> Result<(), Refusal> {
        let near = self.check_parent_joined(request.peer, number);
        near.map_err(|error| self.unless_denied(request, number, error))
    }

    /// Asks the manager of a token, after all that can be wrong with the request itself.
    pub(crate) fn allow(&mut self, request: &Request, number: ContextNumber) -> Result<Allowed, Refusal> {
        self.ask(request.peer, &Wish::new(request.verb, number))
    }

    /// Whether a peer is a member of a context.
    pub(crate) fn is_member(&self, peer: PeerId, number: ContextNumber) -> bool {
        self.tree
            .get(number)
            .is_some_and(|context| context.members.contains_key(&peer))
    }

    /// Checks that a peer has joined the parent of a context (M23).
    pub(crate) fn check_parent_joined(&self, peer: PeerId, number: ContextNumber) -> Result<(), WireError> {
        let Some(parent) = self.tree.get(number).and_then(|context| context.parent) else {
            return Ok(());
        };
        if self.is_member(peer, parent) {
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
