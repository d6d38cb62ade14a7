//! `token request`: a peer asks the owner to hand over; both see it, and one answer comes.

use mom_proto::{Code, Verb, WireError};
use serde::Deserialize;

use super::{Request, grab};
use crate::asking::questions::Refusal;
use crate::ownership::handover::ASKING;
use crate::token::state::Asking;
use crate::tree::spec as args;
use crate::{Effect, Hub};

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

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let args: Args = args::read_or_default(&request.parcel)?;
    let within = args::micros(args.within, "within")?;
    let number = hub.find_token(request)?;
    hub.check_near(request, number)?;
    // With nobody to ask it is a grab, and the manager is asked about that.
    let Some(owner) = hub.owner_of(number).filter(|owner| *owner != request.peer) else {
        return grab::at_once(hub, request, number, out);
    };
    hub.allow(request, number)?;
    let asking = hub.token(number).map(|token| &token.asking);
    if asking.is_some_and(|asking| asking.iter().any(|asking| asking.peer == request.peer)) {
        let text = "this peer asks already; wait for the answer";
        return Err(WireError::new(Code::TRY_LATER, text).into());
    }
    if asking.is_some_and(|asking| asking.len() >= ASKING) {
        let text = format!("{ASKING} peers ask already, as many as may");
        return Err(WireError::new(Code::FULL, text).into());
    }
    hub.check_again(number, (Verb::Request, request.peer, owner))?;
    hub.last_waiter += 1;
    let asking = Asking {
        peer: request.peer,
        owner,
        ticket: hub.last_waiter,
        id: request.parcel.id,
        until: hub.after(within),
    };
    hub.push_requested(number, asking, args.text.as_deref(), out);
    Ok(())
}
