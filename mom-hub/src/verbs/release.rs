//! `token release`: the owner gives the token back, or who waits takes that back.

use mom_proto::event::Reason;
use mom_proto::{Code, WireError};

use super::checks::Request;
use crate::Effect;
use crate::asking::refusal::Refusal;
use crate::world::World;

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.allowed_token(request)?;
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
