//! `context members`: who is in a context.

use mom_proto::{Map, Value};

use super::Request;
use crate::asking::questions::Refusal;
use crate::world::events::peer_map;
use crate::{Effect, Hub};

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.allowed(request)?;
    let members = hub
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
    hub.push_ok(
        request.peer,
        request.parcel.id,
        &request.path,
        Some(Map::new().with("members", list)),
        out,
    );
    Ok(())
}
