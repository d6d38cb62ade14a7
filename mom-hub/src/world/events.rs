//! What members are told (M30): the making of event parcels.

use std::sync::Arc;

use mom_managers::PeerFacts;
use mom_proto::{Family, HUB, Map, Micros, Parcel, Path, Value};

use super::World;
use crate::{Effect, PeerId};

impl World {
    /// A parcel of the hub about a context.
    pub(crate) fn hub_parcel(&self, family: Family, name: &str, context: &Path) -> Parcel {
        let mut parcel = Parcel::new(family, name).context(context.clone());
        parcel.sender = Some(HUB.into());
        parcel.timestamp = Some(self.wall());
        parcel.number = self.tree.find(context).map(|context| context.number);
        parcel
    }

    /// Gives an event to peers.
    pub(crate) fn push_event(
        &self,
        name: &str,
        context: &Path,
        to: Vec<PeerId>,
        content: Map,
        out: &mut Vec<Effect>,
    ) {
        if to.is_empty() {
            return;
        }
        let parcel = Arc::new(self.hub_parcel(Family::Event, name, context).content(content));
        out.push(Effect::Deliver { to, parcel });
    }

    /// Answers a request with `ok`.
    pub(crate) fn push_ok(
        &self,
        to: PeerId,
        reference: Option<u64>,
        context: &Path,
        content: Option<Map>,
        out: &mut Vec<Effect>,
    ) {
        let mut parcel = self.hub_parcel(Family::Reply, "ok", context);
        parcel.reference = reference;
        parcel.content = content.map(Into::into);
        out.push(Effect::Reply {
            to,
            parcel: Arc::new(parcel),
        });
    }

    /// Time left until then, in whole ms, rounded up.
    pub(crate) fn millis_until(&self, end: Micros) -> Value {
        Value::Int(i64::try_from(end.saturating_sub(self.now).div_ceil(1000)).unwrap_or(i64::MAX))
    }
}

/// A peer in events and lists: `{peer, user, level}`.
pub(crate) fn peer_map(facts: &PeerFacts) -> Map {
    Map::new()
        .with("peer", &*facts.name)
        .with("user", &*facts.user)
        .with("level", facts.level)
}
