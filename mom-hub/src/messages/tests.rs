//! Admission by a route that is written down: who may say what, and in which words the others are refused.

use std::sync::Arc;
use std::time::Duration;

use mom_managers::{Answer, Denial, Grant, PeerFacts};
use mom_proto::{
    ClockOffset, Code, ContextNumber, Delivery, Family, Micros, Overflow, Parcel, Path, Time, Value,
    WireError, event,
};

use super::admit::{Admission, Alike, Ingress, Receivers, admit, admit_with, refusal};
use super::route::{Guard, GuardOwner, Route};
use crate::tree::member::has_own_right;
use crate::{Member, PeerClock, PeerId, StandingVerdict};

const ALICE: PeerId = PeerId(1);
const BOB: PeerId = PeerId(2);
const STRANGER: PeerId = PeerId(9);
const FENCE: u64 = 7;

fn facts(name: &str, level: i32) -> Arc<PeerFacts> {
    Arc::new(PeerFacts {
        name: name.into(),
        user: name.into(),
        level,
        groups: [].into(),
    })
}

fn allowed() -> Answer {
    Answer::Allow(Grant::default())
}

fn standing(name: Option<&str>) -> StandingVerdict {
    StandingVerdict {
        by_hub: name.is_some_and(has_own_right),
        name: name.map(Into::into),
        until: None,
        rate: None,
        max_age: None,
        answer: allowed(),
    }
}

fn path(text: &str) -> Path {
    Path::parse(text).expect("a path")
}

/// `/lab/arm`, whose commands need `/lab/key`, which alice holds until 5 s. Both may say everything.
fn route() -> Route {
    let member = |peer, name, level| {
        let member = Member::new(peer, facts(name, level));
        let member = member.with(standing(None)).expect("room for one");
        let member = member
            .with(standing(Some(event::STOP)))
            .expect("room for another");
        Arc::new(member)
    };
    Route {
        number: ContextNumber(3),
        path: path("/lab/arm"),
        members: vec![member(ALICE, "alice", 2), member(BOB, "bob", 1)],
        guard: Some(Guard {
            token: path("/lab/key"),
            names: vec!["command".to_owned(), "jog".to_owned()].into(),
            owner: Some(GuardOwner {
                peer: ALICE,
                name: "alice".into(),
                level: 2,
                lease_end: Some(5_000_000),
                lost_at: None,
                commands: None,
                halts: 0,
            }),
            fence: FENCE,
        }),
        delivery: Delivery::Reliable,
        overflow: Overflow::default(),
        pace: None,
        keep: None,
        awaited: false,
        lifted: None,
    }
}

fn ingress(now: Micros) -> Ingress {
    Ingress {
        now,
        wall: Time::default(),
        clock: None,
        waited: 0,
    }
}

fn message(name: &str) -> Parcel {
    Parcel::new(Family::Message, name)
}

fn pass(route: &Route, peer: PeerId, parcel: &mut Parcel) -> Result<Receivers, WireError> {
    match admit(route, peer, parcel, &ingress(1_000_000))? {
        Admission::Pass(receivers, rate) => {
            assert_eq!(rate, None);
            Ok(receivers)
        }
        Admission::Consult => panic!("{} needs no hub", parcel.name),
    }
}

fn refused(route: &Route, peer: PeerId, mut parcel: Parcel) -> WireError {
    pass(route, peer, &mut parcel).expect_err("it is refused")
}

fn change(owner: impl FnOnce(&mut GuardOwner)) -> Route {
    let mut route = route();
    let guard = route.guard.as_mut().expect("a guard");
    owner(guard.owner.as_mut().expect("an owner"));
    route
}

#[test]
fn a_guard_covers_the_names_that_it_lists_and_no_other() {
    let mut route = route();
    for (name, fence) in [("command", Some(FENCE)), ("jog", Some(FENCE)), ("say", None)] {
        let mut parcel = message(name);
        assert_eq!(pass(&route, ALICE, &mut parcel), Ok(Receivers::All));
        assert_eq!(parcel.fence, fence, "{name}");
    }
    assert_eq!(pass(&route, BOB, &mut message("say")), Ok(Receivers::All));
    assert_eq!(refused(&route, BOB, message("jog")).code, Code::NOT_OWNER);

    let guard = route.guard.as_mut().expect("a guard");
    guard.names = vec!["*".to_owned()].into();
    assert_eq!(refused(&route, BOB, message("say")).code, Code::NOT_OWNER);
    let mut stop = message("stop");
    let passed = admit_with(&route, BOB, &allowed(), &mut stop, &ingress(0));
    assert_eq!((passed, stop.fence), (Ok(Receivers::All), None));
}

