//! `context lookup`: what is at a path (M32).

use super::checks::Request;
use crate::Effect;
use crate::asking::refusal::Refusal;
use crate::world::World;

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.allowed(request)?;
    let content = world.tree.get(number).map(|context| context.summary());
    request.push_ok(world, content, out);
    Ok(())
}
