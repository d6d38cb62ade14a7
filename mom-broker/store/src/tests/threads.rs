//! Lanes as threads, on disks that wait until they are told how a commit ends.

use std::io;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use mom_hub::Ticket;
use mom_proto::Path;
use tokio::sync::mpsc::{UnboundedReceiver, error::TryRecvError};

use super::{free, owned};
use crate::disk::Disk;
use crate::queue::{Numbered, StoreAnswer, StoreQueue};
use crate::row::LaneMeta;
use crate::{LANES, Store};

/// What does not happen in this time never does.
const PATIENCE: Duration = Duration::from_secs(30);

enum End {
    Durable,
    Failed,
    Panic,
}

/// A disk that says what it is given and ends a commit as it is told.
struct Slow {
    lane: usize,
    begun: Sender<(usize, Vec<String>)>,
    end: Receiver<End>,
}

impl Disk for Slow {
    fn write(&mut self, _: &LaneMeta, records: &[Numbered], _: &[Path]) -> io::Result<()> {
        let tokens = records
            .iter()
            .map(|(_, record)| record.path.to_string())
            .collect();
        self.begun.send((self.lane, tokens)).expect("the test listens");
        match self.end.recv() {
            Ok(End::Durable) => Ok(()),
            Ok(End::Panic) => panic!("as the test wishes"),
            Ok(End::Failed) | Err(_) => Err(io::Error::other("no room")),
        }
    }
}

struct Slowly {
    store: Store,
    answers: UnboundedReceiver<StoreAnswer>,
    begun: Receiver<(usize, Vec<String>)>,
    ends: Vec<Sender<End>>,
}

fn slowly() -> Slowly {
    let (begin, begun) = mpsc::channel();
    let mut ends = Vec::new();
    let disk = |lane| {
        let (sender, end) = mpsc::channel();
        ends.push(sender);
        let begun = begin.clone();
        let disk: Box<dyn Disk> = Box::new(Slow { lane, begun, end });
        (format!("slow {lane}"), disk)
    };
    let disks = (0..LANES).map(disk).collect();
    let (store, answers) = Store::run(disks, StoreQueue::new(1, vec![0; LANES], []), None).expect("threads");
    Slowly {
        store,
        answers,
        begun,
        ends,
    }
}

impl Slowly {
    fn grant(&self, token: &str, ticket: u64) {
        self.store.put(owned(token, ticket), Some(Ticket(ticket)));
    }

    /// The lane that has begun to write exactly these tokens.
    fn writes(&self, tokens: &[&str]) -> usize {
        let (lane, written) = self.begun.recv_timeout(PATIENCE).expect("a lane begins");
        assert_eq!(written, tokens);
        lane
    }

    fn end(&self, lane: usize, end: End) {
        self.ends[lane].send(end).expect("the lane listens");
    }

    fn answer(&mut self) -> (u64, bool) {
        let (ticket, ok) = self.answers.blocking_recv().expect("an answer");
        (ticket.0, ok)
    }

    fn no_answer(&mut self) {
        assert_eq!(self.answers.try_recv(), Err(TryRecvError::Empty));
    }
}

/// Design §4: a grant never waits for another token's fsync.
#[test]
fn a_slow_commit_keeps_no_other_token_waiting() {
    let mut slow = slowly();
    slow.grant("/a", 1);
    let first = slow.writes(&["/a"]);
    for ticket in 2..10 {
        slow.grant("/b", ticket);
        let other = slow.writes(&["/b"]);
        assert_ne!(first, other);
        slow.end(other, End::Durable);
        assert_eq!(slow.answer(), (ticket, true));
    }
    // Nor for releases, however many.
    slow.store.put(free("/c", 1), None);
    let release = slow.writes(&["/c"]);
    (0..10).for_each(|fence| slow.store.put(free(&format!("/c/{fence}"), 1), None));
    slow.grant("/b", 10);
    let other = slow.writes(&["/b"]);
    assert!(other != first && other != release);
    slow.end(other, End::Durable);
    assert_eq!(slow.answer(), (10, true));
    slow.no_answer();
    slow.end(first, End::Durable);
    assert_eq!(slow.answer(), (1, true));
}

