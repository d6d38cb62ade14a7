//! `token accept`: the answer to an offer, and that of an owner to who asks.

use mom_proto::event::Reason;
use mom_proto::{Code, Verb, WireError};
use serde::Deserialize;

use super::Request;
use crate::asking::consult::{Allowed, Wish};
use crate::asking::questions::Refusal;
use crate::ownership::grant::Change;
use crate::tree::spec as args;
use crate::{Effect, Hub, PeerId};

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct Args {
    /// Whose request the owner answers; absent = the offer made to this peer.
    pub(super) peer: Option<String>,
    /// Plain words for who is declined.
    pub(super) text: Option<String>,
}

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let args: Args = args::read_or_default(&request.parcel)?;
    let number = hub.find_token(request)?;
    let (peer, answers) = (request.peer, vec![(request.peer, request.parcel.id)]);
    if let Some(name) = &args.peer {
        let owner = hub.check_owner(request, number);
        owner.map_err(|error| hub.unless_denied(request, number, error))?;
        hub.check_not_lent(number, "given on")?;
        let to = asking(hub, request, name)?;
        // Whether who gains it may have it, as if it had been offered; the owner's word is not enough for that.
        let Allowed { rule, grant } = hub.ask(to, &Wish::new(Verb::Accept, number))?;
        // Its time is not over any more while the owner's yes is being stored.
        let asking = hub.take_asking(number, to);
        hub.forget_asked(number, (Verb::Request, to, peer));
        let answers = answers.into_iter().chain(asking.map(|asking| (to, asking.id)));
        let change = Change {
            from: Some(peer),
            rule,
            until: grant.until,
            answers: answers.collect(),
            ..Change::to(to, Reason::Given)
        };
        hub.hand(number, change, out);
        return Ok(());
    }
    let offer = offered(hub, request);
    offer.map_err(|error| hub.unless_denied(request, number, error))?;
    let Allowed { rule, grant } = hub.allow(request, number)?;
    let owner = hub.owner_of(number);
    let Some(offer) = hub.take_offer(number) else {
        return Ok(());
    };
    hub.forget_asked(number, (Verb::Give, offer.by, peer));
    let change = Change {
        from: owner,
        given: Some((offer.time, offer.commands)),
        rule,
        until: grant.until,
        answers,
        ..Change::to(peer, Reason::Given)
    };
    hub.hand(number, change, out);
    Ok(())
}

/// The peer of this name that has asked the owner.
pub(super) fn asking(hub: &Hub, request: &Request, name: &str) -> Result<PeerId, WireError> {
    let token = hub.tree.find(&request.path).and_then(|context| context.token());
    let peer = hub.peers.id_of(name);
    let asks =
        |peer: &PeerId| token.is_some_and(|token| token.asking.iter().any(|asking| asking.peer == *peer));
    peer.filter(asks).ok_or_else(|| {
        let text = format!("{name:?} does not ask for {}, or not any more", request.path);
        WireError::new(Code::NO_OFFER, text).slot("content/peer")
    })
}

/// Checks that there is an offer to the peer.
pub(super) fn offered(hub: &Hub, request: &Request) -> Result<(), WireError> {
    let token = hub.tree.find(&request.path).and_then(|context| context.token());
    let offer = token.and_then(|token| token.offer.as_ref());
    if offer.is_some_and(|offer| offer.to == request.peer) {
        return Ok(());
    }
    let text = format!("nobody offers {} to this peer, or not any more", request.path);
    Err(WireError::new(Code::NO_OFFER, text))
}
