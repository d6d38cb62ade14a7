//! `token inhibit`: holding together.

use mom_proto::Map;
use mom_proto::event::Reason;

use super::checks::Request;
use crate::Effect;
use crate::asking::refusal::Refusal;
use crate::world::World;

/// Holds a token together with others: as long as one peer does, nobody owns it.
pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.find_token(request)?;
    world.check_near(request, number)?;
    world.check_tell_pace(request.peer, number)?;
    world.allow(request, number)?;
    let owner = world.owner_of(number);
    if owner.is_some_and(|owner| owner != request.peer) {
        return Err(world.held(request.peer, number).into());
    }
    // Or a loan would last as long as the borrower liked.
    world.check_not_lent(number, "inhibited")?;
    world.count_change(request.peer, number);
    world.inhibit(number, request.peer, out);
    if owner.is_some() {
        world.lose(number, Reason::Released, Some(request.peer), out);
    }
    let holders = world.token(number).map(|token| world.holders_value(token));
    let content = Map::new().with("holders", holders.unwrap_or_default());
    request.push_ok(world, Some(content), out);
    Ok(())
}
