//! Facts for the audit log.

use std::sync::Arc;

use mom_proto::event;
use mom_proto::{HUB, Parcel, Path, Value, Verb, WireError};

use super::World;
use crate::{Audit, Effect, PeerId};

impl World {
    /// A fact about a peer.
    pub(crate) fn fact(&self, what: &'static str, peer: PeerId) -> Audit {
        let facts = self.peers.get(peer).map(|peer| &peer.facts);
        Audit {
            peer: facts.map(|facts| Arc::clone(&facts.name)),
            user: facts.map(|facts| Arc::clone(&facts.user)),
            level: facts.map(|facts| facts.level),
            ..Audit::new(what)
        }
    }

    /// Notes a fact.
    pub(crate) fn audit(&self, audit: Audit, out: &mut Vec<Effect>) {
        out.push(Effect::Audit(Box::new(audit)));
    }

    /// Notes the beginning or the end of a peer's part in a shared hold.
    pub(crate) fn audit_shared(&self, name: &'static str, path: &Path, peer: PeerId, out: &mut Vec<Effect>) {
        debug_assert!([event::INHIBITED, event::UNINHIBITED].contains(&name), "{name}");
        let fact = Audit {
            context: Some(path.clone()),
            ..self.fact(name, peer)
        };
        self.audit(fact, out);
    }

    /// Notes that a context was made or deleted, and by whom.
    pub(crate) fn audit_context(
        &self,
        what: &'static str,
        path: &Path,
        by: Option<PeerId>,
        out: &mut Vec<Effect>,
    ) {
        let fact = Audit {
            context: Some(path.clone()),
            ..by.map_or_else(|| Audit::new(what), |by| self.fact(what, by))
        };
        self.audit(fact, out);
    }

    /// Refuses a request: an error to the peer that made it, and a fact.
    pub(crate) fn push_refusal(
        &self,
        peer: PeerId,
        request: &Parcel,
        error: &WireError,
        out: &mut Vec<Effect>,
    ) {
        self.push_refusal_as(peer, request, (error, None), out);
    }

    /// The same, where the peer is told something else than what is noted.
    pub(crate) fn push_refusal_as(
        &self,
        peer: PeerId,
        request: &Parcel,
        (error, told): (&WireError, Option<&WireError>),
        out: &mut Vec<Effect>,
    ) {
        let word = |key: &str| error.get(key).and_then(Value::as_str).map(Arc::from);
        let verb = Verb::of(request.family, &request.name).ok();
        let message = matches!(verb, Some(Verb::Send)).then(|| Arc::clone(&request.name));
        let named = request.number.and_then(|number| self.tree.get(number));
        let fact = Audit {
            verb,
            context: request
                .context
                .clone()
                .or_else(|| named.map(|context| context.path.clone())),
            message,
            rule: word("rule"),
            by: word("owner"),
            code: Some(error.code.clone()),
            ..self.fact("refused", peer)
        };
        let mut parcel = told.unwrap_or(error).to_parcel(request.id);
        parcel.sender = Some(HUB.into());
        parcel.timestamp = Some(self.wall());
        out.push(Effect::Reply {
            to: peer,
            parcel: Arc::new(parcel),
        });
        self.audit(fact, out);
    }
}
