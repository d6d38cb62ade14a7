//! The promises of the queue.

use std::sync::Arc;

use bytes::Bytes;
use mom_hub::PeerId;
use mom_net::Outgoing;
use mom_proto::codec::Encoded;

use super::*;
use crate::sync::atomic::{AtomicU64, Ordering};

/// 936 bytes and the queue's own 64 make 1000.
const SIZE: usize = 936;

fn entry(name: &str, lane: Lane, delivery: Delivery) -> Entry {
    let head = Bytes::from(name.as_bytes().repeat(SIZE)[..SIZE].to_vec());
    let origin = Origin {
        context: ContextNumber(1),
        sender: PeerId(1),
        name: name.into(),
    };
    let frame = Outgoing::Encoded(Encoded {
        head,
        body: Bytes::new(),
    });
    Entry {
        frame,
        lane,
        delivery,
        origin,
        expires_at: None,
        gate: None,
        length: SIZE,
    }
}

fn data(name: &str, delivery: Delivery) -> Entry {
    entry(name, Lane::Data(0), delivery)
}

fn names(queue: &mut Queue) -> Vec<String> {
    std::iter::from_fn(|| queue.pop(0))
        .map(|entry| entry.origin.name.to_string())
        .collect()
}

#[test]
fn lanes_leave_in_their_order() {
    let mut queue = Queue::new(100_000);
    for (name, lane) in [
        ("low", Lane::Data(-1)),
        ("first", Lane::Data(0)),
        ("second", Lane::Data(0)),
        ("high", Lane::Data(7)),
        ("reply", Lane::Control),
        ("stop", Lane::Stop),
        ("stop", Lane::Stop),
    ] {
        assert_eq!(queue.push(entry(name, lane, Delivery::Reliable)), Taken::Yes);
    }
    assert_eq!(
        names(&mut queue),
        ["stop", "reply", "high", "first", "second", "low"]
    );
    assert!(queue.is_empty());
}

#[test]
fn a_full_queue_drops_by_class() {
    let mut queue = Queue::new(3000);
    for name in ["a", "b", "c"] {
        assert_eq!(queue.push(data(name, Delivery::Fleeting)), Taken::Yes);
    }
    assert_eq!(
        queue.push(data("d", Delivery::Fleeting)),
        Taken::Yes,
        "the oldest went"
    );
    assert_eq!(
        queue.push(data("l", Delivery::Latest)),
        Taken::Yes,
        "fleeting makes room"
    );
    assert_eq!(queue.push(data("r", Delivery::Reliable)), Taken::Yes);
    assert_eq!(queue.push(data("r", Delivery::Reliable)), Taken::Yes);
    assert_eq!(
        queue.push(data("f", Delivery::Fleeting)),
        Taken::Dropped,
        "latest is not dropped for fleeting"
    );
    assert_eq!(
        queue.push(data("r", Delivery::Reliable)),
        Taken::Yes,
        "latest is dropped for reliable"
    );
    assert_eq!(queue.push(data("r", Delivery::Reliable)), Taken::Overflow);
    assert_eq!(queue.data_bytes(), 3000);
    assert_eq!(queue.take_drops().values().sum::<u64>(), 6);
    assert_eq!(names(&mut queue), ["r", "r", "r"]);
    assert_eq!(queue.data_bytes(), 0);
}

#[test]
fn latest_replaces_in_place() {
    let mut queue = Queue::new(3000);
    queue.push(data("pose", Delivery::Latest));
    queue.push(data("chat", Delivery::Reliable));
    for _ in 0..1000 {
        assert_eq!(queue.push(data("pose", Delivery::Latest)), Taken::Yes);
    }
    assert_eq!(queue.data_bytes(), 2000);
    assert_eq!(names(&mut queue), ["pose", "chat"]);
    assert!(queue.latest.is_empty());
    let drops: Vec<_> = queue.take_drops().into_iter().collect();
    assert_eq!(
        drops,
        [((ContextNumber(1), PeerId(1), DropReason::Replaced), 1000)]
    );
}

#[test]
fn stale_parcels_do_not_leave() {
    let mut queue = Queue::new(10_000);
    let gate = Arc::new(AtomicU64::new(7));
    let guarded = Entry {
        gate: Some((Arc::clone(&gate), 7)),
        ..data("command", Delivery::Reliable)
    };
    queue.push(guarded.clone());
    queue.push(Entry {
        expires_at: Some(50),
        ..data("old", Delivery::Reliable)
    });
    queue.push(data("chat", Delivery::Reliable));
    assert_eq!(
        queue.pop(49).map(|entry| entry.origin.name.to_string()),
        Some("command".into())
    );
    queue.push(guarded);
    gate.store(8, Ordering::Release);
    assert_eq!(
        queue.pop(50).map(|entry| entry.origin.name.to_string()),
        Some("chat".into())
    );
    assert!(queue.pop(50).is_none());
    let reasons: Vec<_> = queue
        .take_drops()
        .into_keys()
        .map(|(_, _, reason)| reason)
        .collect();
    assert_eq!(reasons, [DropReason::Expired, DropReason::Fence]);
}

