//! The safe state of a token's devices: before anybody else may drive, and before a channel goes.

use std::collections::BTreeSet;
use std::sync::Arc;

use mom_proto::event;
use mom_proto::{Content, ContextNumber, Family, Map, Value};

use super::describe::describe_owner;
use crate::Effect;
use crate::token::state::{SafeState, Token};
use crate::world::World;

/// Sends the safe state of a token.
pub(super) fn push_safe_state(world: &World, number: ContextNumber, out: &mut Vec<Effect>) {
    match world.token(number) {
        Some(token) => push(world, token, &token.guarded, out),
        None => world.fault("sending the safe state for a token that does not exist"),
    }
}

impl World {
    /// Sends the safe state of a channel that is about to be deleted although its token has an owner: no command will
    /// reach its devices any more, not even one to stop what they do.
    pub(crate) fn push_last_safe_state(&self, channel: ContextNumber, out: &mut Vec<Effect>) {
        let guard = self
            .tree
            .get(channel)
            .and_then(|context| context.channel()?.guard.as_ref());
        let token = guard.and_then(|guard| self.tree.token_at(&guard.token));
        if let Some((_, token)) = token.filter(|(_, token)| token.owner.is_some()) {
            push(self, token, &BTreeSet::from([channel]), out);
        }
    }
}

impl World {
    /// Halts the devices of a channel that has another guard from now on, or none, and tells all its members which: what runs there began
    /// when others were allowed to begin it.
    pub(crate) fn push_guard(&self, channel: ContextNumber, out: &mut Vec<Effect>) {
        let Some(context) = self.tree.get(channel) else {
            return self.fault("changing the guard of a channel that does not exist");
        };
        let guard = context.channel().and_then(|channel| channel.guard.as_ref());
        let guard = guard.map_or_else(Map::new, |guard| {
            let token = self.tree.token_at(&guard.token);
            guard.describe(token.map_or_else(Map::new, |(_, token)| describe_owner(self, token)))
        });
        let content = Content::from(Value::from(Map::new().with("guard", guard)));
        push_to(self, channel, event::HALT, Some(content), out);
    }
}

/// Sends the safe state of a token for these of its channels. A fault of the books costs no channel its safe state.
fn push(world: &World, token: &Token, channels: &BTreeSet<ContextNumber>, out: &mut Vec<Effect>) {
    let Some(SafeState {
        channel,
        name,
        content,
    }) = &token.safe
    else {
        for channel in channels {
            if !token.guarded.contains(channel) {
                world.fault::<()>("a token does not list a channel that it guards");
            }
            push_to(world, *channel, event::HALT, None, out);
        }
        return;
    };
    // Only where the token guards: a safe state speaks in the hub's name, which nobody may borrow to talk to other
    // devices.
    let named = world.tree.find(channel).map(|channel| channel.number);
    if let Some(named) = named.filter(|named| token.guarded.contains(named)) {
        push_to(world, named, name, content.clone(), out);
    }
}

fn push_to(
    world: &World,
    channel: ContextNumber,
    name: &str,
    content: Option<Content>,
    out: &mut Vec<Effect>,
) {
    let Some(context) = world.tree.get(channel) else {
        return world.fault("a token guards a channel that does not exist");
    };
    let to: Vec<_> = context.members.keys().copied().collect();
    if to.is_empty() {
        return;
    }
    let mut parcel = world.hub_parcel(Family::Message, name, &context.path);
    parcel.received = parcel.timestamp;
    parcel.content = content;
    out.push(Effect::Deliver {
        to,
        parcel: Arc::new(parcel),
    });
}
