//! Which records go where, and who is answered.

use mom_hub::{Record, Ticket};
use mom_proto::Path;

use super::{free, owned};
use crate::queue::{StoreBatch, StoreQueue};

fn queue() -> StoreQueue {
    StoreQueue::new(100, vec![0; 4], [])
}

fn put(queue: &mut StoreQueue, record: Record, ticket: impl Into<Option<u64>>) {
    assert!(queue.put(record, ticket.into().map(Ticket)), "a lane is left");
}

/// Path and fence of what a lane is to write.
fn shown(batch: &StoreBatch) -> Vec<(&str, u64)> {
    batch
        .records
        .iter()
        .map(|(_, record)| (record.path.as_str(), record.fence))
        .collect()
}

fn take(queue: &mut StoreQueue, lane: usize) -> StoreBatch {
    queue.take(lane).expect("there is something to write")
}

#[test]
fn of_each_token_the_newest_waits() {
    let mut queue = queue();
    for fence in 1..=3 {
        put(&mut queue, free("/a", fence), None);
        put(&mut queue, free("/b", fence), None);
    }
    let batch = take(&mut queue, 0);
    assert_eq!(shown(&batch), [("/a", 3), ("/b", 3)]);
    assert_eq!(batch.meta.seen, [6, 0, 0, 0]);
    assert_eq!(queue.finish(0, batch, true), []);
    assert!(queue.is_quiet());
}

#[test]
fn a_newer_record_stands_for_the_awaited_older_one() {
    let mut queue = queue();
    put(&mut queue, free("/a", 1), None);
    put(&mut queue, owned("/a", 2), 20);
    put(&mut queue, owned("/b", 3), 30);
    put(&mut queue, owned("/a", 4), 40);
    put(&mut queue, free("/a", 5), None);
    let batch = take(&mut queue, 1);
    assert_eq!(shown(&batch), [("/a", 5), ("/b", 3)]);
    let mut answers = queue.finish(1, batch, true);
    answers.sort();
    assert_eq!(
        answers,
        [(Ticket(20), true), (Ticket(30), true), (Ticket(40), true)]
    );
}

#[test]
fn a_later_record_of_a_token_does_not_wait_for_an_earlier_one() {
    let mut queue = queue();
    put(&mut queue, owned("/a", 1), 1);
    let first = take(&mut queue, 0);
    put(&mut queue, owned("/a", 2), 2);
    let second = take(&mut queue, 3);
    assert!(first.records[0].0 < second.records[0].0, "the sequence rises");
    assert_eq!(queue.finish(3, second, true), [(Ticket(2), true)]);
    assert_eq!(queue.finish(0, first, true), [(Ticket(1), true)]);
}

#[test]
fn what_nobody_awaits_is_in_one_lane_at_a_time() {
    let mut queue = queue();
    put(&mut queue, free("/a", 1), None);
    let first = take(&mut queue, 0);
    for token in ["/b", "/c", "/d"] {
        put(&mut queue, free(token, 1), None);
    }
    assert!(
        queue.take(1).is_none(),
        "releases leave the other lanes to grants"
    );
    put(&mut queue, owned("/e", 1), 5);
    let grant = take(&mut queue, 1);
    assert_eq!(shown(&grant), [("/e", 1)], "and are not carried along");
    assert_eq!(queue.finish(0, first, true), []);
    assert_eq!(shown(&take(&mut queue, 0)).len(), 3);
    assert!(!queue.is_quiet());
}

#[test]
fn the_last_lane_takes_both_kinds_by_turns() {
    let mut queue = StoreQueue::new(100, vec![0], []);
    put(&mut queue, free("/free", 1), None);
    put(&mut queue, owned("/a", 1), 1);
    for turn in 0..6 {
        let batch = take(&mut queue, 0);
        let expected = if turn % 2 == 0 { "/a" } else { "/free" };
        assert_eq!(shown(&batch)[0].0, expected, "turn {turn}");
        put(&mut queue, free("/free", 2 + turn), None);
        put(&mut queue, owned("/a", 2 + turn), 2 + turn);
        queue.finish(0, batch, true);
    }
}

#[test]
fn commits_tell_what_the_other_lanes_have() {
    let mut queue = StoreQueue::new(100, vec![5, 6, 7, 8], []);
    put(&mut queue, owned("/a", 1), 1);
    let batch = take(&mut queue, 2);
    assert_eq!(batch.meta.seen, [5, 6, 9, 8]);
    put(&mut queue, owned("/b", 1), 2);
    let other = take(&mut queue, 0);
    assert_eq!(other.meta.seen, [10, 6, 7, 8], "only what is durable");
    queue.finish(2, batch, true);
    put(&mut queue, owned("/c", 1), 3);
    assert_eq!(take(&mut queue, 1).meta.seen, [5, 11, 9, 8]);
    assert_eq!(other.meta.epoch, 100);
}

