//! A login, the first one of a connection or another (M13).

use std::sync::Arc;

use mom_proto::{Code, ContextNumber, Family, Map, PROTOCOL_VERSION, Parcel, Path, Value, WireError};

use crate::asking::questions::Questions;
use crate::verbs::{depart, kept_out};
use crate::world::World;
use crate::world::events::peer_map;
use crate::{Effect, PeerId, User};

/// Takes in a peer that has proved who it is.
pub(super) fn log_in(
    world: &mut World,
    questions: &mut Questions,
    (peer, user, nickname): (PeerId, User, Option<String>),
    id: Option<u64>,
    out: &mut Vec<Effect>,
) {
    if let Some(error) = kept_out(world, &user.name) {
        return refuse(world, peer, id, &error, out);
    }
    let details = user.details.clone();
    let same_user = world.peers.get(peer).map(|known| *known.facts.user == *user.name);
    match same_user {
        Some(true) => refresh(world, peer, user),
        known => {
            // Another user on the same connection is another peer: it inherits nothing.
            if known.is_some() {
                depart(world, questions, peer, out);
                if world.peers.get(peer).is_some() || world.leaving.contains_key(&peer) {
                    let text = "this peer has joined too many contexts to change its user; reconnect instead";
                    refuse(world, peer, id, &WireError::new(Code::TRY_LATER, text), out);
                    return;
                }
            }
            let name = nickname.unwrap_or_else(|| user.name.clone());
            world.peers.add(peer, user, &name, world.now);
            match world.tree.root().map(|root| root.number) {
                Some(root) => world.add_member(root, peer, out),
                None => world.fault("there is no root to join"),
            }
        }
    }
    let mut content = welcome(world, peer);
    details
        .into_iter()
        .for_each(|(key, value)| content.set(&key, value));
    world.push_ok(peer, id, &Path::root(), Some(content), out);
    let fact = world.fact("login", peer);
    world.audit(fact, out);
}

/// Refuses a login, and ends the connection; the refusal says why.
fn refuse(world: &World, peer: PeerId, id: Option<u64>, error: &WireError, out: &mut Vec<Effect>) {
    let parcel = Parcel::new(Family::Login, "login");
    let parcel = id.into_iter().fold(parcel, Parcel::id);
    world.push_refusal(peer, &parcel, error, out);
    out.push(Effect::Close { peer, error: None });
}

/// Puts the facts of a repeated login everywhere; verdicts about the old ones stand no more.
pub(super) fn refresh(world: &mut World, peer: PeerId, user: User) {
    let Some(facts) = world.peers.update(peer, user) else {
        return world.fault("a second login of a peer that does not exist");
    };
    let Some(known) = world.peers.get(peer) else {
        return world.fault("changing the login of a peer that does not exist");
    };
    let joined: Vec<ContextNumber> = known.joined.iter().copied().collect();
    let tokens: Vec<ContextNumber> = known.owns.iter().chain(&known.involved).copied().collect();
    for number in joined {
        let context = world.tree.get_mut(number);
        let Some(member) = context.and_then(|context| context.members.get_mut(&peer)) else {
            world.fault::<()>("a peer has joined a context that does not list it");
            continue;
        };
        *member = Arc::new(member.unjudged(Arc::clone(&facts)).holding(false));
        world.changed.insert(number);
    }
    // Routes show the level of the owner, or of its giver, also those of channels that it has not joined.
    tokens
        .into_iter()
        .for_each(|token| world.change_guarded_routes(token));
}

fn welcome(world: &World, peer: PeerId) -> Map {
    let Some(peer) = world.peers.get(peer) else {
        return world.fault("welcoming a peer that does not exist");
    };
    let groups = peer.facts.groups.iter();
    let groups: Vec<Value> = groups.map(|group| Value::from(group.as_str())).collect();
    let (major, minor) = PROTOCOL_VERSION;
    peer_map(&peer.facts)
        .with("groups", groups)
        .with(
            "protocol",
            Map::new()
                .with("major", i32::from(major))
                .with("minor", i32::from(minor)),
        )
        .with("limits", world.settings.limits.to_map())
        .with("time", world.wall())
}
