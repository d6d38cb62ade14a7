//! The promises of the queue.

mod chunks;
mod ledger;

use std::cell::Cell;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bytes::Bytes;
use mom_proto::codec::Encoded;
use mom_proto::{Parcel, binary};

use super::*;
use crate::Allowance;

thread_local! {
    /// How often the queue has looked at a packet's class.
    static LOOKS: Cell<usize> = const { Cell::new(0) };
}

/// A parcel, or several, as the hub's outboxes have them.
#[derive(Clone, Debug)]
struct Packet {
    frames: Encoded,
    lane: Lane,
    delivery: Delivery,
    origin: Origin,
    expires_at: Option<u64>,
    gate: Option<(Arc<AtomicU64>, u64)>,
    count: u32,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Origin {
    context: u64,
    name: Arc<str>,
}

impl Item for Packet {
    type Key = Origin;

    fn lane(&self) -> Lane {
        self.lane
    }

    fn delivery(&self) -> Delivery {
        LOOKS.with(|looks| looks.set(looks.get() + 1));
        self.delivery
    }

    fn key(&self) -> Origin {
        self.origin.clone()
    }

    fn frames(&self, _: Option<Form>) -> Option<&Encoded> {
        Some(&self.frames)
    }

    fn parcel(&self) -> Option<&Arc<Parcel>> {
        None
    }

    fn charge(&self, _: Option<Form>) -> usize {
        self.frames.len() + 64
    }

    fn count(&self) -> u32 {
        self.count
    }

    fn checksum_word(&self) -> u32 {
        binary::checksum_word(&self.frames.head)
    }

    fn counts(&self) -> bool {
        &*self.origin.name != "resent"
    }

    fn repeats(&self, older: &Packet) -> bool {
        matches!(&*self.origin.name, "stop" | "unstop") && self.origin == older.origin
    }

    fn withdraws(&self, waiting: &Packet) -> bool {
        self.origin.context == waiting.origin.context && &*waiting.origin.name == "unstop"
    }

    fn waits_behind_data(&self) -> bool {
        matches!(&*self.origin.name, "unstop" | "release")
    }

    fn follows(&self, earlier: &Packet) -> bool {
        self.origin.context == earlier.origin.context
    }

    fn outlives_loss(&self) -> bool {
        &*self.origin.name != "command"
    }
}

/// What was dropped, by reason and class.
#[derive(Debug, Default)]
struct Drops(BTreeMap<(DropReason, Delivery), u64>);

impl DropPolicy<Packet> for Drops {
    fn stale(&self, packet: &Packet, now: u64) -> Option<DropReason> {
        let closed = |(gate, fence): &(Arc<AtomicU64>, u64)| gate.load(Ordering::Acquire) != *fence;
        match packet {
            Packet {
                expires_at: Some(end),
                ..
            } if now >= *end => Some(DropReason::Expired),
            Packet { gate: Some(gate), .. } if closed(gate) => Some(DropReason::Fence),
            _ => None,
        }
    }

    fn dropped(&mut self, packet: &Arc<Packet>, parcels: u64, reason: DropReason) {
        *self.0.entry((reason, packet.delivery)).or_default() += parcels;
    }
}

type Queue = SendQueue<Packet, Drops>;
type Piece = super::Piece<Packet>;

impl Queue {
    fn take_drops(&mut self) -> BTreeMap<(DropReason, Delivery), u64> {
        std::mem::take(&mut self.policy().0)
    }
}

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
        frames: Encoded {
            head: Bytes::from(frame),
            body: Bytes::new(),
        },
        lane,
        delivery,
        origin: Origin {
            context: 1,
            name: name.into(),
        },
        expires_at: None,
        gate: None,
        count: 1,
    }
}

fn entry(name: &str, lane: Lane, delivery: Delivery) -> Arc<Packet> {
    Arc::new(packet(name, lane, delivery))
}

fn data(name: &str, delivery: Delivery) -> Arc<Packet> {
    entry(name, Lane::Data(0), delivery)
}

fn queue(limit: usize) -> Queue {
    SendQueue::new(Some(Form::Binary), limit, Drops::default())
}

fn pop(queue: &mut Queue, now: u64) -> Option<Piece> {
    queue.pop(now, usize::MAX)
}

fn name(piece: &Piece) -> String {
    piece
        .item()
        .map(|item| item.origin.name.to_string())
        .unwrap_or_default()
}

fn names(queue: &mut Queue) -> Vec<String> {
    std::iter::from_fn(|| pop(queue, 0))
        .map(|piece| name(&piece))
        .collect()
}

