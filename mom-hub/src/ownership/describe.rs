//! What replies and events say of a token: its owner, who waits, what is offered.

use mom_proto::{ContextNumber, Map, Value};

use crate::token::state::{Delegation, Offer, Reserved, Token};
use crate::values::{millis, number};
use crate::world::World;
use crate::world::events::peer_map;

/// What is known of a token's owner: fence, and with an owner its name, since when, and how much of the lease is left.
pub(crate) fn describe_owner(world: &World, token: &Token) -> Map {
    let mut map = Map::new();
    if let Some(owner) = &token.owner {
        map.set("owner", world.name_of(owner.peer));
        map.set("owner-level", world.owner_level(token).unwrap_or_default());
        map.set("held", millis(world.now.saturating_sub(owner.since)));
        map.set(
            "lease-left",
            owner.lease_end.map_or(Value::Null, |end| world.millis_until(end)),
        );
        if let Some(until) = world.lost_until(owner.peer) {
            map.set("owner-lost", world.millis_until(until));
        }
    }
    map.set("fence", token.fence);
    map
}

/// Who waits for a token, who asks for it, to whom it is offered, who holds it with others.
pub(crate) fn describe_waiting(world: &World, token: &Token) -> Map {
    let mut map = Map::new();
    if let Some(deadman) = token.terms.deadman {
        map.set("deadman", millis(deadman));
    }
    if !token.holders.is_empty() {
        map.set("holders", world.holders_value(token));
    }
    if !token.queue.is_empty() {
        map.set("queue", queue_value(world, token));
    }
    if let Some(offer) = &token.offer {
        map.set("offer", offer_map(world, offer));
    }
    if !token.asking.is_empty() {
        let asking = token.asking.iter().map(|asking| {
            let within = world.millis_until(asking.until);
            let peer = Map::new().with("peer", world.name_of(asking.peer));
            Value::Map(peer.with("within", within))
        });
        map.set("requests", asking.collect::<Vec<_>>());
    }
    let delegation = token.owner.as_ref().and_then(|owner| owner.delegation.as_ref());
    if let Some(delegation) = delegation {
        map.set("delegated", delegation_map(world, delegation, "left"));
    }
    let reserved = token.reserved.as_ref();
    if let Some(reserved) = reserved.filter(|reserved| world.now < reserved.until) {
        map.set("reserved", reserved_map(world, reserved));
    }
    map
}

fn queue_value(world: &World, token: &Token) -> Vec<Value> {
    let queue = token.queue.iter().filter_map(|waiter| {
        let facts = &world.peers.get(waiter.peer)?.facts;
        let waiting = millis(world.now.saturating_sub(waiter.since));
        Some(peer_map(facts).with("waiting", waiting).into())
    });
    queue.collect()
}

fn offer_map(world: &World, offer: &Offer) -> Map {
    let mut map = Map::new()
        .with("to", world.name_of(offer.to))
        .with("within", world.millis_until(offer.until));
    set_given(&mut map, offer);
    map
}

/// Adds for how long, and for how many commands, an offer gives the token.
pub(super) fn set_given(map: &mut Map, offer: &Offer) {
    if let Some(time) = offer.time {
        map.set("for", millis(time));
    }
    if let Some(commands) = offer.commands {
        map.set("commands", number(commands));
    }
}

/// From whom the owner has the token; the time that is left stands under `left`.
fn delegation_map(world: &World, delegation: &Delegation, left: &str) -> Map {
    let mut map = Map::new();
    if let Some(from) = delegation.from {
        map.set("from", world.name_of(from));
    }
    if let Some(until) = delegation.until {
        map.set(left, world.millis_until(until));
    }
    if let Some(commands) = delegation.commands {
        map.set("commands", number(commands));
    }
    map
}

fn reserved_map(world: &World, reserved: &Reserved) -> Map {
    let mut map = Map::new();
    if let Some(holder) = &reserved.holder {
        map.set("user", holder.user.as_str());
        map.set("peer", holder.name.as_str());
    }
    map.with("for", world.millis_until(reserved.until))
}

/// What an owner is told: fence, lease, deadman time, and from whom it has the token for how long.
pub(crate) fn granted(world: &World, token: ContextNumber) -> Map {
    let Some(token) = world.token(token) else {
        return world.fault("granting a token that does not exist");
    };
    let mut map = Map::new()
        .with("fence", token.fence)
        .with("lease", lease_value(token));
    if let Some(deadman) = token.terms.deadman {
        map.set("deadman", millis(deadman));
    }
    let delegation = token.owner.as_ref().and_then(|owner| owner.delegation.as_ref());
    if let Some(delegation) = delegation {
        for (key, value) in delegation_map(world, delegation, "for") {
            map.set(&key, value);
        }
    }
    map
}

/// The whole lease in ms, null without end.
pub(crate) fn lease_value(token: &Token) -> Value {
    token.terms.lease.map_or(Value::Null, millis)
}
