//! The promises of the line.

use std::task::Waker;

use mom_proto::Delivery;

use super::PeerQueue;
use super::tests::{data, pop, queue};

/// What each parcel of these tests counts.
const ONE: usize = 1000;

/// With three parcels that may not be dropped: half of the bound.
fn half_full() -> PeerQueue {
    let mut queue = queue(6 * ONE);
    for _ in 0..3 {
        queue.queue.push(data("r", Delivery::Reliable));
    }
    queue
}

fn calls(queue: &mut PeerQueue, ticket: u64) -> bool {
    queue.is_called(ticket, Waker::noop())
}

#[test]
fn who_waits_has_half_and_the_rest_is_for_others() {
    let mut queue = half_full();
    assert!(!queue.has_capacity(1, None));
    assert!(queue.could_take(3 * ONE) && !queue.could_take(3 * ONE + 1));
    for _ in 0..3 {
        assert_eq!(queue.queue.push(data("r", Delivery::Reliable)), super::Taken::Yes);
    }
    assert!(!queue.could_take(1));
}

/// What can be dropped makes way, so nobody waits for it.
#[test]
fn nobody_waits_for_what_may_be_dropped() {
    let mut queue = queue(6 * ONE);
    for _ in 0..6 {
        queue.queue.push(data("f", Delivery::Fleeting));
    }
    assert!(queue.has_capacity(3 * ONE, None));
    assert_eq!(queue.capacity_left(), 3 * ONE);
    queue.queue.push(data("r", Delivery::Reliable));
    assert_eq!(queue.capacity_left(), 2 * ONE);
}

/// A parcel may be larger than the bound: it waits until nothing else does.
#[test]
fn a_very_large_one_goes_alone() {
    let mut queue = half_full();
    assert!(!queue.has_capacity(100 * ONE, None));
    while pop(&mut queue, 0).is_some() {}
    assert!(queue.has_capacity(100 * ONE, None));
}

#[test]
fn room_goes_to_whoever_came_first() {
    let mut queue = half_full();
    let first = queue.wait_for(2 * ONE, None, 0);
    let second = queue.wait_for(ONE, None, 0);
    assert_eq!(
        queue.wait_for(2 * ONE, Some(first), 0),
        first,
        "it stays where it is"
    );
    pop(&mut queue, 0);
    queue.call_next();
    assert!(
        !calls(&mut queue, first) && !calls(&mut queue, second),
        "one parcel left, two are needed"
    );
    assert!(!queue.has_capacity(ONE, Some(second)), "not before the first");
    assert_eq!(queue.capacity_left(), 0, "nor for who comes just now");
    pop(&mut queue, 0);
    queue.call_next();
    assert!(calls(&mut queue, first) && !calls(&mut queue, second));
    assert!(queue.has_capacity(2 * ONE, Some(first)));
    queue.stop_waiting(first);
    assert!(calls(&mut queue, second), "the next one's turn");
    assert!(queue.has_capacity(ONE, Some(second)) && !queue.has_capacity(ONE, None));
    queue.stop_waiting(second);
    assert!(queue.has_capacity(ONE, None) && !queue.is_awaited());
}

/// A receiver is full as long as it has no room for the smallest that was waited for, also while nobody waits.
#[test]
fn it_is_known_since_when_there_is_no_room() {
    let mut queue = half_full();
    assert_eq!(queue.full_since(), None);
    let ticket = queue.wait_for(2 * ONE, None, 5);
    queue.stop_waiting(ticket);
    let ticket = queue.wait_for(ONE, None, 9);
    queue.stop_waiting(ticket);
    assert_eq!((queue.full_since(), queue.is_awaited()), (Some(5), true));
    pop(&mut queue, 0);
    queue.call_next();
    assert_eq!((queue.full_since(), queue.is_awaited()), (None, false));
}

/// What a link gives back counts again, and what is thrown away does not.
#[test]
fn bytes_that_may_not_be_dropped_are_counted_right() {
    let mut queue = half_full();
    let piece = pop(&mut queue, 0).expect("three wait");
    assert_eq!(queue.capacity_left(), ONE);
    queue.put_back(&mut [piece].into());
    assert_eq!(queue.capacity_left(), 0);
    drop(queue.drop_data());
    assert_eq!(queue.capacity_left(), 3 * ONE);
}
