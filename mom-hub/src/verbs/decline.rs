//! `token decline`: no to an offer, or of an owner to who asks.

use mom_proto::{Code, WireError};

use super::accept::{Args, asking, offered};
use super::checks::Request;
use crate::Effect;
use crate::asking::refusal::Refusal;
use crate::content;
use crate::stops::shortened;
use crate::world::World;

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.find_token(request)?;
    let args: Args = content::read_or_default(&request.parcel)?;
    world.allow(request, number)?;
    if let Some(name) = &args.peer {
        world.check_owner(request, number)?;
        let to = asking(world, request, name)?;
        let text = args.text.as_deref().and_then(shortened);
        let text = text.as_deref().unwrap_or("not now");
        let text = format!("{} declined: {text}", world.name_of(request.peer));
        let error = WireError::new(Code::DECLINED, text).rule("the owner's word");
        world.end_asking(number, to, &error, None, out);
    } else {
        offered(world, request)?;
        world.end_offer(number, "declined", out);
    }
    request.push_ok(world, None, out);
    Ok(())
}