/// Whatever waits in which order, a device that was stopped last stays stopped.
#[test]
fn a_stop_overrules_an_unstop_that_waits() {
    let mut queue = Queue::new(100_000);
    let stop = entry("stop", Lane::Stop, Delivery::Reliable);
    let unstop = entry("unstop", Lane::Control, Delivery::Reliable);
    for each in [&stop, &unstop, &stop] {
        assert_eq!(queue.push(each.clone()), Taken::Yes);
    }
    assert_eq!(names(&mut queue), ["stop"]);
    assert_eq!(queue.take_drops().values().sum::<u64>(), 1, "the unstop is told");
    queue.push(stop.clone());
    queue.push(unstop.clone());
    assert_eq!(names(&mut queue), ["stop", "unstop"]);
    queue.push(unstop);
    queue.push(Entry {
        origin: Origin {
            context: ContextNumber(2),
            ..stop.origin.clone()
        },
        ..stop
    });
    assert_eq!(names(&mut queue), ["stop", "unstop"], "of another channel");
}

/// A parcel may be larger than the bound; a receiver that is not behind gets it.
#[test]
fn an_empty_queue_takes_any_parcel() {
    for class in [Delivery::Reliable, Delivery::Latest, Delivery::Fleeting] {
        let mut queue = Queue::new(900);
        assert_eq!(queue.push(data("large", class)), Taken::Yes, "{class:?}");
        assert_eq!(
            queue.push(data("more", Delivery::Reliable)),
            match class {
                Delivery::Reliable => Taken::Overflow,
                _ => Taken::Yes,
            }
        );
    }
}

/// What was dropped leaves nothing behind, however long the link stands still.
#[test]
fn a_queue_that_stands_still_does_not_grow() {
    let mut queue = Queue::new(3000);
    queue.push(data("first", Delivery::Reliable));
    for turn in 0..10_000 {
        queue.push(data("fleeting", Delivery::Fleeting));
        queue.push(entry("pose", Lane::Data(turn % 2), Delivery::Latest));
    }
    let places: usize = queue.data.values().map(|lane| lane.entries.len()).sum();
    assert!(places < 500, "{places} places for 3 parcels");
    assert_eq!(
        queue.pop(0).map(|entry| entry.origin.name.to_string()).as_deref(),
        Some("pose")
    );
}

/// What a blocked link did not take is looked at again: it may be overtaken, replaced, or lose its owner.
#[test]
fn what_is_put_back_keeps_its_place_and_no_privilege() {
    let mut queue = Queue::new(100_000);
    let gate = Arc::new(AtomicU64::new(7));
    let command = Entry {
        gate: Some((Arc::clone(&gate), 7)),
        ..data("command", Delivery::Reliable)
    };
    for each in [
        &data("first", Delivery::Reliable),
        &command,
        &data("pose", Delivery::Latest),
    ] {
        queue.push(each.clone());
    }
    let taken: Vec<Entry> = std::iter::from_fn(|| queue.pop(0)).collect();
    queue.push(data("pose", Delivery::Latest));
    queue.push(entry("stop", Lane::Stop, Delivery::Reliable));
    gate.store(8, Ordering::Release);
    taken.into_iter().rev().for_each(|entry| queue.put_back(entry));
    assert_eq!(names(&mut queue), ["stop", "first", "pose"]);
    let reasons: Vec<_> = queue
        .take_drops()
        .into_keys()
        .map(|(_, _, reason)| reason)
        .collect();
    assert_eq!(reasons, [DropReason::Replaced, DropReason::Fence]);
    assert_eq!(queue.data_bytes(), 0);
}

#[test]
fn an_unstop_is_not_put_back_behind_a_stop() {
    let mut queue = Queue::new(100_000);
    queue.push(entry("unstop", Lane::Control, Delivery::Reliable));
    let unstop = queue.pop(0).unwrap();
    queue.push(entry("stop", Lane::Stop, Delivery::Reliable));
    queue.put_back(unstop);
    assert_eq!(names(&mut queue), ["stop"]);
}

#[test]
fn a_farewell_leaves_last_however_full_the_queue_is() {
    let mut queue = Queue::new(1000);
    queue.push(data("chat", Delivery::Reliable));
    queue.push_farewell(entry("shutdown", Lane::Control, Delivery::Reliable));
    queue.push(entry("reply", Lane::Control, Delivery::Reliable));
    assert_eq!(names(&mut queue), ["reply", "chat", "shutdown"]);
}
