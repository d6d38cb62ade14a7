//! `context leave`: out of a context and of all below it (M23).

use mom_proto::event::Reason;
use mom_proto::{Code, WireError};

use super::checks::Request;
use crate::Effect;
use crate::asking::refusal::Refusal;
use crate::world::World;

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.allowed(request)?;
    if request.path.is_root() {
        let text = "every peer stays in the root; to go, log out";
        return Err(WireError::new(Code::WRONG_KIND, text).slot("context").into());
    }
    if !world.tree.is_member(request.peer, number) {
        let text = format!("{} was not joined", request.path);
        return Err(WireError::new(Code::NOT_MEMBER, text).slot("context").into());
    }
    world.leave(number, request.peer, Reason::Released, out);
    request.push_ok(world, None, out);
    Ok(())
}
