//! Which records wait, which lane takes which, and who is answered: no IO, no threads.

use std::collections::BTreeMap;
use std::sync::Arc;

use mom_hub::{Record, Ticket};
use mom_proto::Path;

use super::row::LaneMeta;
use super::rows::Rows;

/// Rows that a lane holds for nothing and removes without anything else to write.
const MANY: usize = 256;

/// A record and its place in the order of all.
pub(super) type Numbered = (u64, Arc<Record>);

/// The records that wait, and what the lanes are at.
///
/// Per token only the newest record waits: it is the one that would win. There is no bound of its own: the hub
/// awaits one ticket per token, and has as many tokens as its limits allow.
#[derive(Debug)]
pub(super) struct StoreQueue {
    epoch: u64,
    sequence: u64,
    awaited: BTreeMap<Path, Awaited>,
    loose: BTreeMap<Path, Numbered>,
    lanes: Vec<StoreLane>,
    /// Per lane the highest sequence that is durable.
    seen: Vec<u64>,
    rows: Rows,
}

/// The newest record of a token, and the waiters for it or an older one that it stands for.
#[derive(Debug)]
struct Awaited {
    newest: Numbered,
    tickets: Vec<Ticket>,
    /// The newest that nobody awaits; it is not given up if the awaited one fails.
    loose: Option<Numbered>,
}

#[derive(Debug)]
struct StoreLane {
    state: LaneState,
    /// Whether its latest batch was one that nobody awaits: then the other kind has precedence.
    was_loose: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LaneState {
    Idle,
    Busy {
        loose: bool,
    },
    /// Broken, or closed.
    Gone,
}

/// What one lane makes durable at once.
#[derive(Debug)]
pub(super) struct StoreBatch {
    pub(super) meta: LaneMeta,
    pub(super) records: Vec<Numbered>,
    /// Rows that are not needed any more.
    pub(super) gone: Vec<Path>,
    tickets: Vec<Ticket>,
    loose: Vec<Numbered>,
}

/// A ticket and whether its record is durable.
pub type StoreAnswer = (Ticket, bool);

impl StoreQueue {
    /// A queue that goes on after what the lanes hold: `seen` is their last sequences, `kept` are their rows.
    pub(super) fn new(
        epoch: u64,
        seen: Vec<u64>,
        kept: impl IntoIterator<Item = (Path, usize, u64)>,
    ) -> StoreQueue {
        let lane = || StoreLane {
            state: LaneState::Idle,
            was_loose: true,
        };
        StoreQueue {
            epoch,
            sequence: seen.iter().copied().max().unwrap_or_default(),
            awaited: BTreeMap::new(),
            loose: BTreeMap::new(),
            lanes: seen.iter().map(|_| lane()).collect(),
            rows: Rows::new(seen.len(), kept),
            seen,
        }
    }

    /// Takes a record in; false if there is no lane left that could keep it.
    pub(super) fn put(&mut self, record: Record, ticket: Option<Ticket>) -> bool {
        if self.is_dead() {
            return false;
        }
        self.sequence += 1;
        let path = record.path.clone();
        let newest = (self.sequence, Arc::new(record));
        match (ticket, self.awaited.get_mut(&path)) {
            (None, None) => drop(self.loose.insert(path, newest)),
            (None, Some(awaited)) => {
                awaited.newest = newest.clone();
                awaited.loose = Some(newest);
            }
            (Some(ticket), Some(awaited)) => {
                awaited.newest = newest;
                awaited.tickets.push(ticket);
            }
            (Some(ticket), None) => {
                let awaited = Awaited {
                    newest,
                    tickets: vec![ticket],
                    loose: self.loose.remove(&path),
                };
                self.awaited.insert(path, awaited);
            }
        }
        true
    }

