//! `token break`: taking a token away.

use mom_proto::Map;
use mom_proto::event::Reason;

use super::checks::Request;
use crate::asking::refusal::Refusal;
use crate::world::World;
use crate::{Effect, PeerId};

/// Takes a token away from its owner, from all who hold it together, and from the owner of before a restart.
pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.allowed_token(request)?;
    let owner = world.owner_of(number).map(|owner| world.name_of(owner));
    let mut content = Map::new();
    if let Some(owner) = owner {
        content.set("owner", owner);
    }
    let shared = world.token(number).filter(|token| !token.holders.is_empty());
    if let Some(token) = shared {
        content.set("holders", world.holders_value(token));
    }
    let holders = shared.map(|token| token.holders.keys().copied().collect());
    let holders: Vec<PeerId> = holders.unwrap_or_default();
    world.lose(number, Reason::Broken, Some(request.peer), out);
    for holder in holders {
        world.uninhibit(number, holder, Reason::Broken.word(), out);
    }
    world.end_reservation(number, out);
    request.push_ok(world, Some(content), out);
    Ok(())
}
