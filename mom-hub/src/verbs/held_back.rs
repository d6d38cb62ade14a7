//! Requests on a token whose change of owner is being stored wait for the end of that, in their order.

use mom_proto::{Code, ContextNumber, Family, WireError};

use super::checks::Request;
use crate::Effect;
use crate::asking::questions::{Due, Questions, take_parcel};
use crate::token::queue::MOST;
use crate::token::state::HeldBack;
use crate::world::World;

/// Requests of one peer that wait for one token.
const MOST_OF_ONE: usize = 16;

/// Puts a request aside if it is about a token whose change of owner is being stored; whether it was.
///
/// # Errors
/// `try-later` if too many wait there already.
pub(super) fn hold_back(world: &mut World, request: &mut Request) -> Result<bool, WireError> {
    if request.verb.family() != Family::Token {
        return Ok(false);
    }
    let found = world.tree.token_at(&request.path);
    let granting = found.filter(|(_, token)| token.granting.is_some());
    let number = granting.map(|(number, _)| number);
    let Some((number, token)) = number.zip(number.and_then(|number| world.token_mut(number))) else {
        return Ok(false);
    };
    // A few of each peer: nobody else's renewal may fail for them.
    let mine = token.held_back.iter().filter(|held| held.peer == request.peer);
    if token.held_back.len() >= MOST || mine.count() >= MOST_OF_ONE {
        let text = "too many requests wait for this token";
        return Err(WireError::new(Code::TRY_LATER, text));
    }
    if let Some((_, ticket)) = request.waiter {
        // It waits on in the queue, and is looked at when that is over.
        token.set_asking(ticket, false);
        return Ok(true);
    }
    token.held_back.push_back(HeldBack {
        peer: request.peer,
        parcel: take_parcel(&mut request.parcel),
        answers: std::mem::take(&mut request.answers),
    });
    world.involve(request.peer, number);
    Ok(true)
}

/// Carries out the requests that have waited for a change of owner, up to the next change that has to be stored.
pub(crate) fn run_held_back(
    world: &mut World,
    questions: &mut Questions,
    number: ContextNumber,
    out: &mut Vec<Effect>,
) {
    // A request may delete the token.
    while let Some(token) = world.token_mut(number).filter(|token| token.granting.is_none()) {
        let Some(HeldBack {
            peer,
            parcel,
            answers,
        }) = token.held_back.pop_front()
        else {
            return;
        };
        world.uninvolve(peer, number);
        let due = Due {
            answers,
            ..Due::new(peer, parcel)
        };
        super::run(world, questions, due, out);
    }
}