    /// What an idle lane is to write now.
    ///
    /// All that is awaited goes together. What nobody awaits is in one lane at a time, so that many releases
    /// at once never keep a grant waiting; a lane that has both before it takes them by turns. Rows that are not needed
    /// any more go with either, and by themselves only where there are many.
    pub(super) fn take(&mut self, lane: usize) -> Option<StoreBatch> {
        debug_assert_eq!(self.lanes[lane].state, LaneState::Idle);
        let free = !self
            .lanes
            .iter()
            .any(|lane| lane.state == LaneState::Busy { loose: true });
        let loose =
            free && !self.loose.is_empty() && (self.awaited.is_empty() || !self.lanes[lane].was_loose);
        if !loose && self.awaited.is_empty() && self.rows.unneeded(lane) < MANY {
            return None;
        }
        self.lanes[lane] = StoreLane {
            state: LaneState::Busy { loose },
            was_loose: loose,
        };
        let mut batch = StoreBatch {
            meta: self.meta(lane),
            records: Vec::new(),
            gone: Vec::new(),
            tickets: Vec::new(),
            loose: Vec::new(),
        };
        if loose {
            batch.records = std::mem::take(&mut self.loose).into_values().collect();
            batch.loose.clone_from(&batch.records);
        } else {
            for awaited in std::mem::take(&mut self.awaited).into_values() {
                batch.records.push(awaited.newest);
                batch.tickets.extend(awaited.tickets);
                batch.loose.extend(awaited.loose);
            }
        }
        let last = batch.records.iter().map(|(sequence, _)| *sequence).max();
        batch.meta.seen[lane] = last.unwrap_or_default().max(self.seen[lane]);
        self.remove_unneeded(lane, &mut batch);
        Some(batch)
    }

    /// Lets a batch remove what its lane holds for nothing.
    fn remove_unneeded(&mut self, lane: usize, batch: &mut StoreBatch) {
        for (_, record) in &batch.records {
            self.rows.begin(lane, record);
        }
        let written = batch.records.iter().map(|(_, record)| &record.path).collect();
        let (gone, epoch) = self.rows.take(lane, &written);
        if gone.is_empty() {
            return;
        }
        // The file of before must not pass for this one.
        self.sequence += 1;
        batch.meta.seen[lane] = self.sequence;
        // What is forgotten of a fence that ran into the next second's numbers.
        self.epoch = self.epoch.max(epoch);
        batch.meta.epoch = self.epoch;
        batch.gone = gone;
    }

    /// Notes how a batch ended. A lane that failed is not used again: what its file holds since is not known.
    pub(super) fn finish(&mut self, lane: usize, batch: StoreBatch, ok: bool) -> Vec<StoreAnswer> {
        let mut answers: Vec<StoreAnswer> = batch.tickets.into_iter().map(|ticket| (ticket, ok)).collect();
        if ok {
            self.lanes[lane].state = LaneState::Idle;
            self.seen[lane] = batch.meta.last();
            for (sequence, record) in &batch.records {
                self.rows.wrote(lane, *sequence, record);
            }
            self.rows.removed(lane, &batch.gone);
            return answers;
        }
        self.rows.lose(lane);
        self.lanes[lane].state = LaneState::Gone;
        batch.loose.into_iter().for_each(|record| self.put_back(record));
        if self.is_dead() {
            self.loose.clear();
            let failed = std::mem::take(&mut self.awaited);
            let tickets = failed.into_values().flat_map(|awaited| awaited.tickets);
            answers.extend(tickets.map(|ticket| (ticket, false)));
        }
        answers
    }

    /// Another lane shall write what nobody awaits, unless something newer waits already.
    fn put_back(&mut self, record: Numbered) {
        let path = record.1.path.clone();
        match self.awaited.get_mut(&path) {
            Some(awaited) => {
                awaited.loose.get_or_insert(record);
            }
            None => {
                self.loose.entry(path).or_insert(record);
            }
        }
    }

    /// A lane takes nothing more.
    pub(super) fn leave(&mut self, lane: usize) {
        self.lanes[lane].state = LaneState::Gone;
    }

    /// Whether nothing waits and nothing is being written.
    pub(super) fn is_quiet(&self) -> bool {
        let busy = |lane: &StoreLane| matches!(lane.state, LaneState::Busy { .. });
        self.awaited.is_empty() && self.loose.is_empty() && !self.lanes.iter().any(busy)
    }

    /// Whether no lane is left.
    pub(super) fn is_dead(&self) -> bool {
        self.lanes.iter().all(|lane| lane.state == LaneState::Gone)
    }

    fn meta(&self, lane: usize) -> LaneMeta {
        LaneMeta {
            lane,
            epoch: self.epoch,
            seen: self.seen.clone(),
        }
    }
}
