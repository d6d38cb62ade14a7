//! `context join`: entered through its parent (M23). Joining again is answered, and changes only what the member is
//! to be spared, if the content says so.

use mom_proto::{Code, ContextNumber, Overflow, Thinning, WireError};

use super::Request;
use crate::asking::questions::Refusal;
use crate::tree::context::Role;
use crate::tree::spec::{self as args, JoinArgs};
use crate::{Effect, Hub};

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.allowed(request)?;
    hub.check_parent_joined(request.peer, number)?;
    let thinning = thinning(hub, request, number)?;
    if !hub.is_member(request.peer, number) {
        hub.check_not_expelled(request.peer, number)?;
        let joined = hub.peers.get(request.peer).map_or(0, |peer| peer.joined.len());
        if !hub.settings.limits.joined.allows(joined + 1) {
            let text = format!("a peer joins at most {} contexts", hub.settings.limits.joined);
            return Err(WireError::new(Code::FULL, text).into());
        }
        hub.add_member(number, request.peer, out);
    }
    if let Some(thinning) = thinning {
        hub.thin(number, request.peer, thinning);
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
            if channel.overflow == Overflow::Wait {
                content.set("overflow", channel.overflow.word());
            }
            if let Some(member) = context.members.get(&request.peer) {
                member.thinning.describe(&mut content);
            }
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

/// What the peer asks to be spared; none if it says nothing of that.
fn thinning(hub: &Hub, request: &Request, number: ContextNumber) -> Result<Option<Thinning>, WireError> {
    if request.parcel.content.is_none() {
        return Ok(None);
    }
    let thinning = args::read::<JoinArgs>(&request.parcel)?.thinning()?;
    let is_channel = hub
        .tree
        .get(number)
        .is_some_and(|context| context.channel().is_some());
    if thinning.thins() && !is_channel {
        let text = format!("{} is no channel: only messages are thinned", request.path);
        return Err(WireError::new(Code::WRONG_KIND, text).slot("content"));
    }
    Ok(Some(thinning))
}
