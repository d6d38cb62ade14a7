//! `context members`: who is in a context.

use mom_proto::{Map, Value};

use super::checks::Request;
use crate::Effect;
use crate::asking::refusal::Refusal;
use crate::world::World;
use crate::world::events::peer_map;

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.allowed(request)?;
    let members = world
        .tree
        .get(number)
        .into_iter()
        .flat_map(|context| context.members.values());
    let list: Vec<Value> = members
        .map(|member| {
            let mut map = peer_map(&member.facts);
            member.thinning.describe(&mut map);
            Value::Map(map)
        })
        .collect();
    request.push_ok(world, Some(Map::new().with("members", list)), out);
    Ok(())
}
