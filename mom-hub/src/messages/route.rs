//! The route of a channel: everything that a send needs, immutable (design §4).

use std::sync::Arc;

use mom_proto::{ContextNumber, Delivery, Family, Micros, Overflow, Path, Time, Verb, event};

use crate::{Keep, Member, PeerId};

/// A channel as it stands: its members, its guard and its settings.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    /// The channel.
    pub number: ContextNumber,
    /// Its path.
    pub path: Path,
    /// Its members, in the order of their numbers.
    pub members: Vec<Arc<Member>>,
    /// The token that guards it.
    pub guard: Option<Guard>,
    /// The delivery class of parcels that name none.
    pub delivery: Delivery,
    /// What happens where a receiver has no room for a `reliable` parcel.
    pub overflow: Overflow,
    /// Bytes that its devices read in a second, as far as known.
    pub pace: Option<u32>,
    /// What is kept for late joiners; none = nothing.
    pub keep: Option<Keep>,
    /// A caller waits for the word of its devices, which comes to the hub then.
    pub awaited: bool,
    /// When a stop was lifted here last, by the hub's time.
    pub lifted: Option<Time>,
}

/// The guard of a channel: its listed messages need ownership of a token.
#[derive(Clone, Debug, PartialEq)]
pub struct Guard {
    /// The token.
    pub token: Path,
    /// The messages; `*` stands for all.
    pub names: Arc<[String]>,
    /// The owner of the token now.
    pub owner: Option<GuardOwner>,
    /// The fence of the latest grant; 0 before the first.
    pub fence: u64,
}

/// The owner of the token that guards a channel.
#[derive(Clone, Debug, PartialEq)]
pub struct GuardOwner {
    /// Its connection.
    pub peer: PeerId,
    /// Its name.
    pub name: Arc<str>,
    /// Its level.
    pub level: i32,
    /// When its lease ends if it does not renew.
    pub lease_end: Option<Micros>,
    /// When the hub takes the token from it by itself: the end of an eager lease, of its deadman time, of its turn.
    pub lost_at: Option<Micros>,
    /// How many commands it still has, where the token was given for a number of them.
    pub commands: Option<u64>,
    /// How often it has lost its connection since it has the token. Each time the safe state went out, and no command of
    /// before may follow it.
    pub halts: u64,
}

impl Route {
    /// When a stop was lifted, if messages of this name that were said before must not follow: they move a device.
    pub(crate) fn lifted_before(&self, name: &str) -> Option<Time> {
        let guarded = || self.guard.as_ref().is_some_and(|guard| guard.covers(name));
        self.lifted.filter(|_| name == event::COMMAND || guarded())
    }

    /// The member of this connection.
    pub fn member(&self, peer: PeerId) -> Option<&Arc<Member>> {
        self.position(peer).map(|position| &self.members[position])
    }

    /// How many members in front are the same connections as in another route.
    pub fn same_front(&self, other: &Route) -> usize {
        let both = self.members.iter().zip(&other.members);
        both.take_while(|(own, other)| own.peer == other.peer).count()
    }

    /// The place of a connection among the members.
    pub fn position(&self, peer: PeerId) -> Option<usize> {
        self.members
            .binary_search_by_key(&peer, |member| member.peer)
            .ok()
    }
}

impl Guard {
    /// Whether messages of this name need the token.
    pub fn covers(&self, name: &str) -> bool {
        let anybodys = matches!(Verb::of(Family::Message, name), Ok(Verb::Stop | Verb::Unstop));
        !anybodys && self.names.iter().any(|listed| listed == name || listed == "*")
    }
}
