//! `token release`: the owner gives the token back, or who waits takes that back.

use std::cmp::Ordering;

use mom_proto::event::Reason;
use mom_proto::{Code, ContextNumber, WireError};

use super::checks::Request;
use crate::Effect;
use crate::asking::refusal::Refusal;
use crate::world::World;

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.allowed_token(request)?;
    check_fence(world, request, number)?;
    let peer = request.peer;
    if world.owner_of(number) == Some(peer) {
        world.lose(number, Reason::Released, Some(peer), out);
    } else {
        let error = WireError::new(Code::WITHDRAWN, "released while it waited");
        if !world.withdraw(number, peer, &error, out) {
            world.check_owner(request, number)?;
        }
    }
    request.push_ok(world, None, out);
    Ok(())
}

/// A release that names an ownership does not end a later one: it may have been under way for long.
fn check_fence(world: &World, request: &Request, number: ContextNumber) -> Result<(), WireError> {
    let (Some(given), Some(token)) = (request.parcel.fence, world.token(number)) else {
        return Ok(());
    };
    let (present, path) = (u64::from(token.fence), &request.path);
    let error = match given.cmp(&present) {
        Ordering::Equal => return Ok(()),
        Ordering::Less => {
            let text = format!("{path} has changed hands since that fence; it is {present} now");
            WireError::new(Code::OLDER_FENCE, text)
        }
        Ordering::Greater => {
            let text = format!("the fence of {path} is {present}, a higher one was never given out");
            WireError::new(Code::BAD_FENCE, text)
        }
    };
    Err(error.slot("fence").detail("fence", token.fence))
}
