//! `token accept`: the answer to an offer, and that of an owner to who asks.

use mom_proto::event::Reason;
use mom_proto::{Code, Verb, WireError};
use serde::Deserialize;

use super::checks::Request;
use crate::asking::consult::Allowed;
use crate::asking::refusal::Refusal;
use crate::asking::wish::Wish;
use crate::content;
use crate::token::state::Change;
use crate::world::World;
use crate::{Effect, PeerId};

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct Args {
    /// Whose request the owner answers; absent = the offer made to this peer.
    pub(super) peer: Option<String>,
    /// Plain words for the peer that is declined.
    pub(super) text: Option<String>,
}

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let args: Args = content::read_or_default(&request.parcel)?;
    let number = world.find_token(request)?;
    let (peer, answers) = (request.peer, vec![(request.peer, request.parcel.id)]);
    world.check_tell_pace(peer, number)?;
    if let Some(name) = &args.peer {
        let owner = world.check_owner(request, number);
        owner.map_err(|error| world.unless_denied(request, number, error))?;
        world.check_not_lent(number, "given on")?;
        // It gives the token away, which its manager may reserve for others.
        if world.refused(peer, Verb::Give, number) {
            let text = "this peer may not give it to another";
            return Err(WireError::new(Code::DENIED, text).into());
        }
        let to = asking(world, request, name)?;
        world.check_tell_pace(to, number)?;
        // The peer that asked must be allowed to accept, as if it had been offered; the owner's word is not enough.
        let Allowed { rule, grant } = world.ask(to, &Wish::new(Verb::Accept, number), &request.answers)?;
        // The request cannot time out any more while the owner's yes is being stored.
        let asking = world.take_asking(number, to);
        world.forget_asked(number, (Verb::Request, to, peer));
        let answers = answers.into_iter().chain(asking.map(|asking| (to, asking.id)));
        let change = Change {
            from: Some(peer),
            rule,
            until: grant.until,
            answers: answers.collect(),
            ..Change::to(to, Reason::Given)
        };
        world.begin_grant(number, change, out);
        return Ok(());
    }
    let offer = offered(world, request);
    offer.map_err(|error| world.unless_denied(request, number, error))?;
    let Allowed { rule, grant } = world.allow(request, number)?;
    let owner = world.owner_of(number);
    let Some(offer) = world.take_offer(number) else {
        return Err(world.faulted("accepting an offer that does not exist").into());
    };
    world.forget_asked(number, (Verb::Give, offer.by, peer));
    let change = Change {
        from: owner,
        given: Some((offer.time, offer.commands)),
        rule,
        until: grant.until,
        answers,
        ..Change::to(peer, Reason::Given)
    };
    world.begin_grant(number, change, out);
    Ok(())
}

/// The peer of this name that has asked the owner.
pub(super) fn asking(world: &World, request: &Request, name: &str) -> Result<PeerId, WireError> {
    let token = world.tree.token_at(&request.path);
    let peer = world.peers.id_of(name);
    let peer = peer.filter(|peer| token.is_some_and(|(_, token)| token.asks(*peer)));
    peer.ok_or_else(|| {
        let text = format!("{name:?} has no open request for {}", request.path);
        WireError::new(Code::NO_OFFER, text).slot("content/peer")
    })
}

/// Checks that there is an offer to the peer.
pub(super) fn offered(world: &World, request: &Request) -> Result<(), WireError> {
    let token = world.tree.token_at(&request.path);
    let offer = token.and_then(|(_, token)| token.offer.as_ref());
    if offer.is_some_and(|offer| offer.to == request.peer) {
        return Ok(());
    }
    let text = format!("there is no open offer of {} to this peer", request.path);
    Err(WireError::new(Code::NO_OFFER, text))
}
