//! `context invite`: showing a peer in.

use mom_proto::event;
use mom_proto::{Code, Micros, WireError};
use serde::Deserialize;

use super::checks::Request;
use crate::asking::refusal::Refusal;
use crate::content;
use crate::token::handover::{AGAIN, not_again};
use crate::values::millis;
use crate::world::World;
use crate::{Audit, Effect};

/// How long an invitation counts, µs.
const INVITED: Micros = 600_000_000;

/// Invitations to one context that count at a time.
const MOST: usize = 1000;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// The peer's name.
    peer: String,
}

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.allowed(request)?;
    let args: Args = content::read(&request.parcel)?;
    if !world.tree.is_member(request.peer, number) {
        let text = format!("only members of {} may invite to it", request.path);
        return Err(WireError::new(Code::NOT_MEMBER, text).slot("context").into());
    }
    let peer = world.peers.id_of(&args.peer).ok_or_else(|| {
        let text = format!("there is no peer {:?}", args.peer);
        WireError::new(Code::UNKNOWN_PEER, text).slot("content/peer")
    })?;
    world.count_wish(request.peer, peer)?;
    let (now, until) = (world.now, world.after(INVITED));
    let Some(context) = world.tree.get_mut(number) else {
        return Err(world
            .faulted("a manager allowed a verb on a context that does not exist")
            .into());
    };
    context.invited.retain(|_, until| now < *until);
    if let Some(known) = context.invited.get(&peer) {
        not_again(now, known.saturating_sub(INVITED - AGAIN), &args.peer)?;
    }
    if context.invited.len() >= MOST {
        return Err(WireError::new(Code::FULL, format!("{MOST} invitations are open, the limit")).into());
    }
    context.invited.insert(peer, until);
    world.tree.name_peer(peer, number);
    let Some(context) = world.tree.get(number) else {
        return Err(world.faulted("inviting to a context that does not exist").into());
    };
    let content = context
        .summary()
        .with("by", world.name_of(request.peer))
        .with("within", millis(INVITED));
    world.push_event(event::INVITED, &request.path, vec![peer], content, out);
    let fact = Audit {
        context: Some(request.path.clone()),
        by: Some(world.name_of(peer).into()),
        ..world.fact("invited", request.peer)
    };
    world.audit(fact, out);
    request.push_ok(world, None, out);
    Ok(())
}
