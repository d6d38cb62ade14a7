//! `context invite`: showing a peer in.

use mom_managers::Micros;
use mom_proto::event;
use mom_proto::{Code, WireError};
use serde::Deserialize;

use super::Request;
use crate::asking::questions::Refusal;
use crate::ownership::change::millis;
use crate::ownership::handover::{AGAIN, not_again};
use crate::tree::spec as args;
use crate::{Audit, Effect, Hub};

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

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.allowed(request)?;
    let args: Args = args::read(&request.parcel)?;
    if !hub.is_member(request.peer, number) {
        let text = format!("only members of {} invite to it", request.path);
        return Err(WireError::new(Code::NOT_MEMBER, text).slot("context").into());
    }
    let peer = hub.peers.id_of(&args.peer).ok_or_else(|| {
        let text = format!("there is no peer {:?}", args.peer);
        WireError::new(Code::UNKNOWN_PEER, text).slot("content/peer")
    })?;
    let (now, until) = (hub.now, hub.after(INVITED));
    let Some(context) = hub.tree.get_mut(number) else {
        return Ok(());
    };
    context.invited.retain(|_, until| now < *until);
    if let Some(known) = context.invited.get(&peer) {
        not_again(now, known.saturating_sub(INVITED - AGAIN), &args.peer)?;
    }
    if context.invited.len() >= MOST {
        return Err(
            WireError::new(Code::FULL, format!("{MOST} invitations are open, as many as may")).into(),
        );
    }
    context.invited.insert(peer, until);
    let content = context
        .summary()
        .with("by", hub.name_of(request.peer))
        .with("within", millis(INVITED));
    hub.push_event(event::INVITED, &request.path, vec![peer], content, out);
    let fact = Audit {
        context: Some(request.path.clone()),
        by: Some(hub.name_of(peer).into()),
        ..hub.fact("invited", request.peer)
    };
    hub.audit(fact, out);
    hub.push_ok(request.peer, request.parcel.id, &request.path, None, out);
    Ok(())
}