#[test]
fn stops_have_one_order_which_the_hub_knows() {
    let mut route = route();
    for name in ["stop", "unstop"] {
        let asked = |route: &Route| admit(route, BOB, &mut message(name), &ingress(0));
        assert_eq!(asked(&route), Ok(Admission::Consult), "{name}");
        let kept = route.members[1].with(standing(Some(name)));
        route.members[1] = Arc::new(kept.expect("room for one"));
        assert_eq!(
            asked(&route),
            Ok(Admission::Consult),
            "{name}, though its manager has answered"
        );
    }
}

#[test]
fn what_a_device_says_goes_to_the_hub_while_it_is_awaited() {
    let mut route = route();
    route.awaited = true;
    let state = |route: &Route| admit(route, BOB, &mut message("state"), &ingress(0));
    assert_eq!(
        state(&route),
        Ok(Admission::Pass(Receivers::All, None)),
        "it is not a device"
    );
    let device = route.members[1].on_terms(mom_proto::Thinning::default(), true);
    route.members[1] = Arc::new(device);
    assert_eq!(state(&route), Ok(Admission::Consult));
    route.awaited = false;
    assert_eq!(state(&route), Ok(Admission::Pass(Receivers::All, None)));
}

#[test]
fn who_is_refused_hears_who_owns_and_for_how_long() {
    let error = refused(&route(), BOB, message("command"));
    assert_eq!(
        error.text,
        "command on /lab/arm needs /lab/key, which alice (level 2) holds"
    );
    for (slot, value) in [
        ("rule", Value::from("guard of /lab/arm")),
        ("level", 1.into()),
        ("owner", "alice".into()),
        ("owner-level", 2.into()),
        ("retry-after", 4000.into()),
    ] {
        assert_eq!(error.get(slot), Some(&value), "{slot}");
    }
    let endless = change(|owner| owner.lease_end = None);
    assert_eq!(
        refused(&endless, BOB, message("command")).get("retry-after"),
        None
    );

    let mut free = route();
    free.guard.as_mut().expect("a guard").owner = None;
    let error = refused(&free, ALICE, message("command"));
    assert_eq!(
        error.text,
        "command on /lab/arm needs /lab/key, which nobody holds: grab it first"
    );
    assert_eq!(error.get("owner"), None);
}

#[test]
fn a_fence_is_that_of_the_grant_or_refused() {
    let fenced = |fence| {
        let mut parcel = message("command");
        parcel.fence = Some(fence);
        parcel
    };
    let route = route();
    assert_eq!(pass(&route, ALICE, &mut fenced(FENCE)), Ok(Receivers::All));
    for (peer, fence, code, owner) in [
        (ALICE, FENCE + 1, Code::BAD_FENCE, None),
        (BOB, FENCE + 1, Code::BAD_FENCE, None),
        (ALICE, FENCE - 1, Code::OLDER_FENCE, None),
        (BOB, FENCE - 1, Code::OLDER_FENCE, Some("alice")),
        (BOB, FENCE, Code::NOT_OWNER, Some("alice")),
    ] {
        let error = refused(&route, peer, fenced(fence));
        assert_eq!(error.code, code, "{peer:?} {fence}");
        assert_eq!(
            error.get("owner").and_then(Value::as_str),
            owner,
            "{peer:?} {fence}"
        );
        if code != Code::NOT_OWNER {
            assert_eq!(error.get("slot").and_then(Value::as_str), Some("fence"));
            assert_eq!(error.get("fence"), Some(&Value::Int(7)));
        }
    }
    // Messages that the guard does not cover carry none, whatever their sender has written.
    let mut said = message("say");
    said.fence = Some(FENCE + 1);
    assert_eq!(pass(&route, BOB, &mut said), Ok(Receivers::All));
    assert_eq!(said.fence, None);
}

