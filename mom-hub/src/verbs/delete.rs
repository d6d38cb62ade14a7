//! `context delete`: a context with all below it.

use mom_proto::{Code, WireError};

use super::checks::Request;
use crate::Effect;
use crate::asking::refusal::Refusal;
use crate::world::World;

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.allowed(request)?;
    let permanent = world
        .tree
        .subtree(number)
        .into_iter()
        .filter_map(|below| world.tree.get(below));
    if let Some(context) = permanent.into_iter().find(|context| context.permanent) {
        let text = format!("{} belongs to the configuration and stays", context.path);
        return Err(WireError::new(Code::PERMANENT, text).slot("context").into());
    }
    world.delete(number, Some(request.peer), out);
    request.push_ok(world, None, out);
    Ok(())
}
