//! `context what-if`: what another configuration would have decided. Who may ask is decided here; the broker has the
//! recording, and the text of the configuration.

use mom_proto::{Code, WireError};

use super::checks::Request;
use crate::asking::refusal::Refusal;
use crate::world::World;
use crate::{Effect, Inquiry};

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    world.allowed(request)?;
    if !request.path.is_root() {
        let text = "a configuration applies to the whole hub: send what-if to /";
        return Err(WireError::new(Code::BAD_SLOT, text).slot("context").into());
    }
    let inquiry = Inquiry::WhatIf {
        content: request.parcel.content.clone(),
    };
    request.push_inquiry(world, inquiry, out);
    Ok(())
}
