//! `token release`: the owner gives the token back, or who waits takes that back.

use mom_proto::event::Reason;
use mom_proto::{Code, WireError};

use super::Request;
use crate::asking::questions::Refusal;
use crate::{Effect, Hub};

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.allowed_token(request)?;
    let peer = request.peer;
    if hub.owner_of(number) == Some(peer) {
        hub.lose(number, Reason::Released, Some(peer), out);
    } else {
        let error = WireError::new(Code::WITHDRAWN, "released while it waited");
        if !hub.withdraw(number, peer, &error, out) {
            hub.check_owner(request, number)?;
        }
    }
    hub.push_ok(peer, request.parcel.id, &request.path, None, out);
    Ok(())
}
