//! `context list`: the children of a session, in pages where there are many.

use std::ops::Bound;
use std::sync::Arc;

use mom_proto::{ContextKind, ContextNumber, Map, Value, Verb};
use serde::Deserialize;

use super::checks::{PAGE, Request, of_kind};
use crate::Effect;
use crate::Latch;
use crate::asking::refusal::Refusal;
use crate::asking::wish::Wish;
use crate::content;
use crate::values::count;
use crate::world::World;

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// The name after which the page begins: `next` of the one before.
    #[serde(default)]
    after: Option<String>,
}

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.allowed(request)?;
    let args: Args = content::read_or_default(&request.parcel)?;
    let Some(context) = world.tree.get(number) else {
        return Err(world
            .faulted("a manager allowed a verb on a context that does not exist")
            .into());
    };
    of_kind(context, ContextKind::Session, Verb::List)?;
    let after = args.after.as_deref().map_or(Bound::Unbounded, Bound::Excluded);
    let mut children = context.children.range::<str, _>((after, Bound::Unbounded));
    // Those that are left out count too: each is a question to the manager.
    let page: Vec<(Arc<str>, ContextNumber)> = children
        .by_ref()
        .take(PAGE)
        .map(|(name, child)| (Arc::clone(name), *child))
        .collect();
    let more = children.next().is_some();
    let next = page.last().map(|(name, _)| Arc::clone(name)).filter(|_| more);
    let mut list = Vec::with_capacity(page.len());
    for (_, child) in page {
        // A child that the peer may not look up is left out.
        if world
            .ask(request.peer, &Wish::new(Verb::Lookup, child), &request.answers)
            .is_err()
        {
            continue;
        }
        if let Some(child) = world.tree.get(child) {
            let members = count(child.members.len());
            let mut summary = child
                .summary()
                .with("name", child.path.name())
                .with("members", members);
            let latch = child.channel().map(|_| world.stops.latch(&child.path));
            if let Some(latch) = latch.filter(Latch::is_stopped) {
                summary.set("stop", latch.describe());
            }
            list.push(Value::Map(summary));
        }
    }
    let mut content = Map::new().with("children", list);
    if let Some(next) = next {
        content.set("more", true);
        content.set("next", &*next);
    }
    request.push_ok(world, Some(content), out);
    Ok(())
}
