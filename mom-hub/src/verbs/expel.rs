//! `context expel`: putting a peer out.

use std::sync::Arc;
use std::time::Duration;

use mom_proto::event::Reason;
use mom_proto::{Code, ContextNumber, Micros, WireError};
use serde::Deserialize;

use super::checks::Request;
use super::logout::follow;
use crate::asking::questions::Questions;
use crate::asking::refusal::Refusal;
use crate::content;
use crate::stops::shortened;
use crate::world::World;
use crate::world::events::peer_map;
use crate::world::steps::{Expulsion, Leaving, Then};
use crate::{Audit, Effect, PeerId};

/// Users that are kept out of one context.
const MOST: usize = 1000;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// The peer's name.
    peer: String,
    /// Plain words for it.
    #[serde(default)]
    text: Option<String>,
    /// For how long its user may not come back, ms.
    #[serde(default = "default_for")]
    r#for: u64,
}

fn default_for() -> u64 {
    60_000
}

pub(crate) fn on(
    world: &mut World,
    questions: &mut Questions,
    request: &Request,
    out: &mut Vec<Effect>,
) -> Result<(), Refusal> {
    let number = world.allowed(request)?;
    let args: Args = content::read(&request.parcel)?;
    let time = match args.r#for {
        0 => 0,
        millis => content::micros(millis, "for")?,
    };
    let peer = world
        .peers
        .id_of(&args.peer)
        .filter(|peer| world.tree.is_member(*peer, number));
    let peer = peer.ok_or_else(|| {
        let text = format!("there is no member {:?} in {}", args.peer, request.path);
        WireError::new(Code::UNKNOWN_PEER, text).slot("content/peer")
    })?;
    keep_out(world, number, peer, time)?;
    let by = Some((request.peer, request.parcel.id));
    let text = args.text.as_deref().and_then(shortened);
    put_out(world, questions, (number, peer, by), text.as_deref(), out);
    Ok(())
}

fn keep_out(world: &mut World, number: ContextNumber, peer: PeerId, time: Micros) -> Result<(), WireError> {
    let (now, until) = (world.now, world.after(time));
    let user = world.peers.get(peer).map(|peer| Arc::clone(&peer.facts.user));
    let (Some(user), Some(context)) = (user, world.tree.get_mut(number)) else {
        return Err(world.faulted("expelling a peer that does not exist, or from a context that does not"));
    };
    context.expelled.retain(|_, until| now < *until);
    if time > 0 {
        if context.expelled.len() >= MOST {
            return Err(WireError::new(
                Code::FULL,
                format!("{MOST} users are expelled, the limit"),
            ));
        }
        context.expelled.insert(user, until);
    }
    Ok(())
}

/// Puts a peer out of a context and all below it; out of the root is out of the hub. The requester is
/// answered.
pub(crate) fn put_out(
    world: &mut World,
    questions: &mut Questions,
    (number, peer, answer): (ContextNumber, PeerId, Option<(PeerId, Option<u64>)>),
    text: Option<&str>,
    out: &mut Vec<Effect>,
) {
    let (Some(context), Some(known)) = (world.tree.get(number), world.peers.get(peer)) else {
        return world.fault("expelling a peer that does not exist, or from a context that does not");
    };
    let (path, root) = (context.path.clone(), context.parent.is_none());
    let mut content = peer_map(&known.facts);
    let by = answer.map(|(by, _)| by);
    if let Some(by) = by {
        content.set("by", world.name_of(by));
    }
    if let Some(text) = text {
        content.set("text", text);
    }
    let fact = Audit {
        context: Some(path.clone()),
        text: text.map(str::to_owned),
        by: by.map(|by| world.name_of(by).into()),
        ..world.fact("expelled", peer)
    };
    let why = text.unwrap_or("this peer was expelled from the hub");
    let mut told = world.tree.members_of(number);
    // Of many the others hear how many are left.
    if by.is_some_and(|by| world.count_expulsion(number, by).is_err()) {
        told.retain(|member| *member == peer);
        world.hold_count(number);
    }
    let expulsion = Expulsion {
        told,
        content,
        close: root.then(|| WireError::new(Code::REVOKED, why)),
        answer,
    };
    world.audit(fact, out);
    let leaving = Leaving {
        peer,
        top: path,
        reason: Reason::Revoked,
        then: Then::Expelled(Box::new(expulsion)),
    };
    if let Some(left) = world.leave(leaving, out) {
        follow(world, questions, left, out);
    }
}

/// Checks that a peer was not put out of a context a short while ago.
pub(super) fn check_not_expelled(
    world: &World,
    peer: PeerId,
    number: ContextNumber,
) -> Result<(), WireError> {
    let user = world.peers.get(peer).map(|peer| &peer.facts.user);
    let context = world.tree.get(number);
    let until = context
        .zip(user)
        .and_then(|(context, user)| context.expelled.get(user));
    match until.filter(|until| world.now < **until) {
        None => Ok(()),
        Some(until) => {
            let text = "this user was expelled from it, and may return later";
            let wait = Duration::from_micros(until - world.now);
            Err(WireError::new(Code::DENIED, text)
                .rule("expelled")
                .retry_after(wait))
        }
    }
}

/// Why a user may not log in for now, if it may not.
pub(crate) fn kept_out(world: &World, user: &str) -> Option<WireError> {
    let root = world.tree.root()?;
    let until = root.expelled.get(user).filter(|until| world.now < **until)?;
    let text = "this user was expelled from the hub, and may return later";
    let wait = Duration::from_micros(until - world.now);
    Some(WireError::new(Code::REVOKED, text).retry_after(wait))
}
