//! `context stats`: the hub decides who may ask, and here the figures are put in.

use std::sync::Arc;

use mom_hub::PeerId;
use mom_proto::{ContextNumber, Map, Parcel, Path, Value};

use crate::traffic::channel::{MemberSnapshot, Snapshot};
use crate::traffic::outbox::{Outbox, PeerStatistics};
use crate::traffic::switchboard::{Switchboard, Touched};

/// Peers of which one reply tells at most.
pub(super) const MOST_PEERS: usize = 256;

impl Switchboard {
    /// The first peers that have logged in, in the order of their arrival, and how many more there are.
    pub(crate) fn peers(&self, most: usize) -> (Vec<PeerStatistics>, usize) {
        let mut outboxes: Vec<Arc<Outbox>> = self.outboxes.iter().map(|outbox| Arc::clone(&outbox)).collect();
        outboxes.sort_unstable_by_key(|outbox| outbox.peer);
        let mut outboxes = outboxes.into_iter().filter(|outbox| outbox.is_logged_in());
        let first = outboxes.by_ref().take(most);
        let peers = first.filter_map(|outbox| outbox.figures()).collect();
        (peers, outboxes.count())
    }

    /// Answers with the figures of these channels: of one with those of each member, or of several.
    pub(crate) fn push_stats(
        &self,
        to: PeerId,
        parcel: &Parcel,
        channels: &[ContextNumber],
        peers: bool,
        touched: &mut Touched,
    ) {
        let mut content = match parcel.value() {
            Value::Map(map) => map,
            _ => Map::new(),
        };
        content.set("time", self.clock.wall());
        if parcel.context.as_ref().is_some_and(Path::is_root) {
            content.set("memory", self.memory.to_map());
            self.put_peers(&mut content);
        }
        let snapshots = channels.iter().filter_map(|number| {
            let channel = self.channel(*number)?;
            Some((*number, channel.snapshot()))
        });
        if peers {
            for (_, snapshot) in snapshots {
                content = snapshot.to_map(content);
                content.set("peers", snapshot.peers());
            }
        } else {
            let list = snapshots.map(|(number, snapshot)| {
                let map = Map::new()
                    .with("path", snapshot.path.as_str())
                    .with("number", i64::try_from(number.0).unwrap_or(i64::MAX))
                    .with(
                        "members",
                        i64::try_from(snapshot.members.len()).unwrap_or(i64::MAX),
                    );
                Value::Map(snapshot.to_map(map))
            });
            let list: Vec<Value> = list.collect();
            content.set("channels", list);
        }
        let mut reply = parcel.clone();
        reply.content = Some(content.into());
        self.push_to_all(&[to], &Arc::new(reply), touched);
    }

    fn put_peers(&self, content: &mut Map) {
        let (peers, more) = self.peers(MOST_PEERS);
        let peers: Vec<Value> = peers.iter().map(|peer| peer.to_map().into()).collect();
        content.set("peers", peers);
        if more > 0 {
            content.set("more-peers", i64::try_from(more).unwrap_or(i64::MAX));
        }
    }
}

impl Snapshot {
    fn to_map(&self, map: Map) -> Map {
        let queued = self.members.iter().map(MemberSnapshot::queued).sum();
        self.all.to_map(map, queued)
    }

    fn peers(&self) -> Vec<Value> {
        let peers = self.members.iter().map(|member| {
            let map = Map::new()
                .with("peer", &*member.facts.name)
                .with("user", &*member.facts.user);
            Value::Map(member.counts.to_map(map, member.queued()))
        });
        peers.collect()
    }
}

impl MemberSnapshot {
    /// What waits for this peer, from wherever.
    fn queued(&self) -> usize {
        self.outbox.as_ref().map_or(0, |outbox| outbox.queued())
    }
}
