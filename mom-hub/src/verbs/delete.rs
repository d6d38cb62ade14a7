//! `context delete`: a context with all below it.

use mom_proto::{Code, WireError};

use super::Request;
use crate::asking::questions::Refusal;
use crate::{Effect, Hub};

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.allowed(request)?;
    let permanent = hub
        .tree
        .subtree(number)
        .into_iter()
        .filter_map(|below| hub.tree.get(below));
    if let Some(context) = permanent.into_iter().find(|context| context.permanent) {
        let text = format!("{} belongs to the configuration and stays", context.path);
        return Err(WireError::new(Code::PERMANENT, text).slot("context").into());
    }
    hub.delete(number, Some(request.peer), out);
    hub.push_ok(request.peer, request.parcel.id, &request.path, None, out);
    Ok(())
}
