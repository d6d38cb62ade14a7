//! `context leave`: out of a context and of all below it (M23).

use mom_proto::event::Reason;
use mom_proto::{Code, WireError};

use super::checks::Request;
use super::logout::follow;
use crate::Effect;
use crate::asking::questions::Questions;
use crate::asking::refusal::Refusal;
use crate::world::World;
use crate::world::steps::{Leaving, Then};

pub(crate) fn on(
    world: &mut World,
    questions: &mut Questions,
    request: &Request,
    out: &mut Vec<Effect>,
) -> Result<(), Refusal> {
    let number = world.allowed(request)?;
    if request.path.is_root() {
        let text = "a peer cannot leave the root; log out instead";
        return Err(WireError::new(Code::WRONG_KIND, text).slot("context").into());
    }
    if !world.tree.is_member(request.peer, number) {
        let text = format!("{} was not joined", request.path);
        return Err(WireError::new(Code::NOT_MEMBER, text).slot("context").into());
    }
    let leaving = Leaving {
        peer: request.peer,
        top: request.path.clone(),
        reason: Reason::Released,
        then: Then::Answer(request.parcel.id),
    };
    if let Some(left) = world.leave(leaving, out) {
        follow(world, questions, left, out);
    }
    Ok(())
}
