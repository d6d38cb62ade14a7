//! `token uninhibit`: the end of holding together.

use mom_proto::event::Reason;
use mom_proto::{Code, WireError};

use super::Request;
use crate::asking::questions::Refusal;
use crate::{Effect, Hub};

/// Ends one's own part of that.
pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.find_token(request)?;
    hub.allow(request, number)?;
    if !hub.uninhibit(number, request.peer, Reason::Released.word(), out) {
        let text = format!("this peer has no part in a shared hold of {}", request.path);
        return Err(WireError::new(Code::NOT_OWNER, text).into());
    }
    hub.push_ok(request.peer, request.parcel.id, &request.path, None, out);
    Ok(())
}
