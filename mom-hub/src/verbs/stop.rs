//! `context stop` and `context unstop`: a channel that need not be joined, or all channels below a session (M43).

use mom_proto::{Code, ContextKind, WireError};

use super::checks::Request;
use crate::Effect;
use crate::asking::refusal::Refusal;
use crate::stops::begin;
use crate::world::World;

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let kind = world.tree.find(&request.path).map(|context| context.kind());
    let number = match kind {
        // Of a session each channel is asked about by itself.
        Some(ContextKind::Session) => match world.seen_at(request.peer, &request.path) {
            Some(number) => number,
            None => return Err(world.absent(request).into()),
        },
        _ => world.allowed(request)?,
    };
    if kind == Some(ContextKind::Token) {
        let text = format!("{} is a token; devices are in channels", request.path);
        return Err(WireError::new(Code::WRONG_KIND, text).slot("context").into());
    }
    let asked = (request.peer, request.parcel.id);
    Ok(begin(world, asked, request.verb, number, &request.parcel, out)?)
}
