//! `context audit`: who was granted or refused what there, or lost it. Who may ask is decided here; the facts stand in the
//! broker's files, and it asks again about each context below before it tells of it ([`Hub::may_audit`]).
//!
//! [`Hub::may_audit`]: crate::Hub::may_audit

use super::checks::Request;
use crate::asking::refusal::Refusal;
use crate::world::World;
use crate::{Effect, Inquiry};

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    world.allowed(request)?;
    let inquiry = Inquiry::Audit {
        path: request.path.clone(),
        content: request.parcel.content.clone(),
    };
    request.push_inquiry(world, inquiry, out);
    Ok(())
}
