//! A token by itself: time, fence floor and owners are given, nobody hears of anything.

use mom_managers::{Expiry, Terms};
use mom_proto::event::Reason;
use mom_proto::{Code, Fence, Path, Value, Verb};

use super::grant::{Grantee, Overtaken};
use super::queue::MOST;
use super::record::{Holder, Record};
use super::state::{Change, Granting, QueuedGrab, Token};
use crate::PeerId;

const SECOND: u64 = 1_000_000;
const ALICE: PeerId = PeerId(1);
const BOB: PeerId = PeerId(2);
const CAROL: PeerId = PeerId(3);
const FLOOR: Fence = Fence::floor(0);

fn token() -> Token {
    Token {
        terms: Terms {
            lease: Some(60 * SECOND),
            ..Terms::default()
        },
        ..Token::default()
    }
}

fn owned_by(peer: PeerId, now: u64) -> Token {
    let mut token = token();
    assert!(
        token
            .change_owner(Some(Grantee::plain(peer)), now, FLOOR)
            .is_none()
    );
    token
}

fn waiter(peer: PeerId, level: i32, since: u64) -> QueuedGrab {
    QueuedGrab {
        peer,
        ticket: peer.0,
        id: None,
        level,
        since,
        until: None,
        answers: Vec::new(),
        asking: false,
        told: 0,
    }
}

fn holder(name: &str) -> Holder {
    Holder {
        user: name.to_owned(),
        name: name.to_owned(),
    }
}

/// What was given for a time: the owner, and its giver.
fn given(mut token: Token, to: PeerId, time: u64, now: u64) -> Token {
    let change = Change {
        from: token.owner_peer(),
        given: Some((Some(time), Some(2))),
        ..Change::to(to, Reason::Given)
    };
    let grantee = token.grantee(&change, now);
    assert!(token.change_owner(Some(grantee), now, FLOOR).is_some());
    token
}

#[test]
fn the_fence_rises_with_each_grant_and_above_the_floor() {
    let mut token = owned_by(ALICE, 0);
    assert_eq!(token.fence, Fence::new(0, 1));
    let floor = Fence::floor(7);
    let former = token.change_owner(None, SECOND, floor).expect("alice had it");
    assert_eq!((former.ownership.peer, former.fence), (ALICE, Fence::new(0, 1)));
    assert_eq!(token.fence, former.fence, "nobody has a new one");
    token.change_owner(Some(Grantee::plain(BOB)), SECOND, floor);
    assert_eq!(token.fence, Fence::new(7, 1));
    token.change_owner(Some(Grantee::plain(CAROL)), SECOND, floor);
    assert_eq!(token.fence, Fence::new(7, 2));
}

#[test]
fn a_lazy_lease_is_a_deadline_only_while_somebody_waits() {
    let mut token = owned_by(ALICE, 0);
    assert_eq!((token.deadline(), token.lapsed(60 * SECOND)), (None, true));
    token.enqueue(waiter(BOB, 0, 0)).unwrap();
    assert_eq!(token.deadline(), Some(60 * SECOND));
    token.dequeue(BOB.0).unwrap();
    token.terms.expiry = Expiry::Eager;
    token.renew(SECOND);
    assert_eq!(token.deadline(), Some(61 * SECOND));
    assert_eq!(token.reason_at_deadline(61 * SECOND), Reason::Expired);
}

#[test]
fn what_was_given_returns_until_the_givers_own_time_is_over() {
    let mut token = owned_by(ALICE, 0);
    token.owner.as_mut().unwrap().until = Some(30 * SECOND);
    let mut token = given(token, BOB, 10 * SECOND, 5 * SECOND);
    assert_eq!(token.giver(), Some(ALICE));
    assert_eq!(token.deadline(), Some(15 * SECOND));
    assert_eq!(token.reason_at_deadline(15 * SECOND), Reason::Returned);
    let ending = |token: &Token, reason, now| {
        let ending = token.ending(reason, now).unwrap();
        (ending.reason, ending.giver, ending.turn)
    };
    assert_eq!(
        ending(&token, Reason::Released, 6 * SECOND),
        (Reason::Returned, Some(ALICE), 0)
    );
    assert_eq!(
        ending(&token, Reason::Broken, 6 * SECOND),
        (Reason::Broken, None, 0)
    );
    assert_eq!(
        ending(&token, Reason::Expired, 30 * SECOND),
        (Reason::Expired, None, 0)
    );
    token.count_command(7 * SECOND);
    assert_eq!(token.deadline(), Some(15 * SECOND), "one is left");
    token.count_command(7 * SECOND);
    assert_eq!(token.deadline(), Some(7 * SECOND));
    assert!(token.forget_giver(ALICE) && !token.forget_giver(ALICE));
    assert_eq!(
        ending(&token, Reason::Released, 6 * SECOND),
        (Reason::Released, None, 0)
    );
}

