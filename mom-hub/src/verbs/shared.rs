//! `token break`, `token inhibit` and `token uninhibit`: taking away, and holding together.

use mom_proto::event::Reason;
use mom_proto::{Code, Map, WireError};

use super::Request;
use crate::asking::questions::Refusal;
use crate::{Effect, Hub, PeerId};

/// Takes a token away from its owner, from all who hold it together, and from who had it before a restart.
pub(crate) fn on_break(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.allowed_token(request)?;
    let owner = hub.owner_of(number).map(|owner| hub.name_of(owner));
    let holders: Vec<PeerId> = hub
        .token(number)
        .map(|token| token.holders.keys().copied().collect())
        .unwrap_or_default();
    let mut content = Map::new();
    if let Some(owner) = owner {
        content.set("owner", owner);
    }
    if !holders.is_empty() {
        content.set("holders", hub.holders_value(number));
    }
    hub.lose(number, Reason::Broken, Some(request.peer), out);
    for holder in holders {
        hub.uninhibit(number, holder, Reason::Broken.word(), out);
    }
    hub.end_reservation(number, out);
    hub.push_ok(request.peer, request.parcel.id, &request.path, Some(content), out);
    Ok(())
}

/// Holds a token together with others: as long as somebody does, nobody owns it.
pub(crate) fn on_inhibit(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.find_token(request)?;
    hub.check_near(request, number)?;
    hub.allow(request, number)?;
    let owner = hub.owner_of(number);
    if owner.is_some_and(|owner| owner != request.peer) {
        return Err(hub.held(request.peer, number).into());
    }
    // Or a loan would last as long as the borrower liked.
    hub.check_not_lent(number, "inhibited")?;
    hub.inhibit(number, request.peer, out);
    if owner.is_some() {
        hub.lose(number, Reason::Released, Some(request.peer), out);
    }
    let content = Map::new().with("holders", hub.holders_value(number));
    hub.push_ok(request.peer, request.parcel.id, &request.path, Some(content), out);
    Ok(())
}

/// Ends one's own part of that.
pub(crate) fn on_uninhibit(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.find_token(request)?;
    hub.allow(request, number)?;
    if !hub.uninhibit(number, request.peer, Reason::Released.word(), out) {
        let text = format!("this peer has no part in a shared hold of {}", request.path);
        return Err(WireError::new(Code::NOT_OWNER, text).into());
    }
    hub.push_ok(request.peer, request.parcel.id, &request.path, None, out);
    Ok(())
}
