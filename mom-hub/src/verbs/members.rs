//! `context members`: who is in a context, in pages where there are many.

use std::ops::Bound;

use mom_proto::{Map, Value};
use serde::Deserialize;

use super::checks::{PAGE, Request};
use crate::asking::refusal::Refusal;
use crate::content;
use crate::values::number as count;
use crate::world::World;
use crate::world::events::peer_map;
use crate::{Effect, PeerId};

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// Where the page begins: `next` of the one before.
    #[serde(default)]
    after: Option<u64>,
}

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.allowed(request)?;
    let args: Args = content::read_or_default(&request.parcel)?;
    let Some(context) = world.tree.get(number) else {
        return Err(world
            .faulted("a manager allowed a verb on a context that does not exist")
            .into());
    };
    let after = args
        .after
        .map_or(Bound::Unbounded, |after| Bound::Excluded(PeerId(after)));
    let mut members = context.members.range((after, Bound::Unbounded));
    let mut last = None;
    let page = members.by_ref().take(PAGE).map(|(peer, member)| {
        last = Some(*peer);
        let mut map = peer_map(&member.facts);
        member.describe_terms(&mut map);
        if let Some(until) = world.lost_until(*peer) {
            map.set("lost", world.millis_until(until));
        }
        Value::Map(map)
    });
    let page: Vec<Value> = page.collect();
    let more = members.next().is_some();
    let mut content = Map::new().with("members", page);
    if let Some(last) = last.filter(|_| more) {
        content.set("more", true);
        content.set("next", count(last.0));
    }
    request.push_ok(world, Some(content), out);
    Ok(())
}
