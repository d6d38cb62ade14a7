//! `context delete`: a context with all below it.

use super::checks::Request;
use crate::Effect;
use crate::asking::refusal::Refusal;
use crate::world::World;

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.allowed(request)?;
    world.tree.check_not_permanent(number)?;
    let answer = Some((request.peer, request.parcel.id));
    world.delete(number, Some(request.peer), answer, out);
    Ok(())
}
