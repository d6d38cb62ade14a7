//! Whatever is put, fails and crashes in whatever order: what was acknowledged is there.

use std::collections::BTreeMap;
use std::io;

use mom_hub::{Record, Ticket};
use mom_proto::Path;
use proptest::prelude::*;

use super::{free, owned};
use crate::disk::{Disk, LaneImage};
use crate::queue::{Numbered, StoreBatch, StoreQueue};
use crate::row::LaneMeta;
use crate::start::Found;

const LANES: usize = 3;
const TOKENS: [&str; 4] = ["/a", "/b", "/c", "/d"];

#[derive(Clone, Debug)]
enum Step {
    Put {
        token: usize,
        owned: bool,
        awaited: bool,
    },
    Take(usize),
    /// A commit ends; one that failed may still have reached the disk.
    Finish {
        lane: usize,
        ok: bool,
        landed: bool,
    },
    /// The power is cut, also in the midst of so many of the starts that follow; any of the commits that were on
    /// their way may have landed.
    Crash {
        landed: [bool; LANES],
        starts: Vec<usize>,
    },
}

fn step() -> impl Strategy<Value = Step> {
    let put = (0..TOKENS.len(), any::<bool>(), any::<bool>());
    let put = put.prop_map(|(token, owned, awaited)| Step::Put {
        token,
        owned,
        awaited,
    });
    let finish = (0..LANES, prop::bool::weighted(0.9), any::<bool>());
    let finish = finish.prop_map(|(lane, ok, landed)| Step::Finish { lane, ok, landed });
    let crash = (any::<[bool; LANES]>(), prop::collection::vec(0..LANES * 2, 0..3));
    let crash = crash.prop_map(|(landed, starts)| Step::Crash { landed, starts });
    prop_oneof![
        6 => put,
        5 => (0..LANES).prop_map(Step::Take),
        5 => finish,
        1 => crash,
    ]
}

/// A disk in memory.
impl Disk for LaneImage {
    fn write(&mut self, meta: &LaneMeta, records: &[Numbered], gone: &[Path]) -> io::Result<()> {
        for (sequence, record) in records {
            let known = self.rows.get(&record.path).map(|(known, _)| *known);
            if known.is_none_or(|known| known < *sequence) {
                self.rows
                    .insert(record.path.clone(), (*sequence, (**record).clone()));
            }
        }
        gone.iter().for_each(|path| drop(self.rows.remove(path)));
        self.meta = Some(meta.clone());
        Ok(())
    }
}

/// A disk that lets so many writes through before the power is cut.
struct Cut<'a> {
    image: &'a mut LaneImage,
    left: &'a std::sync::atomic::AtomicUsize,
}

impl Disk for Cut<'_> {
    fn write(&mut self, meta: &LaneMeta, records: &[Numbered], gone: &[Path]) -> io::Result<()> {
        use std::sync::atomic::Ordering::Relaxed;
        let through = self
            .left
            .fetch_update(Relaxed, Relaxed, |left| left.checked_sub(1));
        through.map_err(|_| io::Error::other("the power is cut"))?;
        self.image.write(meta, records, gone)
    }
}

struct Model {
    images: Vec<LaneImage>,
    queue: StoreQueue,
    flying: Vec<Option<StoreBatch>>,
    broken: [bool; LANES],
    epoch: u64,
    /// The last part of the last fence.
    number: u64,
    tickets: BTreeMap<Ticket, Record>,
    /// The newest record of each token that is known to be durable.
    durable: BTreeMap<Path, Record>,
}

impl Model {
    fn new() -> Model {
        let mut model = Model {
            images: vec![LaneImage::default(); LANES],
            queue: StoreQueue::new(0, vec![0; LANES], []),
            flying: (0..LANES).map(|_| None).collect(),
            broken: [false; LANES],
            epoch: 0,
            number: 0,
            tickets: BTreeMap::new(),
            durable: BTreeMap::new(),
        };
        model.start(usize::MAX);
        model
    }