#[test]
fn what_waits_for_a_lane_goes_together() {
    let mut slow = slowly();
    let lanes: Vec<usize> = (0..LANES as u64)
        .map(|ticket| {
            let token = format!("/t/{ticket}");
            slow.grant(&token, ticket);
            slow.writes(&[&token])
        })
        .collect();
    for (ticket, token) in ["/a", "/b", "/a", "/c"].into_iter().enumerate() {
        slow.grant(token, 10 + ticket as u64);
    }
    slow.no_answer();
    slow.end(lanes[2], End::Durable);
    assert_eq!(slow.answer(), (2, true));
    assert_eq!(slow.writes(&["/a", "/b", "/c"]), lanes[2]);
    slow.end(lanes[2], End::Durable);
    let mut answers: Vec<_> = (0..4).map(|_| slow.answer()).collect();
    answers.sort_unstable();
    assert_eq!(answers, [(10, true), (11, true), (12, true), (13, true)]);
}

/// Threat 29: a lane that failed is not tried again, the others go on, and without any all is refused.
#[test]
fn failed_lanes_are_left_alone() {
    let mut slow = slowly();
    let mut left: Vec<usize> = (0..LANES).collect();
    while !left.is_empty() {
        let ticket = left.len() as u64;
        slow.grant("/a", ticket);
        let lane = slow.writes(&["/a"]);
        assert!(left.contains(&lane), "{lane} of {left:?}");
        left.retain(|other| *other != lane);
        slow.end(
            lane,
            if ticket.is_multiple_of(2) {
                End::Failed
            } else {
                End::Panic
            },
        );
        assert_eq!(slow.answer(), (ticket, false));
    }
    for ticket in 10..20 {
        slow.grant("/b", ticket);
        assert_eq!(slow.answer(), (ticket, false));
    }
    slow.store.put(free("/b", 1), None);
    assert!(
        slow.begun.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Disconnected),
        "all lanes have ended"
    );
}

#[test]
fn a_release_outlives_the_lane_that_failed() {
    let slow = slowly();
    slow.store.put(free("/a", 1), None);
    let first = slow.writes(&["/a"]);
    slow.end(first, End::Failed);
    let second = slow.writes(&["/a"]);
    assert_ne!(first, second);
    slow.end(second, End::Durable);
}

#[test]
fn a_store_closes_when_all_is_written() {
    let mut slow = slowly();
    slow.store.put(free("/a", 1), None);
    let first = slow.writes(&["/a"]);
    slow.store.put(free("/b", 1), None);
    let mut context = Context::from_waker(Waker::noop());
    {
        let mut closing = std::pin::pin!(slow.store.close());
        assert_eq!(closing.as_mut().poll(&mut context), Poll::Pending);
    }
    // Nothing new from here on.
    slow.grant("/c", 1);
    assert_eq!(slow.answer(), (1, false));
    slow.end(first, End::Durable);
    let second = slow.writes(&["/b"]);
    slow.end(second, End::Durable);
    tokio::runtime::Builder::new_current_thread()
        .build()
        .expect("a runtime")
        .block_on(slow.store.close());
    assert!(
        slow.begun.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Disconnected),
        "all lanes have ended"
    );
}

#[test]
fn a_store_that_closes_gives_up_no_release() {
    let slow = slowly();
    slow.store.put(free("/a", 1), None);
    let first = slow.writes(&["/a"]);
    let mut closing = std::pin::pin!(slow.store.close());
    let mut context = Context::from_waker(Waker::noop());
    assert_eq!(closing.as_mut().poll(&mut context), Poll::Pending);
    slow.end(first, End::Failed);
    let second = slow.writes(&["/a"]);
    slow.end(second, End::Durable);
}
