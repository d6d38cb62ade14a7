//! The lanes' threads in orders of steps that shuttle chooses: run by `cargo xtask shuttle`.

use std::collections::BTreeMap;
use std::io;

use mom_hub::Ticket;
use mom_proto::Path;
use mom_system::sync::explore;
use shuttle::rand::Rng;
use shuttle::sync::{Arc, Mutex};

use super::{free, owned};
use crate::Store;
use crate::disk::Disk;
use crate::queue::{Numbered, StoreQueue};
use crate::row::LaneMeta;

/// What is durable: of each token the fence with the highest number, over all lanes.
type Durable = Arc<Mutex<BTreeMap<Path, (u64, u64)>>>;

/// A disk in memory, which may fail.
struct Memory {
    durable: Durable,
    may_fail: bool,
}

impl Disk for Memory {
    fn write(&mut self, _: &LaneMeta, records: &[Numbered], _: &[Path]) -> io::Result<()> {
        if self.may_fail && shuttle::rand::thread_rng().gen_ratio(1, 4) {
            return Err(io::Error::other("no room"));
        }
        let mut durable = self.durable.lock().expect("nothing panics");
        for (number, record) in records {
            let row = durable.entry(record.path.clone()).or_default();
            *row = (*row).max((*number, record.fence));
        }
        Ok(())
    }
}

/// A store of two lanes, of which the first may fail.
fn open(
    may_fail: bool,
) -> (
    Arc<Store>,
    Durable,
    tokio::sync::mpsc::UnboundedReceiver<(Ticket, bool)>,
) {
    let durable = Durable::default();
    let disk = |lane| {
        let disk: Box<dyn Disk> = Box::new(Memory {
            durable: Arc::clone(&durable),
            may_fail: may_fail && lane == 0,
        });
        (format!("memory {lane}"), disk)
    };
    let disks = (0..2).map(disk).collect();
    let (store, answers) = Store::run(disks, StoreQueue::new(1, vec![0; 2], []), None).expect("threads");
    (Arc::new(store), durable, answers)
}

fn fence(durable: &Durable, token: &str) -> u64 {
    let durable = durable.lock().expect("nothing panics");
    durable.get(&super::path(token)).map_or(0, |(_, fence)| *fence)
}

/// Two tokens change hands, one thread each, and are released at the end; then the store closes.
fn change_hands(may_fail: bool) {
    let (store, durable, mut answers) = open(may_fail);
    let putters = ["/a", "/b"].map(|token| {
        let store = Arc::clone(&store);
        let ticket = move |fence: u64| Ticket(fence + if token == "/a" { 0 } else { 10 });
        shuttle::thread::spawn(move || {
            (1..=3).for_each(|fence| store.put(owned(token, fence), Some(ticket(fence))));
            store.put(free(token, 4), None);
        })
    });
    // Each is answered once, and what is said to be durable is.
    let mut answered = BTreeMap::new();
    for _ in 0..6 {
        let (Ticket(ticket), ok) = shuttle::future::block_on(answers.recv()).expect("the store is open");
        assert_eq!(answered.insert(ticket, ok), None, "answered twice");
        let token = if ticket > 10 { "/b" } else { "/a" };
        assert!(
            !ok || fence(&durable, token) >= ticket % 10,
            "{ticket} is not durable"
        );
        assert!(ok || may_fail);
    }
    putters
        .into_iter()
        .for_each(|putter| putter.join().expect("it put all in"));
    shuttle::future::block_on(store.close());
    // A release outlives the lane that failed.
    assert_eq!([fence(&durable, "/a"), fence(&durable, "/b")], [4, 4]);
    drop(store);
    assert_eq!(
        shuttle::future::block_on(answers.recv()),
        None,
        "nothing is answered twice"
    );
}

#[test]
fn every_ticket_is_answered_once() {
    explore(|| change_hands(false));
}

/// Threat 29.
#[test]
fn a_lane_that_fails_loses_no_answer_and_no_release() {
    explore(|| change_hands(true));
}
