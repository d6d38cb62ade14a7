//! `login logout`: the departure of a peer.

use mom_proto::Path;
use mom_proto::event::Reason;

use super::checks::Request;
use crate::asking::questions::Questions;
use crate::world::World;
use crate::{Effect, PeerId};

pub(crate) fn on(world: &mut World, questions: &mut Questions, request: &Request, out: &mut Vec<Effect>) {
    // The departure first: whoever reads `ok` has left everything and owns nothing.
    depart(world, questions, request.peer, out);
    world.push_ok(request.peer, request.parcel.id, &Path::root(), None, out);
    out.push(Effect::Close {
        peer: request.peer,
        error: None,
    });
}

/// Takes a peer out of the hub, if it is there: it leaves everything, and nobody waits for its answers any more.
pub(crate) fn depart(world: &mut World, questions: &mut Questions, peer: PeerId, out: &mut Vec<Effect>) {
    if world.peers.get(peer).is_none() {
        return;
    }
    let fact = world.fact("gone", peer);
    match world.tree.root().map(|root| root.number) {
        Some(root) => world.leave(root, peer, Reason::Disconnected, out),
        None => world.fault("there is no root to leave"),
    }
    questions.refuse_all_of(world, peer, out);
    world.audit(fact, out);
    let rest = world.after(world.settings.name_rest);
    world.peers.remove(peer, rest);
    world.tree.forget(peer);
    for question in questions.left_by(peer) {
        let due = questions.unanswered(world, question, out);
        super::run_all(world, questions, due, out);
    }
}
