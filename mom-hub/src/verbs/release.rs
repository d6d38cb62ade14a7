//! `token release`: the owner gives the token back.

use mom_proto::WireError;
use mom_proto::event::Reason;

use super::Request;
use crate::{Effect, Hub};

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), WireError> {
    let number = hub.allowed_token(request)?;
    hub.check_owner(request, number)?;
    hub.lose(number, Reason::Released, Some(request.peer), out);
    hub.push_ok(request.peer, request.parcel.id, &request.path, None, out);
    Ok(())
}
