//! `context join`: entered through its parent (M23). Joining again is answered, and changes nothing.

use mom_proto::{Code, WireError};

use super::Request;
use crate::context::Role;
use crate::pending::Refusal;
use crate::{Effect, Hub};

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.allowed(request)?;
    hub.check_parent_joined(request.peer, number)?;
    if !hub.is_member(request.peer, number) {
        hub.check_not_expelled(request.peer, number)?;
        let joined = hub.peers.get(request.peer).map_or(0, |peer| peer.joined.len());
        if !hub.settings.limits.joined.allows(joined + 1) {
            let text = format!("a peer joins at most {} contexts", hub.settings.limits.joined);
            return Err(WireError::new(Code::FULL, text).into());
        }
        hub.add_member(number, request.peer, out);
    }
    let Some(context) = hub.tree.get(number) else {
        return Err(hub.unknown_path(&request.path, None).into());
    };
    let mut content = context.summary();
    match &context.role {
        Role::Session => {}
        Role::Token(token) => {
            content.set("lease", hub.lease_value(token));
            for (key, value) in hub.token_map(token) {
                content.set(&key, value);
            }
        }
        Role::Channel(channel) => {
            content.set("delivery", channel.delivery.word());
            if let Some(keep) = channel.keep {
                content.set("keep", keep.to_map());
            }
            if let Some(guard) = &channel.guard {
                // The owner and fence now: who joins late has to know them to check what comes (M33).
                let token = hub.tree.find(&guard.token).and_then(|context| context.token());
                let known = token.map(|token| hub.token_map(token)).unwrap_or_default();
                content.set("guard", guard.describe(known));
            }
        }
    }
    hub.push_ok(request.peer, request.parcel.id, &request.path, Some(content), out);
    Ok(())
}
