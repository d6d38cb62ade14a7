//! `token request`: a peer asks the owner to hand over; both see it, and one answer comes.

use mom_proto::{Code, Verb, WireError};
use serde::Deserialize;

use super::checks::Request;
use super::grab;
use crate::Effect;
use crate::asking::refusal::Refusal;
use crate::content;
use crate::stops::shortened;
use crate::token::handover::ASKING;
use crate::token::state::Asking;
use crate::world::World;

#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Args {
    /// How long the owner has to answer, ms.
    within: u64,
    /// Plain words for the owner.
    text: Option<String>,
}

impl Default for Args {
    fn default() -> Args {
        Args {
            within: 30_000,
            text: None,
        }
    }
}

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let args: Args = content::read_or_default(&request.parcel)?;
    let within = content::micros(args.within, "within")?;
    let number = world.find_token(request)?;
    world.check_near(request, number)?;
    // With nobody to ask it is a grab, and the manager is asked about that.
    let Some(owner) = world.owner_of(number).filter(|owner| *owner != request.peer) else {
        return grab::at_once(world, request, number, out);
    };
    world.allow(request, number)?;
    let token = world.token(number);
    if token.is_some_and(|token| token.asks(request.peer)) {
        let text = "this peer already has a pending request; wait for the answer";
        return Err(WireError::new(Code::TRY_LATER, text).into());
    }
    if token.is_some_and(|token| token.asking.len() >= ASKING) {
        let text = format!("{ASKING} peers already have pending requests, the limit");
        return Err(WireError::new(Code::FULL, text).into());
    }
    world.check_again(number, (Verb::Request, request.peer, owner))?;
    // The owner hears of each, also of those that have lapsed.
    world.count_wish(request.peer, owner)?;
    world.last_waiter += 1;
    let asking = Asking {
        peer: request.peer,
        owner,
        ticket: world.last_waiter,
        id: request.parcel.id,
        until: world.after(within),
    };
    let text = args.text.as_deref().and_then(shortened);
    world.push_requested(number, asking, text.as_deref(), out);
    Ok(())
}
