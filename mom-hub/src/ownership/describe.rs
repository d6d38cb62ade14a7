//! What replies say of a token: who has it, who waits, what is offered.

use mom_proto::{ContextNumber, Map, Value};

use crate::Hub;
use crate::ownership::change::{fence_value, millis};
use crate::token::state::Token;

impl Hub {
    /// What is known of a token's owner: fence, and with an owner who, since when, lease left.
    pub(crate) fn token_map(&self, token: &Token) -> Map {
        let mut map = Map::new();
        if let Some(owner) = &token.owner {
            map.set("owner", self.name_of(owner.peer));
            map.set("owner-level", self.owner_level(token).unwrap_or_default());
            map.set("held", millis(self.now.saturating_sub(owner.since)));
            map.set(
                "lease-left",
                owner.lease_end.map_or(Value::Null, |end| self.millis_until(end)),
            );
        }
        map.set("fence", fence_value(token.fence));
        map
    }

    /// Who waits for a token, who asks for it, to whom it is offered, who holds it together.
    pub(crate) fn waiting_map(&self, number: ContextNumber) -> Map {
        let Some(token) = self.token(number) else {
            return Map::new();
        };
        let mut map = Map::new();
        if let Some(deadman) = token.terms.deadman {
            map.set("deadman", millis(deadman));
        }
        if !token.holders.is_empty() {
            map.set("holders", self.holders_value(number));
        }
        if !token.queue.is_empty() {
            let queue: Vec<Value> = token
                .queue
                .iter()
                .filter_map(|waiter| {
                    let facts = &self.peers.get(waiter.peer)?.facts;
                    let waiting = millis(self.now.saturating_sub(waiter.since));
                    Some(
                        crate::world::events::peer_map(facts)
                            .with("waiting", waiting)
                            .into(),
                    )
                })
                .collect();
            map.set("queue", queue);
        }
        if let Some(offer) = &token.offer {
            let mut offered = Map::new()
                .with("to", self.name_of(offer.to))
                .with("within", self.millis_until(offer.until));
            if let Some(time) = offer.time {
                offered.set("for", millis(time));
            }
            if let Some(commands) = offer.commands {
                offered.set("commands", fence_value(commands));
            }
            map.set("offer", offered);
        }
        if !token.asking.is_empty() {
            let asking = token.asking.iter().map(|asking| {
                let within = self.millis_until(asking.until);
                let peer = Map::new().with("peer", self.name_of(asking.peer));
                Value::Map(peer.with("within", within))
            });
            map.set("requests", asking.collect::<Vec<_>>());
        }
        let delegation = token.owner.as_ref().and_then(|owner| owner.delegation.as_ref());
        if let Some(delegation) = delegation {
            let mut given = Map::new();
            if let Some(from) = delegation.from {
                given.set("from", self.name_of(from));
            }
            if let Some(until) = delegation.until {
                given.set("left", self.millis_until(until));
            }
            if let Some(commands) = delegation.commands {
                given.set("commands", fence_value(commands));
            }
            map.set("delegated", given);
        }
        if let Some(reserved) = token
            .reserved
            .as_ref()
            .filter(|reserved| self.now < reserved.until)
        {
            let mut kept = Map::new();
            if let Some(holder) = &reserved.holder {
                kept.set("user", holder.user.as_str());
                kept.set("peer", holder.name.as_str());
            }
            map.set("reserved", kept.with("for", self.millis_until(reserved.until)));
        }
        map
    }
}
