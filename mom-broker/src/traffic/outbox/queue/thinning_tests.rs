//! The promises of the queue to receivers that want fewer.

use std::sync::Arc;

use mom_hub::PeerId;
use mom_net::{Lane, Ledger};
use mom_proto::{ContextNumber, Delivery, Micros};

use super::tests::{data, name, pop, queue};
use super::{DropReason, Packet, PeerQueue, Taken};

const EVERY: Micros = 1000;

/// A message as it comes to such a receiver; its priority tells it from others of the same name.
fn message(name: &str, number: i32) -> Packet {
    let mut packet = data(name, Delivery::Reliable).as_latest();
    packet.lane = Lane::Data(number);
    packet
}

fn offer(queue: &mut PeerQueue, name: &str, number: i32, now: Micros) -> Option<Taken> {
    queue.push_thinned(Arc::new(message(name, number)), EVERY, now)
}

/// What leaves by now: names and numbers.
fn leaves(queue: &mut PeerQueue, now: Micros) -> Vec<(String, i32)> {
    queue.release_due(now);
    let number = |lane| match lane {
        Lane::Data(number) => number,
        _ => panic!("{lane:?}"),
    };
    std::iter::from_fn(|| pop(queue, now))
        .map(|piece| (name(&piece), number(piece.item().expect("no abort").lane)))
        .collect()
}

fn drops(queue: &mut PeerQueue) -> Vec<(DropReason, u64)> {
    let drops = queue.take_drops().into_iter();
    drops.map(|(dropped, count)| (dropped.reason, count)).collect()
}

#[test]
fn of_each_name_the_newest_leaves_when_its_turn_comes() {
    let mut queue = queue(100_000);
    assert_eq!(offer(&mut queue, "pose", 1, 0), Some(Taken::Yes));
    assert_eq!(leaves(&mut queue, 0), [("pose".to_owned(), 1)]);
    assert_eq!(queue.due(), None, "nothing waits, so nobody is woken");
    for number in 2..=4 {
        assert_eq!(offer(&mut queue, "pose", number, 500), None);
    }
    assert_eq!(
        offer(&mut queue, "image", 5, 600),
        Some(Taken::Yes),
        "a turn of its own"
    );
    assert_eq!(offer(&mut queue, "image", 6, 700), None);
    assert_eq!(queue.due(), Some(1000));
    assert!(!queue.queue.is_empty());
    assert_eq!(leaves(&mut queue, 999), [("image".to_owned(), 5)]);
    assert!(
        queue.queue.is_empty(),
        "what waits for its turn is nothing to write"
    );
    assert_eq!(leaves(&mut queue, 1000), [("pose".to_owned(), 4)]);
    assert_eq!(queue.due(), Some(1600));
    // A timer that is late: turns are counted from when one was taken, so that two never come together.
    assert_eq!(leaves(&mut queue, 5000), [("image".to_owned(), 6)]);
    assert_eq!(offer(&mut queue, "image", 7, 5999), None);
    assert_eq!(
        offer(&mut queue, "image", 8, 6000),
        Some(Taken::Yes),
        "the newest has the turn"
    );
    assert_eq!(leaves(&mut queue, 6000), [("image".to_owned(), 8)]);
    assert_eq!(drops(&mut queue), [(DropReason::Rate, 3)]);
    assert_eq!((queue.due(), queue.queue.data_bytes()), (None, 0));
}

#[test]
fn over_a_long_time_the_rate_holds() {
    let mut queue = queue(100_000);
    let (mut heard, mut last) = (Vec::new(), 0);
    for now in (0..100 * EVERY).step_by(70) {
        last = i32::try_from(now / 70).unwrap();
        offer(&mut queue, "pose", last, now);
        heard.extend(leaves(&mut queue, now).into_iter().map(|(_, number)| number));
    }
    assert!((93..=100).contains(&heard.len()), "{}", heard.len());
    assert!(heard.is_sorted());
    heard.extend(
        leaves(&mut queue, 200 * EVERY)
            .into_iter()
            .map(|(_, number)| number),
    );
    assert_eq!(heard.last(), Some(&last), "the last word is heard");
    let (dropped, all) = (drops(&mut queue), u64::try_from(last + 1).unwrap());
    assert_eq!(dropped, [(DropReason::Rate, all - heard.len() as u64)]);
}

#[test]
fn newest_only_replaces_what_the_link_has_not_taken() {
    let mut queue = queue(100_000);
    for _ in 0..3 {
        let packet = Arc::new(message("chat", 0));
        assert_eq!(queue.push_thinned(packet, 0, 0), Some(Taken::Yes));
    }
    assert_eq!(leaves(&mut queue, 0), [("chat".to_owned(), 0)]);
    assert_eq!(drops(&mut queue), [(DropReason::Replaced, 2)]);
}

