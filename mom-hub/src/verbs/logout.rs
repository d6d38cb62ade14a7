//! `login logout`: the departure of a peer, and what follows when a peer has left.

use mom_proto::Path;
use mom_proto::event::{self, Reason};

use super::checks::Request;
use crate::asking::questions::Questions;
use crate::world::steps::{Leaving, Then};
use crate::world::{Timer, World};
use crate::{Effect, PeerId};

pub(crate) fn on(world: &mut World, questions: &mut Questions, request: &Request, out: &mut Vec<Effect>) {
    // The departure first: a peer that reads `ok` has left everything and owns nothing.
    let then = Then::LogOut(request.parcel.id);
    take_out(world, questions, request.peer, then, out);
}

/// Takes a peer out of the hub, if it is there and not on its way out: it leaves everything, and nobody waits for its
/// answers any more.
pub(crate) fn depart(world: &mut World, questions: &mut Questions, peer: PeerId, out: &mut Vec<Effect>) {
    if world.peers.get(peer).is_some() && !world.is_leaving(peer, &Path::root()) {
        take_out(world, questions, peer, Then::Forget, out);
    }
}

fn take_out(world: &mut World, questions: &mut Questions, peer: PeerId, then: Then, out: &mut Vec<Effect>) {
    let leaving = Leaving {
        peer,
        top: Path::root(),
        reason: Reason::Disconnected,
        then,
    };
    if let Some(left) = world.leave(leaving, out) {
        follow(world, questions, left, out);
    }
}

/// Carries out what follows when a peer has left.
pub(crate) fn follow(world: &mut World, questions: &mut Questions, left: Leaving, out: &mut Vec<Effect>) {
    let Leaving { peer, top, then, .. } = left;
    match then {
        Then::Answer(id) => world.push_ok(peer, id, &top, None, out),
        Then::Forget => forget(world, questions, peer, out),
        Then::LogOut(id) => {
            forget(world, questions, peer, out);
            world.push_ok(peer, id, &top, None, out);
            out.push(Effect::Close { peer, error: None });
        }
        Then::Expelled(expulsion) => {
            world.push_event(event::EXPELLED, &top, expulsion.told, expulsion.content, out);
            if expulsion.close.is_some() {
                forget(world, questions, peer, out);
                out.push(Effect::Close {
                    peer,
                    error: expulsion.close,
                });
            }
            let answer = expulsion.answer;
            if let Some((by, id)) = answer.filter(|(by, _)| world.peers.get(*by).is_some()) {
                world.push_ok(by, id, &top, None, out);
            }
        }
    }
}

/// Forgets a peer that has left everything.
fn forget(world: &mut World, questions: &mut Questions, peer: PeerId, out: &mut Vec<Effect>) {
    // It may have gone on its way out, too.
    if world.peers.get(peer).is_none() {
        return;
    }
    let fact = world.fact("gone", peer);
    questions.refuse_all_of(world, peer, out);
    world.audit(fact, out);
    let rest = world.after(world.settings.name_rest);
    let gone = world.peers.remove(peer, rest);
    if let Some(until) = gone.and_then(|gone| gone.lost) {
        world.timers.remove(&(until, Timer::Grace(peer)));
    }
    world.tree.forget(peer, usize::MAX);
    for question in questions.left_by(peer) {
        let due = questions.unanswered(world, question, out);
        super::run_all(world, questions, due, out);
    }
}
