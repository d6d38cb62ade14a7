//! One device for a guarded channel: two that obey the same commands would both move.

use mom_proto::{Code, ContextNumber, Map, WireError};

use crate::PeerId;
use crate::tree::context::Context;
use crate::tree::installation::Installation;
use crate::tree::member::Member;
use crate::world::World;

impl Context {
    /// Whether a channel has one device at most.
    pub(crate) fn has_one_device(&self) -> bool {
        let channel = self.channel();
        channel.is_some_and(|channel| {
            channel
                .several
                .map_or(channel.guard.is_some(), |several| !several)
        })
    }
}

impl World {
    /// The devices whose place one takes that joins a channel: what has lost its link, and the same installation, started before.
    ///
    /// # Errors
    /// `occupied`, with the device that is there.
    pub(crate) fn displaced(
        &self,
        channel: ContextNumber,
        peer: PeerId,
        installation: Option<&Installation>,
    ) -> Result<Vec<PeerId>, WireError> {
        let context = self.tree.get(channel).filter(|context| context.has_one_device());
        let (Some(context), Some(joins)) = (context, self.peers.get(peer)) else {
            return Ok(Vec::new());
        };
        let others = context.members.values();
        let others = others.filter(|member| member.device && member.peer != peer);
        let mut displaced = Vec::new();
        for other in others {
            let is_lost = self
                .peers
                .get(other.peer)
                .is_none_or(|known| known.lost.is_some());
            let is_same = other.facts.user == joins.facts.user
                && installation
                    .zip(other.installation.as_deref())
                    .is_some_and(|(new, old)| new.follows(old));
            if !is_lost && !is_same {
                return Err(occupied(context, other));
            }
            displaced.push(other.peer);
        }
        Ok(displaced)
    }
}

fn occupied(context: &Context, by: &Member) -> WireError {
    let text = format!(
        "{} is already the device in {}: end it first, or set devices = \"several\" on the channel to allow several",
        by.facts.name, context.path
    );
    let details = Map::new()
        .with("peer", &*by.facts.name)
        .with("user", &*by.facts.user);
    WireError::new(Code::OCCUPIED, text).detail("device", details)
}
