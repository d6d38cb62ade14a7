//! `token uninhibit`: the end of holding together.

use mom_proto::event::Reason;
use mom_proto::{Code, WireError};

use super::checks::Request;
use crate::Effect;
use crate::asking::refusal::Refusal;
use crate::world::World;

/// Ends one's own part of that.
pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.find_token(request)?;
    world.allow(request, number)?;
    if !world.uninhibit(number, request.peer, Reason::Released.word(), out) {
        let text = format!("this peer does not inhibit {}", request.path);
        return Err(WireError::new(Code::NOT_OWNER, text).into());
    }
    request.push_ok(world, None, out);
    Ok(())
}
