//! `context list`: the children of a session.

use mom_proto::{ContextKind, ContextNumber, Map, Value, Verb};

use super::checks::{Request, of_kind};
use crate::Effect;
use crate::asking::refusal::Refusal;
use crate::asking::wish::Wish;
use crate::values::count;
use crate::world::World;

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.allowed(request)?;
    let Some(context) = world.tree.get(number) else {
        return Err(world
            .faulted("a manager has allowed something where nothing is")
            .into());
    };
    of_kind(context, ContextKind::Session, Verb::List)?;
    let children: Vec<ContextNumber> = context.children.values().copied().collect();
    let mut list = Vec::with_capacity(children.len());
    for child in children {
        // A child that the peer may not look up is left out.
        if world
            .ask(request.peer, &Wish::new(Verb::Lookup, child), &request.answers)
            .is_err()
        {
            continue;
        }
        if let Some(child) = world.tree.get(child) {
            let members = count(child.members.len());
            list.push(Value::Map(
                child
                    .summary()
                    .with("name", child.path.name())
                    .with("members", members),
            ));
        }
    }
    request.push_ok(world, Some(Map::new().with("children", list)), out);
    Ok(())
}
