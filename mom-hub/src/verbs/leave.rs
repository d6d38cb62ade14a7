//! `context leave`: out of a context and of all below it (M23).

use mom_proto::event::Reason;
use mom_proto::{Code, WireError};

use super::Request;
use crate::asking::questions::Refusal;
use crate::{Effect, Hub};

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.allowed(request)?;
    if request.path.is_root() {
        let text = "every peer stays in the root; to go, log out";
        return Err(WireError::new(Code::WRONG_KIND, text).slot("context").into());
    }
    if !hub.is_member(request.peer, number) {
        let text = format!("{} was not joined", request.path);
        return Err(WireError::new(Code::NOT_MEMBER, text).slot("context").into());
    }
    hub.leave(number, request.peer, Reason::Released, out);
    hub.push_ok(request.peer, request.parcel.id, &request.path, None, out);
    Ok(())
}