#[test]
fn commands_that_are_counted_are_for_the_hub() {
    let counted = change(|owner| owner.commands = Some(2));
    let at = |peer, name| {
        admit(&counted, peer, &mut message(name), &ingress(0))
            .map(|admission| admission == Admission::Consult)
    };
    assert_eq!(at(ALICE, "command"), Ok(true));
    assert_eq!(at(ALICE, "say"), Ok(false));
    assert_eq!(at(BOB, "say"), Ok(false));
    assert_eq!(
        at(BOB, "command").map_err(|error| error.code),
        Err(Code::NOT_OWNER)
    );

    let used = change(|owner| owner.commands = Some(0));
    let mut parcel = message("command");
    let error = admit_with(&used, ALICE, &allowed(), &mut parcel, &ingress(0)).expect_err("used up");
    assert_eq!(error.code, Code::NOT_OWNER);
    assert_eq!(
        error.text,
        "the commands granted with /lab/key are used up; it is returned"
    );
    assert_eq!(
        admit_with(&counted, ALICE, &allowed(), &mut parcel, &ingress(0)),
        Ok(Receivers::All)
    );
}

#[test]
fn a_deadline_that_has_come_is_for_the_hub() {
    let ends = change(|owner| owner.lost_at = Some(1_000_000));
    let at = |now| admit(&ends, ALICE, &mut message("command"), &ingress(now));
    assert_eq!(at(999_999), Ok(Admission::Pass(Receivers::All, None)));
    assert_eq!(at(1_000_000), Ok(Admission::Consult));
    assert_eq!(at(1_000_001), Ok(Admission::Consult));
}

#[test]
fn a_verdict_stands_until_its_time_and_for_its_age() {
    let mut route = route();
    let member = Member::new(BOB, facts("bob", 1));
    let verdict = StandingVerdict {
        until: Some(1_000),
        max_age: Some(500),
        ..standing(Some("say"))
    };
    route.members[1] = Arc::new(member.with(verdict).expect("room for one"));
    let clock = PeerClock {
        offset: ClockOffset {
            micros: 0,
            error: 100,
        },
        future: 0,
    };
    let at = |now, old: i64, clock| {
        let mut parcel = message("say");
        parcel.timestamp = Time::from_micros(10_000 - old);
        let ingress = Ingress {
            wall: Time::from_micros(10_000).expect("a time"),
            clock,
            ..ingress(now)
        };
        admit(&route, BOB, &mut parcel, &ingress).map(|admission| admission != Admission::Consult)
    };
    assert_eq!(at(999, 400, Some(clock)), Ok(true));
    assert_eq!(
        at(999, 401, Some(clock)),
        Ok(false),
        "it may be older than it looks"
    );
    assert_eq!(at(999, 0, None), Ok(false), "its age is not known");
    assert_eq!(at(1_000, 0, Some(clock)), Ok(false), "the verdict is over");

    // A run knows the same by the stamps alone.
    let alike = |clock| {
        let ingress = Ingress {
            wall: Time::from_micros(10_000).expect("a time"),
            clock,
            ..ingress(999)
        };
        Alike::new(&route, BOB, "say", &ingress)
    };
    let stamp = |old: i64| Time::from_micros(10_000 - old);
    assert_eq!(alike(Some(clock)).age(stamp(400)), Some(400));
    assert_eq!(alike(Some(clock)).age(stamp(401)), None);
    assert_eq!(alike(Some(clock)).age(stamp(-100)), Some(-100));
    assert_eq!(alike(Some(clock)).age(stamp(-101)), None, "it is of the future");
    assert_eq!(alike(None).age(stamp(0)), None);
    assert_eq!(alike(Some(clock)).age(None), None);
    let free = Alike::new(&route, ALICE, "say", &ingress(999));
    assert_eq!((free.age(None), free.age(stamp(0))), (Some(0), Some(0)));
}

#[test]
fn who_is_not_there_or_says_the_hubs_word_is_refused() {
    // The hub decides what a stranger hears.
    let asked = admit(&route(), STRANGER, &mut message("say"), &ingress(0));
    assert_eq!(asked, Ok(Admission::Consult));
    let answer = Answer::Allow(Grant::default());
    let error = admit_with(&route(), STRANGER, &answer, &mut message("say"), &ingress(0));
    let error = error.expect_err("no member");
    assert_eq!(error.code, Code::NOT_MEMBER);
    assert_eq!(error.text, "join /lab/arm before sending to it");
    assert_eq!(error.get("slot").and_then(Value::as_str), Some("context"));
    let error = refused(&route(), ALICE, message(event::HALT));
    assert_eq!(
        (&error.code, error.get("slot").and_then(Value::as_str)),
        (&Code::DENIED, Some("name"))
    );
}