#[test]
fn a_change_is_overtaken_by_another_owner_or_a_shared_hold() {
    let mut token = owned_by(ALICE, 0);
    let agreed = Change {
        from: Some(ALICE),
        ..Change::to(BOB, Reason::Given)
    };
    assert_eq!(token.overtaken(&agreed), None);
    token.change_owner(Some(Grantee::plain(CAROL)), 0, FLOOR);
    assert_eq!(token.overtaken(&agreed), Some(Overtaken::Moved));
    token.change_owner(None, 0, FLOOR);
    token.holders.insert(CAROL, 0);
    let grab = Change::to(BOB, Reason::Released);
    assert_eq!(token.overtaken(&grab), Some(Overtaken::Shared));
    token.granting = Some(Granting {
        ticket: None,
        change: Some(grab),
    });
    assert!(token.call_off_for(CAROL).is_none());
    assert_eq!(token.call_off_for(BOB).map(|change| change.to), Some(BOB));
    assert!(token.call_off_for(BOB).is_none() && !token.is_free());
}

#[test]
fn the_queue_is_by_arrival_or_by_level_and_tells_each_place_once() {
    let mut token = owned_by(ALICE, 0);
    token.terms.by_level = true;
    token.enqueue(waiter(BOB, 1, 0)).unwrap();
    token.enqueue(waiter(CAROL, 5, 0)).unwrap();
    let error = token.enqueue(waiter(BOB, 9, 0)).unwrap_err();
    assert_eq!(error.get("place"), Some(&Value::Int(2)), "from 1");
    assert_eq!((error.code, token.place_of(BOB)), (Code::HELD, Some(1)));
    let told = |token: &mut Token| {
        let news = token.take_place_news(20 * SECOND);
        news.iter()
            .map(|news| (news.peer, news.place, news.expected))
            .collect::<Vec<_>>()
    };
    assert_eq!(
        told(&mut token),
        [(CAROL, 1, Some(40 * SECOND)), (BOB, 2, Some(100 * SECOND))]
    );
    assert_eq!(told(&mut token), []);
    assert!(token.next_waiter(0, |_| None, 0).is_none(), "alice has it");
    token.change_owner(None, 20 * SECOND, FLOOR);
    assert_eq!(
        token.next_waiter(0, |_| None, 0).map(|(_, waiter)| waiter.peer),
        Some(CAROL)
    );
    token.dequeue(CAROL.0).unwrap();
    assert_eq!(told(&mut token), [(BOB, 1, None)]);
}

#[test]
fn a_queue_is_full_at_its_bound() {
    let mut token = owned_by(ALICE, 0);
    for number in 0..MOST {
        token.enqueue(waiter(PeerId(100 + number as u64), 0, 0)).unwrap();
    }
    assert_eq!(token.enqueue(waiter(BOB, 9, 0)).unwrap_err().code, Code::FULL);
    token.dequeue(100).unwrap();
    token.enqueue(waiter(BOB, 9, 0)).unwrap();
}

#[test]
fn far_back_in_the_queue_only_some_steps_are_told() {
    let mut token = owned_by(ALICE, 0);
    for number in 0..30 {
        token.enqueue(waiter(PeerId(100 + number), 0, 0)).unwrap();
    }
    let places = |token: &mut Token| {
        let news = token.take_place_news(0).into_iter();
        news.map(|news| news.place).collect::<Vec<_>>()
    };
    assert_eq!(places(&mut token), (1..=30).collect::<Vec<_>>(), "everybody once");
    token.dequeue(100).unwrap();
    assert_eq!(places(&mut token), [1, 2, 3, 4, 5, 6, 7, 8, 16, 24]);
    assert_eq!(places(&mut token), [0; 0]);
}

#[test]
fn a_turn_ends_when_others_have_waited_long_enough() {
    let mut token = owned_by(ALICE, 5 * SECOND);
    token.terms.hold = Some(30 * SECOND);
    token.terms.notice = 10 * SECOND;
    assert_eq!(token.hold_end(), None, "nobody waits");
    let news_at = |token: &mut Token, now: u64| {
        let news = token.take_turn_news(now);
        news.map(|news| (news.owner, news.end, news.waiting))
    };
    let news = |token: &mut Token| news_at(token, 0);
    assert_eq!(news(&mut token), None);
    token.enqueue(waiter(BOB, 0, 7 * SECOND)).unwrap();
    assert_eq!(token.hold_end(), Some(35 * SECOND));
    assert_eq!(news(&mut token), Some((ALICE, 35 * SECOND, 1)));
    assert_eq!(news(&mut token), None, "it is told once");
    // Who comes when the turn is nearly over leaves the owner the notice.
    token.dequeue(BOB.0).unwrap();
    token.enqueue(waiter(CAROL, 0, 34 * SECOND)).unwrap();
    assert_eq!(news_at(&mut token, 34 * SECOND), Some((ALICE, 44 * SECOND, 1)));
    token.dequeue(CAROL.0).unwrap();
    assert_eq!(news(&mut token), None, "nobody waits any more");
    // Who waits and gives up again and again does not have the owner hear of nothing else.
    let mut told = 0;
    for round in 0..3000 {
        let now = 34 * SECOND + round * 1000;
        token.enqueue(waiter(BOB, 0, now)).unwrap();
        told += usize::from(news_at(&mut token, now).is_some());
        token.dequeue(BOB.0).unwrap();
    }
    assert_eq!(told, 2, "once a second");
    // That it ends when the owner believed it had ended already is told.
    token.enqueue(waiter(CAROL, 0, 60 * SECOND)).unwrap();
    assert_eq!(news_at(&mut token, 60 * SECOND), Some((ALICE, 70 * SECOND, 1)));
}