#[test]
fn a_lane_that_failed_is_not_used_again() {
    let mut queue = queue();
    put(&mut queue, free("/a", 1), None);
    put(&mut queue, owned("/a", 2), 2);
    put(&mut queue, owned("/b", 3), 3);
    let batch = take(&mut queue, 0);
    let mut answers = queue.finish(0, batch, false);
    answers.sort();
    assert_eq!(answers, [(Ticket(2), false), (Ticket(3), false)]);
    // The release was before the grant that failed, and still holds.
    let again = take(&mut queue, 1);
    assert_eq!(shown(&again), [("/a", 1)]);
    // Nothing brings it back over what is newer.
    put(&mut queue, free("/a", 4), None);
    assert_eq!(queue.finish(1, again, false), []);
    assert_eq!(shown(&take(&mut queue, 2)), [("/a", 4)]);
}

#[test]
fn without_a_lane_everything_is_refused_at_once() {
    let mut queue = queue();
    for lane in 0..4 {
        put(&mut queue, owned("/a", lane), lane);
    }
    let batch = take(&mut queue, 0);
    assert_eq!(batch.records.len(), 1);
    assert_eq!(queue.finish(0, batch, false).len(), 4);
    for lane in 1..4 {
        put(&mut queue, owned("/a", 9), 9);
        let batch = take(&mut queue, lane);
        if lane == 3 {
            put(&mut queue, owned("/b", 9), 10);
            put(&mut queue, free("/c", 9), None);
        }
        let answers = queue.finish(lane, batch, false);
        let all = [(Ticket(9), false), (Ticket(10), false)];
        let expected = if lane == 3 { &all[..] } else { &all[..1] };
        assert_eq!(answers, expected, "what waits is refused with the last lane");
    }
    assert!(queue.is_dead() && queue.is_quiet());
    assert!(!queue.put(owned("/a", 10), Some(Ticket(10))));
}

fn gone(batch: &StoreBatch) -> Vec<&str> {
    batch.gone.iter().map(Path::as_str).collect()
}

/// What one lane holds of a token is removed once another has something newer, and what is free last of all.
#[test]
fn what_is_not_needed_goes_and_the_newest_last() {
    let mut queue = queue();
    put(&mut queue, owned("/a", 1), 1);
    let grant = take(&mut queue, 0);
    queue.finish(0, grant, true);
    put(&mut queue, free("/a", 1), None);
    let release = take(&mut queue, 1);
    assert_eq!(gone(&release), [""; 0]);
    queue.finish(1, release, true);
    // The release stays as long as the grant would come back without it.
    put(&mut queue, owned("/b", 2), 2);
    let other = take(&mut queue, 1);
    assert_eq!(gone(&other), [""; 0]);
    put(&mut queue, owned("/c", 3), 3);
    let older = take(&mut queue, 0);
    assert_eq!(gone(&older), ["/a"]);
    assert!(
        older.meta.last() > older.records[0].0,
        "an old copy of the file is behind"
    );
    put(&mut queue, owned("/d", 4), 4);
    let third = take(&mut queue, 2);
    queue.finish(1, other, true);
    put(&mut queue, owned("/e", 5), 5);
    let early = take(&mut queue, 1);
    assert_eq!(gone(&early), [""; 0], "the older one is not surely gone");
    queue.finish(0, older, true);
    queue.finish(1, early, true);
    put(&mut queue, owned("/f", 6), 6);
    let last = take(&mut queue, 1);
    assert_eq!(gone(&last), ["/a"]);
    queue.finish(1, last, true);
    queue.finish(2, third, true);
}

/// A record that is on its way to a lane may land after the release that came later.
#[test]
fn a_release_stays_while_its_grant_is_being_written() {
    let mut queue = queue();
    put(&mut queue, owned("/a", 1), 1);
    let slow = take(&mut queue, 0);
    put(&mut queue, free("/a", 1), None);
    let release = take(&mut queue, 1);
    queue.finish(1, release, true);
    put(&mut queue, owned("/b", 2), 2);
    let other = take(&mut queue, 1);
    assert_eq!(gone(&other), [""; 0]);
    queue.finish(1, other, true);
    // It failed: whether it is there is not known, and what would overrule it stays for good.
    queue.finish(0, slow, false);
    put(&mut queue, owned("/c", 3), 3);
    assert_eq!(gone(&take(&mut queue, 1)), [""; 0]);
}

/// A fence that ran into the next epoch's numbers is not forgotten with its row.
#[test]
fn the_epoch_of_a_row_outlives_it() {
    let mut queue = queue();
    put(&mut queue, free("/a", 102 << 20), None);
    let release = take(&mut queue, 0);
    assert_eq!(release.meta.epoch, 100);
    queue.finish(0, release, true);
    put(&mut queue, owned("/b", 1), 1);
    let batch = take(&mut queue, 0);
    assert_eq!((gone(&batch), batch.meta.epoch), (vec!["/a"], 102));
}

/// A lane that has much to remove does so although there is nothing to write.
#[test]
fn much_is_removed_by_itself() {
    let mut queue = queue();
    for token in 0..2000 {
        put(&mut queue, free(&format!("/{token}"), 1), None);
    }
    let release = take(&mut queue, 0);
    queue.finish(0, release, true);
    let mut removed = 0;
    while let Some(batch) = queue.take(0) {
        assert!(batch.records.is_empty() && batch.gone.len() <= 256);
        removed += batch.gone.len();
        queue.finish(0, batch, true);
    }
    assert!(removed > 1700 && queue.is_quiet(), "{removed}");
}