#[test]
fn a_message_is_stamped_by_the_hub() {
    let wall = Time::from_micros(10_000).expect("a time");
    let mut parcel = message("command");
    parcel.sender = Some("mallory".into());
    parcel.age = Some(77);
    parcel.age_error = Some(78);
    let arrived = Ingress {
        wall,
        waited: 42,
        ..ingress(0)
    };
    admit(&route(), ALICE, &mut parcel, &arrived).expect("alice may");
    assert_eq!(parcel.sender.as_deref(), Some("alice"));
    assert_eq!(parcel.context, Some(path("/lab/arm")));
    assert_eq!(parcel.number, Some(ContextNumber(3)));
    assert_eq!(parcel.received, Some(wall));
    assert_eq!(
        (parcel.age, parcel.age_error),
        (Some(42), None),
        "as long as it has waited"
    );

    let clock = PeerClock {
        offset: ClockOffset { micros: 0, error: 9 },
        future: 0,
    };
    parcel.timestamp = Time::from_micros(9_000);
    admit(
        &route(),
        ALICE,
        &mut parcel,
        &Ingress {
            clock: Some(clock),
            ..arrived
        },
    )
    .expect("alice may");
    assert_eq!((parcel.age, parcel.age_error), (Some(1_000), Some(9)));

    for (priority, becomes) in [(101, 100), (100, 100), (-100, -100), (i32::MIN, -100), (5, 5)] {
        parcel.priority = Some(priority);
        pass(&route(), ALICE, &mut parcel).expect("alice may");
        assert_eq!(parcel.priority, Some(becomes));
    }
    let answer = Answer::Allow(Grant {
        priority: Some(0),
        ..Grant::default()
    });
    for (name, priority, becomes) in [
        ("say", Some(100), Some(0)),
        ("say", Some(-7), Some(-7)),
        ("say", None, None),
        ("command", Some(100), Some(100)),
    ] {
        (parcel.name, parcel.priority) = (name.into(), priority);
        admit_with(&route(), ALICE, &answer, &mut parcel, &arrived).expect("alice may");
        assert_eq!(parcel.priority, becomes);
    }
}

#[test]
fn what_has_waited_too_long_is_over() {
    let at = |waited, expires| {
        let mut parcel = message("say");
        parcel.expires = Some(expires);
        let arrived = Ingress { waited, ..ingress(0) };
        admit(&route(), BOB, &mut parcel, &arrived).map_err(|error| error.code)
    };
    assert_eq!(at(999, 1), Ok(Admission::Pass(Receivers::All, None)));
    assert_eq!(at(1_000, 1), Err(Code::EXPIRED));
    // What has not waited is worth something when it comes, however short.
    assert_eq!(at(0, 0), Ok(Admission::Pass(Receivers::All, None)));
}

#[test]
fn what_a_token_guards_and_expires_needs_a_known_age() {
    let clock = PeerClock {
        offset: ClockOffset { micros: 0, error: 0 },
        future: 1_000,
    };
    let at = |name, expires, stamped, clock| {
        let mut parcel = message(name);
        parcel.expires = expires;
        parcel.timestamp = Time::from_micros(10_000).filter(|_| stamped);
        let ingress = Ingress {
            wall: Time::from_micros(10_000).expect("a time"),
            clock,
            ..ingress(0)
        };
        admit(&route(), ALICE, &mut parcel, &ingress)
            .map(drop)
            .map_err(|error| error.code)
    };
    for (name, expires, stamped, clock, said) in [
        ("command", Some(500), true, Some(clock), Ok(())),
        ("command", Some(500), true, None, Err(Code::TRY_LATER)),
        ("command", Some(500), false, Some(clock), Err(Code::BAD_SLOT)),
        ("command", Some(500), false, None, Err(Code::BAD_SLOT)),
        // Without an end its age is its device's matter.
        ("command", None, true, None, Ok(())),
        // Nothing moves by it.
        ("say", Some(500), true, None, Ok(())),
    ] {
        assert_eq!(
            at(name, expires, stamped, clock),
            said,
            "{name} {expires:?} {stamped}"
        );
    }
}