#[test]
fn what_is_given_and_returned_is_one_turn() {
    let token = given(owned_by(ALICE, 5 * SECOND), BOB, SECOND, 7 * SECOND);
    assert_eq!(token.owner.as_ref().unwrap().turn, 5 * SECOND);
    let back = |turn| Change {
        turn,
        until: Some(9 * SECOND),
        ..Change::to(ALICE, Reason::Returned)
    };
    let grantee = token.grantee(&back(Some(3 * SECOND)), 8 * SECOND);
    assert_eq!(
        (grantee.turn, grantee.until),
        (Some(3 * SECOND), Some(9 * SECOND))
    );
    for (turn, since) in [(Some(3 * SECOND), 3 * SECOND), (None, 8 * SECOND)] {
        let mut token = given(owned_by(ALICE, 5 * SECOND), BOB, SECOND, 7 * SECOND);
        let grantee = token.grantee(&back(turn), 8 * SECOND);
        token.change_owner(Some(grantee), 8 * SECOND, FLOOR);
        assert_eq!(token.owner.as_ref().unwrap().turn, since);
    }
}

#[test]
fn the_same_is_not_asked_again_and_again() {
    let mut token = owned_by(ALICE, 0);
    let asked = (Verb::Request, BOB, ALICE);
    for _ in 0..4 {
        token.check_again(asked, "alice", 0).unwrap();
        token.note_asked(asked, 0);
    }
    let error = token.check_again(asked, "alice", SECOND).unwrap_err();
    assert_eq!(error.code, Code::TRY_LATER);
    assert_eq!(error.retry_in().map(|wait| wait.as_secs()), Some(9));
    token
        .check_again((Verb::Request, CAROL, ALICE), "alice", SECOND)
        .unwrap();
    token.check_again(asked, "alice", 10 * SECOND).unwrap();
    token.forget_asked(asked);
    token.check_again(asked, "alice", SECOND).unwrap();
}

#[test]
fn a_record_covers_the_next_grants_of_its_owner_alone() {
    let path = Path::parse("/arm/token").unwrap();
    let mut token = token();
    let record = token
        .needed_record(&path, holder("alice"), None, Fence::from(7))
        .unwrap();
    assert_eq!((record.fence, record.lease), (8, Some(60 * SECOND)));
    token.record = Some(record);
    assert_eq!(
        token.needed_record(&path, holder("alice"), None, Fence::from(7)),
        None
    );
    let next = token.needed_record(&path, holder("bob"), Some(holder("alice")), Fence::from(7));
    assert_eq!(next.and_then(|record| record.before), Some(holder("alice")));
    token.doubt_record();
    assert!(
        token
            .needed_record(&path, holder("alice"), None, Fence::from(7))
            .is_some()
    );
    let freed = token.correct_record(None).expect("nobody has it");
    assert_eq!((freed.owner, freed.lease), (None, Some(0)));
    assert_eq!(token.correct_record(None), None, "stored once");
}

#[test]
fn a_restart_keeps_a_token_for_its_owner() {
    let record = Record {
        path: Path::parse("/arm/token").unwrap(),
        fence: 8,
        owner: Some(holder("alice")),
        before: None,
        lease: Some(90 * SECOND),
    };
    let last = record.last_fence();
    let mut token = token();
    token.restore(record, FLOOR);
    assert_eq!(
        u64::from(token.fence),
        last,
        "fences that were given out are not given again"
    );
    assert_eq!(token.kept_by_restart(Some(&holder("bob")), 0), Some(90 * SECOND));
    assert_eq!(token.kept_by_restart(Some(&holder("alice")), 0), None);
    assert_eq!(token.kept_by_restart(None, 90 * SECOND), None);
    token.enqueue(waiter(BOB, 0, 0)).unwrap();
    token.enqueue(waiter(ALICE, 0, 0)).unwrap();
    let holder = |peer| (peer == ALICE).then(|| holder("alice"));
    assert_eq!(
        token.next_waiter(0, holder, 0).map(|(_, waiter)| waiter.peer),
        Some(ALICE)
    );
}
