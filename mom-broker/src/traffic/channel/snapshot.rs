//! What a channel has counted, at one moment.

use std::sync::Arc;

use mom_managers::PeerFacts;
use mom_proto::Path;

use super::Channel;
use crate::traffic::outbox::Outbox;
use crate::traffic::statistics::Counts;

/// A channel as it stood at one moment; made into words when its lock is given back.
pub(crate) struct Snapshot {
    pub(crate) path: Path,
    pub(crate) all: Counts,
    pub(crate) members: Vec<MemberSnapshot>,
}

/// One member of it.
pub(crate) struct MemberSnapshot {
    pub(crate) facts: Arc<PeerFacts>,
    pub(crate) counts: Counts,
    pub(crate) outbox: Option<Arc<Outbox>>,
}

impl Channel {
    /// Its counts, of all who were ever in it.
    pub(crate) fn counts(&self) -> Counts {
        self.state.lock().statistics.all().clone()
    }

    /// Its counts, and those of each member.
    pub(crate) fn snapshot(&self) -> Snapshot {
        let state = self.state.lock();
        let members = state.route.members.iter().zip(state.statistics.members());
        let members = members.zip(&state.outboxes);
        let members = members.map(|((member, counts), outbox)| MemberSnapshot {
            facts: Arc::clone(&member.facts),
            counts: counts.clone(),
            outbox: outbox.clone(),
        });
        Snapshot {
            path: state.route.path.clone(),
            all: state.statistics.all().clone(),
            members: members.collect(),
        }
    }
}
