//! `token inhibit`: holding together.

use mom_proto::Map;
use mom_proto::event::Reason;

use super::Request;
use crate::asking::questions::Refusal;
use crate::{Effect, Hub};

/// Holds a token together with others: as long as somebody does, nobody owns it.
pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.find_token(request)?;
    hub.check_near(request, number)?;
    hub.allow(request, number)?;
    let owner = hub.owner_of(number);
    if owner.is_some_and(|owner| owner != request.peer) {
        return Err(hub.held(request.peer, number).into());
    }
    // Or a loan would last as long as the borrower liked.
    hub.check_not_lent(number, "inhibited")?;
    hub.inhibit(number, request.peer, out);
    if owner.is_some() {
        hub.lose(number, Reason::Released, Some(request.peer), out);
    }
    let content = Map::new().with("holders", hub.holders_value(number));
    hub.push_ok(request.peer, request.parcel.id, &request.path, Some(content), out);
    Ok(())
}
