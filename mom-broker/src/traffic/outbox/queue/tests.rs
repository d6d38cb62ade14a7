//! Packets in a queue: when they are stale, and what a stop withdraws. The queue itself is tested in `mom-net`.

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use mom_hub::PeerId;
use mom_net::{Lane, Piece};
use mom_proto::codec::Encoded;
use mom_proto::{ContextNumber, Delivery, Micros, Time};
use mom_system::sync::atomic::{AtomicU64, Ordering};

use super::*;
use crate::traffic::encodings::Encodings;
use crate::traffic::outbox::{Charged, Origin};

/// 936 bytes and the queue's own 64 make 1000.
const SIZE: usize = 936;

fn packet(name: &str, lane: Lane, delivery: Delivery) -> Packet {
    frame(
        name,
        lane,
        delivery,
        name.as_bytes().repeat(SIZE)[..SIZE].to_vec(),
    )
}

fn frame(name: &str, lane: Lane, delivery: Delivery, frame: Vec<u8>) -> Packet {
    Packet {
        charged: Charged::Nowhere,
        encodings: Encodings::of_run(Encoded {
            head: Bytes::from(frame),
            body: Bytes::new(),
        }),
        lane,
        delivery,
        origin: Origin {
            context: ContextNumber(1),
            sender: PeerId(1),
            name: name.into(),
        },
        expires_at: None,
        gate: None,
        count: 1,
        counts: true,
        outlives_loss: true,
    }
}

fn entry(name: &str, lane: Lane, delivery: Delivery) -> Arc<Packet> {
    Arc::new(packet(name, lane, delivery))
}

pub(super) fn data(name: &str, delivery: Delivery) -> Arc<Packet> {
    entry(name, Lane::Data(0), delivery)
}

pub(super) fn queue(limit: usize) -> PeerQueue {
    PeerQueue::new(Some(Form::Binary), limit)
}

pub(super) fn pop(queue: &mut PeerQueue, now: Micros) -> Option<Piece<Packet>> {
    queue.queue.pop(now, usize::MAX)
}

pub(super) fn name(piece: &Piece<Packet>) -> String {
    piece
        .item()
        .map(|packet| packet.origin.name.to_string())
        .unwrap_or_default()
}

fn names(queue: &mut PeerQueue) -> Vec<String> {
    std::iter::from_fn(|| pop(queue, 0))
        .map(|piece| name(&piece))
        .collect()
}

#[test]
fn stale_parcels_do_not_leave() {
    let mut queue = queue(10_000);
    let gate = Arc::new(AtomicU64::new(7));
    let guarded = Arc::new(Packet {
        gate: Some((Arc::clone(&gate), 7)),
        ..packet("command", Lane::Data(0), Delivery::Reliable)
    });
    queue.queue.push(Arc::clone(&guarded));
    queue.queue.push(Arc::new(Packet {
        expires_at: Some(50),
        ..packet("old", Lane::Data(0), Delivery::Reliable)
    }));
    queue.queue.push(data("chat", Delivery::Reliable));
    assert_eq!(
        pop(&mut queue, 49).map(|piece| name(&piece)),
        Some("command".into())
    );
    queue.queue.push(guarded);
    gate.store(8, Ordering::Release);
    assert_eq!(pop(&mut queue, 50).map(|piece| name(&piece)), Some("chat".into()));
    assert!(pop(&mut queue, 50).is_none());
    let reasons: Vec<_> = queue
        .take_drops()
        .into_keys()
        .map(|dropped| dropped.reason)
        .collect();
    assert_eq!(reasons, [DropReason::Expired, DropReason::Fence]);
}

/// Whatever waits in which order, a device that was stopped last stays stopped.
#[test]
fn a_stop_withdraws_an_unstop_that_waits() {
    let mut queue = queue(100_000);
    let stop = entry("stop", Lane::Stop, Delivery::Reliable);
    let unstop = entry("unstop", Lane::Control, Delivery::Reliable);
    for each in [&stop, &unstop, &stop] {
        assert_eq!(queue.queue.push(each.clone()), Taken::Yes);
    }
    assert_eq!(names(&mut queue), ["stop"]);
    assert_eq!(queue.take_drops().values().sum::<u64>(), 1, "the unstop is told");
    queue.queue.push(stop.clone());
    queue.queue.push(unstop.clone());
    assert_eq!(names(&mut queue), ["stop", "unstop"]);
    queue.queue.push(unstop);
    queue.queue.push(Arc::new(Packet {
        origin: Origin {
            context: ContextNumber(2),
            ..stop.origin.clone()
        },
        ..packet("stop", Lane::Stop, Delivery::Reliable)
    }));
    assert_eq!(names(&mut queue), ["stop", "unstop"], "of another channel");
}

#[test]
fn a_burst_may_wait_for_a_while_and_no_longer() {
    let limits = Limits {
        outbox: 10_000,
        burst: 20_000,
        stalled: 5000,
        ..Limits::default()
    };
    let clock = Clock::manual(Time::default());
    clock.advance(Duration::from_secs(1));
    let mut queue = queue(1000);
    queue.set_limits(&limits);
    let push = |queue: &mut PeerQueue, count: usize, delivery| -> Vec<Taken> {
        let one = |_| queue.push(data("r", delivery), &clock);
        (0..count).map(one).collect()
    };
    assert_eq!(push(&mut queue, 20, Delivery::Reliable), [Taken::Yes; 20]);
    assert_eq!(
        push(&mut queue, 1, Delivery::Reliable),
        [Taken::Overflow],
        "the burst"
    );
    assert_eq!(
        push(&mut queue, 1, Delivery::Latest),
        [Taken::Dropped],
        "it is not a place for others"
    );
    clock.advance(Duration::from_millis(4999));
    pop(&mut queue, 0);
    assert_eq!(
        push(&mut queue, 1, Delivery::Reliable),
        [Taken::Yes],
        "not for long"
    );
    clock.advance(Duration::from_millis(1));
    pop(&mut queue, 0);
    assert_eq!(
        push(&mut queue, 1, Delivery::Reliable),
        [Taken::Overflow],
        "behind for too long"
    );
    // Who was up to date in between begins anew.
    while pop(&mut queue, 0).is_some() {}
    assert_eq!(push(&mut queue, 20, Delivery::Reliable), [Taken::Yes; 20]);
    clock.advance(Duration::from_secs(5));
    assert_eq!(push(&mut queue, 1, Delivery::Reliable), [Taken::Overflow]);
}
