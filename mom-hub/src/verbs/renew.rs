//! `token renew`: the owner begins a new lease (M29); commands do not renew.

use super::checks::Request;
use crate::Effect;
use crate::asking::refusal::Refusal;
use crate::ownership::granted;
use crate::world::World;

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.allowed_token(request)?;
    world.check_owner(request, number)?;
    world.renew_lease(number);
    let content = granted(world, number);
    request.push_ok(world, Some(content), out);
    Ok(())
}