#[test]
fn a_message_goes_to_whom_it_is_addressed() {
    let route = route();
    let to = |address: Option<&[&str]>, echo| {
        let mut parcel = message("say");
        parcel.address = address.map(|names| names.iter().map(|name| (*name).into()).collect());
        parcel.echo = echo;
        pass(&route, BOB, &mut parcel)
    };
    assert_eq!(to(None, None), Ok(Receivers::All));
    assert_eq!(to(None, Some(true)), Ok(Receivers::All));
    assert_eq!(to(None, Some(false)), Ok(Receivers::AllBut(1)));
    assert_eq!(
        to(Some(&["bob", "alice", "bob"]), Some(false)),
        Ok(Receivers::These(vec![1, 0]))
    );
    assert_eq!(to(Some(&[]), None), Ok(Receivers::These(vec![])));
    // Others may have been told already of a peer that has just joined: the hub knows that, and is asked of few names.
    let mut early = message("say");
    early.address = Some(vec!["alice".into(), "carol".into()]);
    let before = early.clone();
    let asked = admit(&route, BOB, &mut early, &ingress(1_000_000));
    assert_eq!(asked, Ok(Admission::Consult));
    assert_eq!(early, before, "the hub gets it as it came");
    let error = to(Some(&["alice", "alcie", "a", "b", "c"]), None).expect_err("nobody of that name");
    assert_eq!(error.code, Code::UNKNOWN_PEER);
    assert_eq!(error.get("nearest").and_then(Value::as_str), Some("alice"));
    assert_eq!(error.get("slot").and_then(Value::as_str), Some("address"));
}

#[test]
fn a_denial_says_when_to_ask_again() {
    let denial = |earliest| Denial {
        code: Code::DENIED,
        text: "no".to_owned(),
        rule: "a rule".to_owned(),
        earliest,
    };
    let retry = |earliest, now| {
        refusal(&denial(earliest), &facts("bob", 1), now)
            .get("retry-after")
            .cloned()
    };
    assert_eq!(retry(Some(2_000), 1_000), Some(Value::Int(1)));
    assert_eq!(retry(Some(1_000), 1_000), None, "now");
    assert_eq!(retry(Some(999), 1_000), None);
    assert_eq!(retry(None, 0), None);
    let error = refusal(&denial(None), &facts("bob", 1), 0);
    let said = WireError::new(Code::DENIED, "no").rule("a rule").level(1);
    assert_eq!(error, said);
    assert_eq!(
        refusal(&denial(Some(3_000)), &facts("bob", 1), 1_000),
        said.retry_after(Duration::from_millis(2))
    );
}

#[test]
fn what_moves_a_device_does_not_follow_a_lift_that_it_was_said_before() {
    let mut route = route();
    route.lifted = Time::from_micros(9_000);
    let clock = PeerClock {
        offset: ClockOffset {
            micros: 0,
            error: 100,
        },
        future: 0,
    };
    let ingress = |clock| Ingress {
        wall: Time::from_micros(10_000).expect("a time"),
        clock,
        ..ingress(1_000_000)
    };
    let late = |name: &str, old: i64, clock| {
        let mut parcel = message(name);
        parcel.fence = Some(FENCE);
        parcel.timestamp = Time::from_micros(10_000 - old);
        let allow = allowed();
        let admitted = admit_with(&route, ALICE, &allow, &mut parcel, &ingress(clock));
        admitted.err().map(|error| error.code)
    };
    for name in ["command", "jog"] {
        assert_eq!(
            late(name, 1_100, Some(clock)),
            None,
            "it may have been said after"
        );
        assert_eq!(late(name, 1_101, Some(clock)), Some(Code::TOO_LATE));
        assert_eq!(late(name, 1_101, None), None, "its age is not known");
    }
    assert_eq!(late("say", 5_000, Some(clock)), None, "it moves nothing");
    let alike = |name| Alike::new(&route, ALICE, name, &ingress(Some(clock)));
    assert_eq!(alike("jog").age(Time::from_micros(8_900)), Some(1_100));
    assert_eq!(alike("jog").age(Time::from_micros(8_899)), None);
    assert_eq!(alike("say").age(Time::from_micros(1_000)), Some(9_000));
}
