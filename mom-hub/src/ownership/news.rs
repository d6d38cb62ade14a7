//! What members hear, and the audit log notes, of a token that gains or loses its owner.

use std::collections::BTreeSet;
use std::sync::Arc;

use mom_proto::event::{self, Reason};
use mom_proto::{ContextNumber, Fence, Map};

use super::describe::granted;
use crate::world::World;
use crate::world::events::peer_map;
use crate::{Audit, Effect, PeerId};

/// An ownership that has ended, and how.
pub(super) struct Ended {
    pub(super) peer: PeerId,
    pub(super) fence: Fence,
    pub(super) reason: Reason,
    pub(super) by: Option<PeerId>,
}

pub(super) fn push_released(world: &World, number: ContextNumber, ended: &Ended, out: &mut Vec<Effect>) {
    let Some(context) = world.tree.get(number) else {
        return world.fault("releasing a token that does not exist");
    };
    let by = ended.by.map(|by| world.name_of(by));
    let mut content = Map::new()
        .with("owner", world.name_of(ended.peer))
        .with("reason", ended.reason.word());
    if let Some(by) = &by {
        content.set("by", by.as_str());
    }
    content.set("fence", ended.fence);
    let mut to = concerned(world, number);
    to.insert(ended.peer);
    world.push_event(
        event::RELEASED,
        &context.path,
        to.into_iter().collect(),
        content,
        out,
    );
    let fact = Audit {
        context: Some(context.path.clone()),
        fence: Some(ended.fence.into()),
        reason: Some(ended.reason),
        by: by.map(Into::into),
        ..world.fact("lost", ended.peer)
    };
    world.audit(fact, out);
}

pub(super) fn push_grabbed(
    world: &World,
    number: ContextNumber,
    new: PeerId,
    reason: Reason,
    rule: Option<Arc<str>>,
    out: &mut Vec<Effect>,
) {
    let context = world.tree.get(number);
    let Some((context, token)) = context.and_then(|context| Some((context, context.token()?))) else {
        return world.fault("granting a token that does not exist");
    };
    let mut content = Map::new().with("owner", world.name_of(new));
    content.set("level", world.owner_level(token).unwrap_or_default());
    for (key, value) in granted(world, number) {
        content.set(&key, value);
    }
    let mut to = concerned(world, number);
    // A token that returns by itself answers no request, so the owner is told by the event.
    if reason == Reason::Returned {
        to.insert(new);
    }
    world.push_event(
        event::GRABBED,
        &context.path,
        to.into_iter().collect(),
        content,
        out,
    );
    let fact = Audit {
        context: Some(context.path.clone()),
        fence: Some(token.fence.into()),
        reason: Some(reason).filter(|reason| *reason != Reason::Released),
        rule,
        ..world.fact("granted", new)
    };
    world.audit(fact, out);
}

impl World {
    /// Tells the peers that a token concerns that its owner has lost its connection, or has come back.
    pub(crate) fn push_link(&self, number: ContextNumber, owner: PeerId, out: &mut Vec<Effect>) {
        let (Some(context), Some(known)) = (self.tree.get(number), self.peers.get(owner)) else {
            return self.fault("a token or its owner does not exist");
        };
        let mut content = peer_map(&known.facts);
        let name = match known.lost {
            Some(until) => {
                content.set("within", self.millis_until(until));
                event::LOST
            }
            None => event::RESUMED,
        };
        let to = concerned(self, number).into_iter().collect();
        self.push_event(name, &context.path, to, content, out);
    }
}

/// The members of a token and of the channels that it guards.
pub(super) fn concerned(world: &World, number: ContextNumber) -> BTreeSet<PeerId> {
    let mut peers: BTreeSet<PeerId> = world.tree.members_of(number).into_iter().collect();
    for channel in world.token(number).into_iter().flat_map(|token| &token.guarded) {
        peers.extend(world.tree.members_of(*channel));
    }
    peers
}