#[test]
fn a_turn_that_comes_too_late_for_a_message_drops_it() {
    let mut queue = queue(100_000);
    offer(&mut queue, "pose", 1, 0);
    assert_eq!(leaves(&mut queue, 0), [("pose".to_owned(), 1)]);
    let mut over = message("pose", 2);
    over.expires_at = Some(900);
    assert_eq!(queue.push_thinned(Arc::new(over), EVERY, 10), None);
    assert_eq!(leaves(&mut queue, 1000), []);
    assert_eq!(drops(&mut queue), [(DropReason::Expired, 1)]);
}

#[test]
fn turns_end_with_their_channel() {
    for hears in [true, false] {
        let mut queue = queue(100_000);
        let elsewhere = |number| {
            let mut packet = message("other", number);
            packet.origin.context = ContextNumber(2);
            Arc::new(packet)
        };
        offer(&mut queue, "pose", 1, 0);
        offer(&mut queue, "pose", 2, 1);
        queue.push_thinned(elsewhere(3), EVERY, 2);
        queue.push_thinned(elsewhere(4), EVERY, 3);
        assert_eq!(leaves(&mut queue, 4).len(), 2);
        if hears {
            queue.release_thinned(ContextNumber(1));
            assert_eq!(leaves(&mut queue, 5), [("pose".to_owned(), 2)]);
        } else {
            assert_eq!(queue.drop_thinned(Some(ContextNumber(1))).len(), 1);
            assert_eq!(leaves(&mut queue, 5), []);
            assert_eq!(drops(&mut queue), [(DropReason::Closed, 1)]);
        }
        assert_eq!(
            offer(&mut queue, "pose", 9, 6),
            Some(Taken::Yes),
            "a turn of a new count"
        );
        assert_eq!(queue.due(), Some(1002), "of the other channel");
        drop(queue.drop_data());
        assert_eq!((queue.due(), queue.queue.is_empty()), (None, true));
        let closed: u64 = drops(&mut queue).into_iter().map(|(_, count)| count).sum();
        assert_eq!(closed, 2);
    }
}

#[test]
fn what_waits_for_its_turn_is_bounded() {
    let mut queue = queue(3000);
    for name in ["a", "b", "c", "d"] {
        offer(&mut queue, name, 0, 0);
        leaves(&mut queue, 0);
    }
    for name in ["a", "b", "c"] {
        assert_eq!(offer(&mut queue, name, 1, 1), None);
    }
    assert_eq!(offer(&mut queue, "d", 1, 1), Some(Taken::Dropped));
    assert_eq!(offer(&mut queue, "c", 2, 1), None, "in place of the older one");
    assert_eq!(drops(&mut queue), [(DropReason::Full, 1), (DropReason::Rate, 1)]);
    assert_eq!(leaves(&mut queue, 2000).len(), 3);
}

/// A sender that makes up names, and many senders that come and go, fill no memory.
#[test]
fn turns_are_bounded_too() {
    let mut queue = queue(10_000_000);
    for number in 0..1000 {
        offer(&mut queue, &format!("n{number}"), 0, 0);
    }
    assert_eq!(leaves(&mut queue, 0).len(), 65, "the further names share a turn");
    assert_eq!(leaves(&mut queue, EVERY).len(), 1);
    for peer in 2..10_000 {
        let mut packet = message("pose", 0);
        packet.origin.sender = PeerId(peer);
        queue.push_thinned(Arc::new(packet), EVERY, peer * EVERY);
        leaves(&mut queue, peer * EVERY);
    }
    let kept = queue.thinner.as_ref().map_or(0, |thinner| thinner.senders());
    assert!(kept <= 64, "{kept}");
}

/// What moves a device does not wait for its turn over a loss.
#[test]
fn a_turn_does_not_bring_a_command_over_a_loss() {
    let command = |number| {
        let mut packet = message("command", number);
        packet.outlives_loss = false;
        Arc::new(packet)
    };
    let (mut queue, mut ledger) = (queue(100_000), Ledger::new(100_000));
    offer(&mut queue, "pose", 1, 0);
    queue.push_thinned(command(2), EVERY, 0);
    assert_eq!(leaves(&mut queue, 0).len(), 2);
    offer(&mut queue, "pose", 3, 1);
    assert_eq!(queue.push_thinned(command(4), EVERY, 1), None);
    drop(queue.lose(&mut ledger));
    assert_eq!(
        queue.push_thinned(command(5), EVERY, 2),
        Some(Taken::Dropped),
        "nor is it taken"
    );
    assert_eq!(queue.push_thinned(command(6), 0, 3), Some(Taken::Dropped));
    assert_eq!(drops(&mut queue), [(DropReason::Lost, 3)]);
    queue.find();
    assert_eq!(leaves(&mut queue, EVERY), [("pose".to_owned(), 3)]);
    assert_eq!(queue.push_thinned(command(7), EVERY, EVERY), Some(Taken::Yes));
    assert_eq!(leaves(&mut queue, EVERY), [("command".to_owned(), 7)]);
}
