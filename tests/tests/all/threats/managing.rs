//! Threat 23: a managing peer that dies, hangs, answers twice or too late. Nobody gets in by that, and nobody is
//! answered twice.

use std::time::Duration;

use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel, Value, WireError};
use mom_tests::lab;
use mom_tests::raw::{Raw, at};

use super::World;
use super::arena::create;

const BOOTH: &str = "/booth";
const WITHIN: Duration = Duration::from_secs(5);

/// A room that its maker manages, and the maker.
async fn desk(world: &World, form: Form) -> Raw {
    let mut desk = Raw::login(world.address(), form, "carol").await;
    let within = i64::try_from(WITHIN.as_millis()).expect("a time");
    let manager = Map::new().with("kind", "self").with("within", within);
    let spec = Map::new().with("kind", "session").with("manager", manager);
    create(&mut desk, BOOTH, spec).await;
    desk.join(&[BOOTH]).await;
    desk
}

fn join() -> Parcel {
    Parcel::new(Family::Context, "join").context(at(BOOTH))
}

/// The number of the next question.
async fn question(desk: &mut Raw) -> u64 {
    let consult = desk.next_of(Family::Manager, "consult").await;
    assert_eq!(consult.value().get("verb"), Some(&Value::from("join")));
    consult.id.expect("a question has a number")
}

fn verdict(question: u64, allow: bool) -> Parcel {
    let question = i64::try_from(question).expect("a number of the wire");
    Parcel::new(Family::Manager, "verdict").content(Map::new().with("consult", question).with("allow", allow))
}

fn code(answer: Result<Parcel, WireError>) -> String {
    match answer {
        Ok(reply) => reply.name().to_owned(),
        Err(error) => error.code.word().to_owned(),
    }
}

/// Whether a peer is in the room, as its manager sees it.
async fn is_in(desk: &mut Raw, peer: &str) -> bool {
    let members = desk.ask_about(Family::Context, "members", BOOTH).await;
    let members = members.expect("its own room");
    let list = members.get("members").and_then(Value::as_list).expect("a list");
    list.iter()
        .any(|member| member.get("peer") == Some(&Value::from(peer)))
}

/// Checks that nothing more comes as an answer: a ping is answered, and only that.
async fn expect_no_answer(peer: &mut Raw) {
    let id = peer.post(Parcel::new(Family::Time, "ping")).await;
    loop {
        let parcel = peer.next().await.expect("connected");
        if parcel.reference == Some(id) {
            return;
        }
        assert!(parcel.reference.is_none(), "a second answer: {parcel:?}");
    }
}

#[tokio::test]
async fn threat_23_hangs_and_answers_late() {
    for form in Form::ALL {
        let clock = lab::clock();
        let mut world = World::start_at(clock.clone(), |_| {}).await;
        let mut desk = desk(&world, form).await;
        let name = desk.name().to_owned();
        let mut bob = Raw::login(world.address(), form, "bob").await;
        let id = bob.post(join()).await;
        let number = question(&mut desk).await;
        clock.advance(WITHIN - Duration::from_millis(1));
        expect_no_answer(&mut bob).await;
        world.canary.check().await;
        clock.advance(Duration::from_millis(1));
        assert_eq!(code(bob.answer(id).await), "timed-out");
        // Its yes has no effect any more, however often.
        for _ in 0..2 {
            assert_eq!(code(desk.ask(verdict(number, true)).await), "too-late");
        }
        assert!(!is_in(&mut desk, "bob").await);
        expect_no_answer(&mut bob).await;
        world.check_nothing_arrived("a late verdict").await;
        let lines = world.end().await;
        let refused = |peer, code| lines.count(&[("what", "refused"), ("peer", peer), ("code", code)]);
        assert_eq!((refused("bob", "timed-out"), refused(&name, "too-late")), (1, 2));
    }
}

#[tokio::test]
async fn threat_23_answers_twice() {
    for form in Form::ALL {
        let mut world = World::start_at(lab::clock(), |_| {}).await;
        let mut desk = desk(&world, form).await;
        let mut bob = Raw::login(world.address(), form, "bob").await;
        for (first, second, becomes) in [(false, true, "declined"), (true, false, "ok")] {
            let id = bob.post(join()).await;
            let number = question(&mut desk).await;
            // Both on the wire before the hub has seen either.
            let once = desk.post(verdict(number, first)).await;
            let twice = desk.post(verdict(number, second)).await;
            assert_eq!(code(desk.answer(once).await), "ok");
            assert_eq!(code(desk.answer(twice).await), "too-late");
            assert_eq!(code(bob.answer(id).await), becomes);
            expect_no_answer(&mut bob).await;
            assert_eq!(is_in(&mut desk, "bob").await, first);
        }
        world.check_nothing_arrived("two verdicts").await;
        world.end().await;
    }
}

/// A verdict against its deadline: the one that is told to both is the one that happened.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_23_at_the_deadline() {
    let clock = lab::clock();
    let mut world = World::start_at(clock.clone(), |_| {}).await;
    let mut desk = desk(&world, Form::Binary).await;
    let mut bob = Raw::login(world.address(), Form::Xml, "bob").await;
    for _ in 0..50 {
        let id = bob.post(join()).await;
        let number = question(&mut desk).await;
        clock.advance(WITHIN - Duration::from_millis(1));
        let said = desk.post(verdict(number, true)).await;
        clock.advance(Duration::from_millis(1));
        let outcome = (code(desk.answer(said).await), code(bob.answer(id).await));
        let is_in = is_in(&mut desk, "bob").await;
        match (&*outcome.0, &*outcome.1, is_in) {
            ("ok", "ok", true) => {
                let left = bob.ask_about(Family::Context, "leave", BOOTH).await;
                left.expect("who is in may leave");
            }
            ("too-late", "timed-out", false) => {}
            _ => panic!("{outcome:?}, in the room: {is_in}"),
        }
        world.canary.check().await;
    }
    world.end().await;
}

#[tokio::test]
async fn threat_23_dies() {
    for form in Form::ALL {
        for reset in [false, true] {
            let mut world = World::start_at(lab::clock(), |_| {}).await;
            let mut desk = desk(&world, form).await;
            let mut bob = Raw::login(world.address(), form, "bob").await;
            let id = bob.post(join()).await;
            question(&mut desk).await;
            match reset {
                true => desk.reset(),
                false => drop(desk),
            }
            // At once, though the clock stands still: there is nobody left who could answer.
            assert_eq!(code(bob.answer(id).await), "timed-out");
            assert_eq!(code(bob.ask(join()).await), "timed-out");
            // Who takes its name does not take its place.
            let mut heir = Raw::login(world.address(), form, "carol").await;
            assert_eq!(code(heir.ask(join()).await), "timed-out");
            world.check_nothing_arrived("a dead manager").await;
            world.end().await;
        }
    }
}