    fn note_durable(&mut self, record: Record) {
        let newest = self
            .durable
            .get(&record.path)
            .is_none_or(|known| known.fence < record.fence);
        if newest {
            self.durable.insert(record.path.clone(), record);
        }
    }

    fn step(&mut self, step: Step) {
        match step {
            Step::Put {
                token,
                owned: is_owned,
                awaited,
            } => {
                self.number += 1;
                let fence = (self.epoch << 20) + self.number;
                let make = if is_owned { owned } else { free };
                let record = make(TOKENS[token], fence);
                let ticket = awaited.then_some(Ticket(self.number));
                let taken = self.queue.put(record.clone(), ticket);
                assert_eq!(taken, self.broken != [true; LANES]);
                if let (Some(ticket), true) = (ticket, taken) {
                    self.tickets.insert(ticket, record);
                }
            }
            Step::Take(lane) => {
                if self.flying[lane].is_none() && !self.broken[lane] {
                    self.flying[lane] = self.queue.take(lane);
                }
            }
            Step::Finish { lane, ok, landed } => {
                let Some(batch) = self.flying[lane].take() else {
                    return;
                };
                if ok || landed {
                    self.land(lane, &batch);
                }
                if ok {
                    // Also what nobody awaits: a release that is durable may be forgotten with what it released.
                    let written = batch.records.iter().map(|(_, record)| Record::clone(record));
                    written
                        .collect::<Vec<_>>()
                        .into_iter()
                        .for_each(|record| self.note_durable(record));
                }
                self.broken[lane] |= !ok;
                for (ticket, answer) in self.queue.finish(lane, batch, ok) {
                    let record = self.tickets.remove(&ticket).expect("answered once");
                    assert!(ok || !answer);
                    if answer {
                        self.note_durable(record);
                    }
                }
            }
            Step::Crash { landed, starts } => {
                for (lane, landed) in landed.into_iter().enumerate() {
                    if let Some(batch) = self.flying[lane].take().filter(|_| landed) {
                        self.land(lane, &batch);
                    }
                }
                starts.into_iter().for_each(|writes| self.start(writes));
                self.start(usize::MAX);
            }
        }
    }

    fn land(&mut self, lane: usize, batch: &StoreBatch) {
        let written = self.images[lane].write(&batch.meta, &batch.records, &batch.gone);
        written.expect("memory has room");
    }

    /// A start whose power is cut after so many writes.
    fn start(&mut self, writes: usize) {
        let mut found = Found::of(&self.images).expect("crashes do no damage");
        for known in self.durable.values() {
            assert!(found.epoch > known.fence >> 20, "fences rise");
            let record = found.records.iter().find(|record| record.path == known.path);
            match record {
                Some(record) => assert!(record.fence >= known.fence, "{record:?} for {known:?}"),
                None => assert_eq!(known.owner, None, "lost: {known:?}"),
            }
        }
        assert!(found.epoch > self.epoch || self.epoch == 0);
        found
            .records
            .iter()
            .cloned()
            .for_each(|record| self.note_durable(record));
        let left = std::sync::atomic::AtomicUsize::new(writes);
        let mut lanes: Vec<Cut<'_>> = self
            .images
            .iter_mut()
            .map(|image| Cut { image, left: &left })
            .collect();
        let settled = found.settle(&mut lanes);
        assert_eq!(settled.is_ok(), writes >= LANES * 2);
        if settled.is_ok() {
            self.epoch = found.epoch;
            self.queue = StoreQueue::new(found.epoch, found.seen, found.kept);
            self.broken = [false; LANES];
            self.tickets.clear();
        }
    }
}

proptest! {
    #[test]
    fn what_was_acknowledged_is_there(steps in prop::collection::vec(step(), 0..200)) {
        let mut model = Model::new();
        steps.into_iter().for_each(|step| model.step(step));
        model.step(Step::Crash { landed: [false; LANES], starts: Vec::new() });
    }
}
