//! `context lookup`: what is at a path (M32).

use super::Request;
use crate::asking::questions::Refusal;
use crate::{Effect, Hub};

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.allowed(request)?;
    let content = hub.tree.get(number).map(|context| context.summary());
    hub.push_ok(request.peer, request.parcel.id, &request.path, content, out);
    Ok(())
}
