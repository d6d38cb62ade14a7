//! `token grab`: exclusive control, decided by the token's manager (M28, M29).

use mom_proto::event::Reason;
use mom_proto::{ContextNumber, Map, WireError};

use super::{Request, of_kind};
use crate::consult::Wish;
use crate::ownership::fence_value;
use crate::{Effect, Hub};

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), WireError> {
    let Some(context) = hub.tree.find(&request.path) else {
        return hub.allowed(request).map(|_| ());
    };
    of_kind(context, mom_proto::ContextKind::Token, request.verb)?;
    let number = context.number;
    hub.check_parent_joined(request.peer, number)?;
    let grant = hub.ask(request.peer, &Wish::new(request.verb, number))?;
    let lapsed = hub.token(number).is_some_and(|token| token.lapsed(hub.now));
    let owner = hub
        .token(number)
        .and_then(|token| token.owner.as_ref())
        .map(|owner| owner.peer);
    match owner {
        None => hub.grant(number, request.peer, Reason::Released, out),
        // Asking again for what one has is a renewal (M29).
        Some(owner) if owner == request.peer => hub.renew_lease(number),
        Some(_) if lapsed => hub.grant(number, request.peer, Reason::Expired, out),
        Some(_) if grant.displace => hub.grant(number, request.peer, Reason::Preempted, out),
        Some(_) => return Err(hub.held(request.peer, number)),
    }
    let content = granted(hub, number);
    hub.push_ok(request.peer, request.parcel.id, &request.path, Some(content), out);
    Ok(())
}

/// What an owner is told: fence and lease.
pub(super) fn granted(hub: &Hub, number: ContextNumber) -> Map {
    match hub.token(number) {
        Some(token) => Map::new()
            .with("fence", fence_value(token.fence))
            .with("lease", hub.lease_value(token)),
        None => Map::new(),
    }
}
