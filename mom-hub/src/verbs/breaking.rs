//! `token break`: taking a token away.

use mom_proto::Map;
use mom_proto::event::Reason;

use super::Request;
use crate::asking::questions::Refusal;
use crate::{Effect, Hub, PeerId};

/// Takes a token away from its owner, from all who hold it together, and from who had it before a restart.
pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
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
