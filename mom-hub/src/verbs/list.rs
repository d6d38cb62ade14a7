//! `context list`: the children of a session.

use mom_proto::{ContextKind, ContextNumber, Map, Value, Verb};

use super::{Request, of_kind};
use crate::asking::consult::Wish;
use crate::asking::questions::Refusal;
use crate::{Effect, Hub};

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.allowed(request)?;
    let Some(context) = hub.tree.get(number) else {
        return Err(hub.unknown_path(&request.path, None).into());
    };
    of_kind(context, ContextKind::Session, Verb::List)?;
    let children: Vec<ContextNumber> = context.children.values().copied().collect();
    let mut list = Vec::with_capacity(children.len());
    for child in children {
        // What a peer may not look up it is not told of.
        if hub.ask(request.peer, &Wish::new(Verb::Lookup, child)).is_err() {
            continue;
        }
        if let Some(child) = hub.tree.get(child) {
            let members = i64::try_from(child.members.len()).unwrap_or(i64::MAX);
            list.push(Value::Map(
                child
                    .summary()
                    .with("name", child.path.name())
                    .with("members", members),
            ));
        }
    }
    hub.push_ok(
        request.peer,
        request.parcel.id,
        &request.path,
        Some(Map::new().with("children", list)),
        out,
    );
    Ok(())
}
