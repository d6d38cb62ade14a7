//! A peer loses its connection and may come back: its devices are made safe at once, its places are kept for a while.

use mom_proto::Path;
use mom_proto::{Code, Micros, WireError, outlives_loss};

use super::logout::depart;
use crate::asking::questions::{Due, Questions};
use crate::world::{Timer, World};
use crate::{Effect, PeerId};

/// Notes that a peer has lost its connection; gives the requests that are due because messages before them are refused.
pub(crate) fn lose(
    world: &mut World,
    questions: &mut Questions,
    peer: PeerId,
    grace: Micros,
    out: &mut Vec<Effect>,
) -> Vec<Due> {
    let until = world.after(grace);
    let leaves = world.is_leaving(peer, &Path::root());
    let Some(known) = world
        .peers
        .get_mut(peer)
        .filter(|known| known.lost.is_none() && !leaves)
    else {
        return Vec::new();
    };
    known.lost = Some(until);
    world.timers.insert((until, Timer::Grace(peer)));
    let fact = world.fact("link-lost", peer);
    world.audit(fact, out);
    // Devices first.
    world.tell_of_link(peer, out);
    refuse_commands(world, questions, peer, out)
}

/// What a peer has said under a token, or to move a device, and what still waits for an answer would come after the safe state.
fn refuse_commands(
    world: &mut World,
    questions: &mut Questions,
    peer: PeerId,
    out: &mut Vec<Effect>,
) -> Vec<Due> {
    let text = "the connection was lost after this was sent, and the safe state has gone out since";
    let older = WireError::new(Code::OLDER_FENCE, text);
    let late = WireError::new(Code::TOO_LATE, "the connection was lost after this was sent");
    let mut due = Vec::new();
    for question in questions.sends_of(peer) {
        let waiting = questions.withdraw_send(world, question);
        for request in waiting {
            let guarded = world.is_guarded(&request.parcel);
            match outlives_loss(&request.parcel, guarded) {
                true => due.push(request),
                false => {
                    let error = if guarded { &older } else { &late };
                    world.push_refusal(peer, &request.parcel, error, out);
                }
            }
        }
    }
    due
}

/// Notes that a peer has come back.
pub(crate) fn resume(world: &mut World, peer: PeerId, out: &mut Vec<Effect>) {
    let until = world.peers.get_mut(peer).and_then(|known| known.lost.take());
    let Some(until) = until else {
        return;
    };
    world.timers.remove(&(until, Timer::Grace(peer)));
    let fact = world.fact("resumed", peer);
    world.audit(fact, out);
    // Before anything else: a device moves nothing until it has heard how it stands.
    world.tell_device_everywhere(peer, out);
    world.tell_of_link(peer, out);
}

/// Ends a peer that has not come back in its time.
pub(crate) fn end_grace(world: &mut World, questions: &mut Questions, peer: PeerId, out: &mut Vec<Effect>) {
    match world.peers.get_mut(peer) {
        Some(known) => known.lost = None,
        None => return world.fault("the grace time of a peer that does not exist has ended"),
    }
    // Who is on its way out for another reason hears that at its end, if anything.
    if world.is_leaving(peer, &Path::root()) {
        return;
    }
    depart(world, questions, peer, out);
    let text = "the connection was not resumed in time";
    let error = Some(WireError::new(Code::DISCONNECTED, text));
    out.push(Effect::Close { peer, error });
}