#[test]
fn lanes_leave_in_their_order() {
    let mut queue = queue(100_000);
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

/// However much waits that may not be dropped, the room for one more is found in a few looks: a sender that floods a slow
/// receiver does not hold its outbox.
#[test]
fn what_may_be_dropped_is_not_looked_for_twice() {
    let mut queue = queue(2_100_000);
    for _ in 0..2_000 {
        queue.push(data("state", Delivery::Reliable));
    }
    for _ in 0..100 {
        assert_eq!(queue.push(data("scan", Delivery::Fleeting)), Taken::Yes);
    }
    let looks = LOOKS.get();
    for _ in 0..1_000 {
        assert_eq!(queue.push(data("scan", Delivery::Fleeting)), Taken::Yes);
    }
    let looks = LOOKS.get() - looks;
    assert!(looks < 20_000, "{looks} looks for 1000 packets behind 2000");
    let dropped = (DropReason::Full, Delivery::Fleeting);
    assert_eq!(queue.take_drops(), BTreeMap::from([(dropped, 1_000)]));
}

#[test]
fn a_full_queue_drops_by_class() {
    let mut queue = queue(3000);
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
    let mut queue = queue(3000);
    queue.push(data("pose", Delivery::Latest));
    queue.push(data("chat", Delivery::Reliable));
    for _ in 0..1000 {
        assert_eq!(queue.push(data("pose", Delivery::Latest)), Taken::Yes);
    }
    assert_eq!(queue.data_bytes(), 2000);
    assert_eq!(names(&mut queue), ["pose", "chat"]);
    assert!(queue.latest.is_empty());
    let drops: Vec<_> = queue.take_drops().into_iter().collect();
    assert_eq!(drops, [((DropReason::Replaced, Delivery::Latest), 1000)]);
}

/// A newer value that can have no room pushes out nothing; one that has outgrown its place goes behind the others, once.
#[test]
fn a_larger_value_of_latest_never_costs_both() {
    let pose = |size: usize| {
        let frames = Encoded {
            head: vec![b'x'; size - 64].into(),
            body: Bytes::new(),
        };
        Arc::new(Packet {
            frames,
            ..packet("pose", Lane::Data(0), Delivery::Latest)
        })
    };
    let mut queue = queue(3000);
    queue.push(pose(500));
    queue.push(data("f", Delivery::Fleeting));
    queue.push(data("r", Delivery::Reliable));
    assert_eq!(
        queue.push(pose(2500)),
        Taken::Dropped,
        "beside what may not be dropped"
    );
    assert_eq!(queue.data_bytes(), 2500, "the older one and the rest are kept");
    assert_eq!(queue.push(pose(2000)), Taken::Yes);
    assert_eq!(queue.data_bytes(), 3000);
    assert_eq!(
        queue.push(pose(1000)),
        Taken::Yes,
        "it takes the place of the one before"
    );
    assert_eq!(names(&mut queue), ["r", "pose"]);
    let reasons: Vec<_> = queue.take_drops().into_iter().collect();
    let expected = [
        ((DropReason::Replaced, Delivery::Latest), 2),
        ((DropReason::Full, Delivery::Latest), 1),
        ((DropReason::Full, Delivery::Fleeting), 1),
    ];
    assert_eq!(BTreeMap::from_iter(reasons), BTreeMap::from(expected));
    assert!(queue.latest.is_empty());
}

#[test]
fn stale_parcels_do_not_leave() {
    let mut queue = queue(10_000);
    let gate = Arc::new(AtomicU64::new(7));
    let guarded = Arc::new(Packet {
        gate: Some((Arc::clone(&gate), 7)),
        ..packet("command", Lane::Data(0), Delivery::Reliable)
    });
    queue.push(Arc::clone(&guarded));
    queue.push(Arc::new(Packet {
        expires_at: Some(50),
        ..packet("old", Lane::Data(0), Delivery::Reliable)
    }));
    queue.push(data("chat", Delivery::Reliable));
    assert_eq!(
        pop(&mut queue, 49).map(|piece| name(&piece)),
        Some("command".into())
    );
    queue.push(guarded);
    gate.store(8, Ordering::Release);
    assert_eq!(pop(&mut queue, 50).map(|piece| name(&piece)), Some("chat".into()));
    assert!(pop(&mut queue, 50).is_none());
    let reasons: Vec<_> = queue.take_drops().into_keys().map(|(reason, _)| reason).collect();
    assert_eq!(reasons, [DropReason::Expired, DropReason::Fence]);
}

/// Of two stops for the same devices the newest leaves, at the place of the older one; also where the older one comes back
/// from a link that did not take it.
#[test]
fn the_newest_stop_leaves() {
    let stop = |size: usize| {
        let frames = Encoded {
            head: vec![b'x'; size].into(),
            body: Bytes::new(),
        };
        Arc::new(Packet {
            frames,
            ..packet("stop", Lane::Stop, Delivery::Reliable)
        })
    };
    let lengths = |queue: &mut Queue| -> Vec<usize> {
        std::iter::from_fn(|| pop(queue, 0))
            .map(|piece| piece.left())
            .collect()
    };
    let mut queue = queue(100_000);
    for size in [10, 20, 30] {
        queue.push(stop(size));
    }
    assert_eq!(lengths(&mut queue), [30]);
    assert_eq!(
        queue.take_drops().values().sum::<u64>(),
        2,
        "the older ones are told"
    );
    queue.push(stop(10));
    let older = pop(&mut queue, 0).expect("it waits");
    queue.push(stop(20));
    queue.put_back(older);
    assert_eq!(lengths(&mut queue), [20]);
    assert_eq!(queue.take_drops().values().sum::<u64>(), 1);
}

/// Whatever waits in which order, a device that was stopped last stays stopped.
/// Some leave where nothing else may; more wait, and a newer one takes the place of one that waits.
#[test]
fn no_more_stops_leave_than_the_network_may_hold() {
    let stop = |context| {
        let stop = packet("stop", Lane::Stop, Delivery::Reliable);
        Arc::new(Packet {
            origin: Origin {
                context,
                ..stop.origin.clone()
            },
            ..stop
        })
    };
    let size = stop(0).frames.len();
    let mut queue = queue(100_000);
    queue.push(data("chat", Delivery::Reliable));
    let left = |stops: usize, queue: &mut Queue| {
        let mut batch = VecDeque::new();
        let allowance = Allowance {
            bytes: 0,
            piece: 1000,
            stops,
        };
        let rest = queue.take(0, allowance, &mut batch);
        assert_eq!(batch.is_empty(), matches!(rest, Rest::NoRoom), "{rest:?}");
        batch.len()
    };
    let push =
        |queue: &mut Queue| (0..10).for_each(|context| assert_eq!(queue.push(stop(context)), Taken::Yes));
    push(&mut queue);
    assert_eq!(left(3 * size, &mut queue), 3);
    assert_eq!(left(0, &mut queue), 0);
    push(&mut queue);
    assert_eq!(
        left(usize::MAX, &mut queue),
        10,
        "of those that wait the newest ones"
    );
    assert_eq!(names(&mut queue), ["chat"]);
}

#[test]
fn a_stop_withdraws_an_unstop_that_waits() {
    let mut queue = queue(100_000);
    let stop = entry("stop", Lane::Stop, Delivery::Reliable);
    let unstop = entry("unstop", Lane::Control, Delivery::Reliable);
    for each in [&stop, &unstop, &stop] {
        assert_eq!(queue.push(each.clone()), Taken::Yes);
    }
    assert_eq!(names(&mut queue), ["stop"]);
    let reasons: Vec<_> = queue.take_drops().into_keys().map(|(reason, _)| reason).collect();
    assert!(reasons.contains(&DropReason::Withdrawn), "the unstop is told");
    queue.push(stop.clone());
    queue.push(unstop.clone());
    assert_eq!(names(&mut queue), ["stop", "unstop"]);
    queue.push(unstop);
    queue.push(Arc::new(Packet {
        origin: Origin {
            context: 2,
            ..stop.origin.clone()
        },
        ..packet("stop", Lane::Stop, Delivery::Reliable)
    }));
    assert_eq!(names(&mut queue), ["stop", "unstop"], "of another channel");
}

/// A parcel may be larger than the bound; a receiver that is not behind gets it.
#[test]
fn an_empty_queue_takes_any_parcel() {
    for class in [Delivery::Reliable, Delivery::Latest, Delivery::Fleeting] {
        let mut queue = queue(900);
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
    let mut queue = queue(3000);
    queue.push(data("first", Delivery::Reliable));
    for turn in 0..10_000 {
        queue.push(data("fleeting", Delivery::Fleeting));
        queue.push(entry("pose", Lane::Data(turn % 2), Delivery::Latest));
    }
    let places: usize = queue.data.values().map(|lane| lane.places()).sum();
    assert!(places < 500, "{places} places for 3 parcels");
    assert_eq!(
        pop(&mut queue, 0).map(|piece| name(&piece)).as_deref(),
        Some("pose")
    );
}

/// What a blocked link did not take is looked at again: it may be overtaken, replaced, or lose its owner.
#[test]
fn what_is_put_back_keeps_its_place_and_no_privilege() {
    let mut queue = queue(100_000);
    let gate = Arc::new(AtomicU64::new(7));
    let command = Arc::new(Packet {
        gate: Some((Arc::clone(&gate), 7)),
        ..packet("command", Lane::Data(0), Delivery::Reliable)
    });
    for each in [
        &data("first", Delivery::Reliable),
        &command,
        &data("pose", Delivery::Latest),
    ] {
        queue.push(each.clone());
    }
    let taken: Vec<Piece> = std::iter::from_fn(|| pop(&mut queue, 0)).collect();
    queue.push(data("pose", Delivery::Latest));
    queue.push(entry("stop", Lane::Stop, Delivery::Reliable));
    gate.store(8, Ordering::Release);
    taken.into_iter().rev().for_each(|piece| queue.put_back(piece));
    assert_eq!(names(&mut queue), ["stop", "first", "pose"]);
    let reasons: Vec<_> = queue.take_drops().into_keys().map(|(reason, _)| reason).collect();
    assert_eq!(reasons, [DropReason::Replaced, DropReason::Fence]);
    assert_eq!(queue.data_bytes(), 0);
}

#[test]
fn an_unstop_is_not_put_back_behind_a_stop() {
    let mut queue = queue(100_000);
    queue.push(entry("unstop", Lane::Control, Delivery::Reliable));
    let unstop = pop(&mut queue, 0).unwrap();
    queue.push(entry("stop", Lane::Stop, Delivery::Reliable));
    queue.put_back(unstop);
    assert_eq!(names(&mut queue), ["stop"]);
}

#[test]
fn the_last_word_leaves_last_however_full_the_queue_is() {
    let mut queue = queue(1000);
    queue.push(data("chat", Delivery::Reliable));
    queue.push_last(entry("shutdown", Lane::Control, Delivery::Reliable));
    queue.push(entry("reply", Lane::Control, Delivery::Reliable));
    assert_eq!(names(&mut queue), ["reply", "chat", "shutdown"]);
}

/// A client's `release` leaves after what was sent before it under its token, and nothing that is newer leaves in front of it, not
/// even in the place of an older value.
#[test]
fn what_waits_behind_data_is_crossed_by_nothing_newer() {
    let elsewhere = |name: &str, priority| {
        Arc::new(Packet {
            origin: Origin {
                context: 2,
                name: name.into(),
            },
            ..packet(name, Lane::Data(priority), Delivery::Reliable)
        })
    };
    let mut queue = queue(100_000);
    queue.push(data("pose", Delivery::Latest));
    queue.push(entry("low", Lane::Data(-5), Delivery::Reliable));
    queue.push(elsewhere("chat", 0));
    queue.push(elsewhere("map", -9));
    assert_eq!(
        queue.push(entry("release", Lane::Control, Delivery::Reliable)),
        Taken::Yes
    );
    queue.push(data("pose", Delivery::Latest));
    queue.push(entry("high", Lane::Data(5), Delivery::Reliable));
    queue.push(entry("ping", Lane::Sign, Delivery::Reliable));
    queue.push(entry("stop", Lane::Stop, Delivery::Reliable));
    assert_eq!(
        names(&mut queue),
        ["stop", "ping", "chat", "low", "release", "high", "pose", "map"]
    );
    assert_eq!(queue.take_drops().values().sum::<u64>(), 1, "the older pose");
    queue.push(data("pose", Delivery::Latest));
    queue.push(data("pose", Delivery::Latest));
    assert_eq!(names(&mut queue), ["pose"], "nothing waits behind data any more");
}

/// What a link has taken and gives back was said before, too.
#[test]
fn what_comes_back_is_waited_for() {
    let mut queue = queue(100_000);
    queue.push(data("note", Delivery::Reliable));
    let note = pop(&mut queue, 0).expect("it waits");
    queue.push(entry("release", Lane::Control, Delivery::Reliable));
    queue.put_back(note);
    queue.push(entry("newer", Lane::Data(9), Delivery::Reliable));
    let taken: Vec<Piece> = std::iter::from_fn(|| pop(&mut queue, 0)).collect();
    let order: Vec<String> = taken.iter().map(name).collect();
    assert_eq!(order, ["note", "release", "newer"]);
    taken.into_iter().rev().for_each(|piece| queue.put_back(piece));
    assert_eq!(names(&mut queue), ["note", "release", "newer"]);
}

/// One `unstop` is enough, as one stop is: the newest, behind what was said before it.
#[test]
fn the_newest_unstop_leaves_in_its_own_place() {
    let mut queue = queue(100_000);
    let unstop = || entry("unstop", Lane::Control, Delivery::Reliable);
    queue.push(unstop());
    let older = pop(&mut queue, 0).expect("it waits");
    queue.push(data("note", Delivery::Reliable));
    queue.push(unstop());
    queue.push(data("more", Delivery::Reliable));
    queue.push(unstop());
    queue.put_back(older);
    assert_eq!(names(&mut queue), ["note", "more", "unstop"]);
    assert_eq!(queue.take_drops()[&(DropReason::Replaced, Delivery::Reliable)], 2);
}
