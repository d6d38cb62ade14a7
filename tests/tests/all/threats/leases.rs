//! Threats 20 and 21: the end of a lease against a renewal on its way, and an owner that slept over it.

use std::time::Duration;

use mom_client::{Client, Event, Events};
use mom_proto::codec::Form;
use mom_proto::{Map, Value};
use mom_tests::canary::fence_of;
use mom_tests::lab;
use mom_tests::raw::PATIENCE;
use tokio::time::timeout;

use super::World;
use super::arena::{self, ARM, Robot, TOKEN, about, command, grab};

const LEASE: Duration = Duration::from_secs(10);
const MILLI: Duration = Duration::from_millis(1);

fn eager() -> Map {
    Map::new()
        .with("expiry", "eager")
        .with("lease", i64::try_from(LEASE.as_millis()).expect("a lease"))
}

/// When the renewal comes, beside the deadline.
#[derive(Clone, Copy, Debug)]
enum When {
    /// It is answered a millisecond before.
    Before,
    /// It is sent a millisecond before, and the deadline comes while it is under way.
    Racing,
    /// It is sent when the deadline has come.
    At,
    /// It is sent a millisecond later.
    After,
}

/// Threat 20: a renewal at the end of an eager lease renews, or finds the token lost; the one that is told to the
/// owner is the one that happened, and never both.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_20_renewed_or_expired() {
    let clock = lab::clock();
    let world = World::start_at(clock.clone(), |_| {}).await;
    arena::make(world.address(), eager()).await;
    let mut robot = Robot::enter(world.address(), Form::Binary).await;
    let mut rounds = [0_u64; 2];
    for form in Form::ALL {
        let mut alice = arena::enter(world.address(), form, "alice").await;
        let name = alice.name().to_owned();
        for when in [When::Before, When::Racing, When::At, When::After].repeat(12) {
            let fence = grab(&mut alice).await;
            robot.expect(&format!("grabbed {name} {fence}")).await;
            clock.advance(LEASE - MILLI);
            let answer = match when {
                When::Before => {
                    let answer = alice.ask(about("renew")).await;
                    clock.advance(MILLI);
                    answer
                }
                When::Racing => {
                    let id = alice.post(about("renew")).await;
                    clock.advance(MILLI);
                    alice.answer(id).await
                }
                When::At | When::After => {
                    clock.advance(if matches!(when, When::At) {
                        MILLI
                    } else {
                        2 * MILLI
                    });
                    alice.ask(about("renew")).await
                }
            };
            let info = alice.ask(about("info")).await.expect("anybody may").value();
            let renewed = answer.is_ok();
            assert_eq!(info.get("owner").is_some(), renewed, "{when:?}: {info:?}");
            match (&answer, when) {
                (Ok(grant), When::Before | When::Racing) => {
                    assert_eq!(fence_of(&grant.value()), fence, "a renewal is not a new grant");
                    // It is a whole lease: to its last millisecond the token is held.
                    clock.advance(LEASE - 2 * MILLI);
                    alice.ask(about("release")).await.expect("she still owns it");
                    robot.expect("halt").await;
                    robot.expect(&format!("released {name} released {fence}")).await;
                }
                (Err(error), When::Racing | When::At | When::After) => {
                    assert_eq!(error.code.word(), "not-owner", "{error}");
                    robot.expect("halt").await;
                    robot.expect(&format!("released {name} expired {fence}")).await;
                }
                _ => panic!("{when:?}: {answer:?}"),
            }
            robot.expect_nothing().await;
            rounds[usize::from(renewed)] += 1;
        }
    }
    // Each grant was written down once, and its one end.
    let lines = world.end().await;
    let token = ("context", TOKEN);
    for (reason, rounds) in ["expired", "released"].into_iter().zip(rounds) {
        let lost = [("what", "lost"), token, ("reason", reason)];
        assert_eq!(lines.count(&lost), rounds, "{reason}");
    }
    assert_eq!(lines.count(&[("what", "granted"), token]), rounds[0] + rounds[1]);
}

/// Threat 21: an owner that slept for 30 s while its token went to another is refused when it wakes, as one whose
/// fence is old where it names it, and as one who owns nothing where it does not.
#[tokio::test]
async fn threat_21_a_frozen_owner_wakes() {
    for form in Form::ALL {
        let clock = lab::clock();
        let mut world = World::start_at(clock.clone(), |_| {}).await;
        arena::make(world.address(), eager()).await;
        let mut robot = Robot::enter(world.address(), form).await;
        let mut frozen = arena::driver(world.address(), form, "alice").await;
        let mut bob = arena::driver(world.address(), Form::Binary, "bob").await;
        let old = grab(&mut frozen).await;
        let name = frozen.name().to_owned();
        robot.expect(&format!("grabbed {name} {old}")).await;
        frozen.post(command("before", Some(old))).await;
        robot.expect(&format!("command before {old}")).await;

        // From here on it neither reads nor writes.
        clock.advance(Duration::from_secs(30));
        robot.expect("halt").await;
        robot.expect(&format!("released {name} expired {old}")).await;
        let new = grab(&mut bob).await;
        assert!(new > old);
        robot.expect(&format!("grabbed bob {new}")).await;
        bob.post(command("mine", None)).await;
        robot.expect(&format!("command mine {new}")).await;
        world.canary.check().await;

        // It wakes, and goes on as if nothing had happened.
        let ids = [
            (frozen.post(command("late", Some(old))).await, "older-fence"),
            (frozen.post(command("late", None)).await, "not-owner"),
            (frozen.post(about("renew")).await, "not-owner"),
            (frozen.post(about("release")).await, "not-owner"),
            (frozen.post(command("borrowed", Some(new))).await, "not-owner"),
        ];
        for (id, code) in ids {
            let error = frozen.answer(id).await.expect_err(code);
            assert_eq!(error.code.word(), code, "{error}");
            assert_eq!(error.get("owner"), Some(&Value::from("bob")), "{error}");
        }
        robot.expect_nothing().await;
        bob.post(command("still mine", Some(new))).await;
        robot.expect(&format!("command still mine {new}")).await;
        let lines = world.end().await;
        let refused = |code| lines.count(&[("what", "refused"), ("peer", &*name), ("code", code)]);
        assert_eq!((refused("older-fence"), refused("not-owner")), (1, 4));
    }
}

/// Threat 21: what an old owner sent in time and the robot reads too late is refused by the robot itself. Here the
/// robot's program is what sleeps, with the commands in its hands already.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_21_the_robot_refuses_what_was_under_way() {
    let clock = lab::clock();
    let world = World::start_at(clock.clone(), |_| {}).await;
    arena::make(world.address(), eager()).await;
    let robot = Client::builder(format!("bin://{}", world.address()))
        .user("camera")
        .password("camera")
        .connect();
    let robot = robot.await.expect("a user of the lab");
    let arm = robot.channel(ARM).await.expect("open to all");
    let (mut events, gate) = (arm.events(), arm.gate());
    // What it has read already, so that the test need not guess.
    let mut read = arm.events();

    let mut alice = arena::driver(world.address(), Form::Xml, "alice").await;
    let old = grab(&mut alice).await;
    for text in ["one", "two", "three"] {
        alice.post(command(text, Some(old))).await;
    }
    wait_for(&mut read, "three").await;
    clock.advance(LEASE);
    let mut bob = arena::driver(world.address(), Form::Binary, "bob").await;
    let new = grab(&mut bob).await;
    bob.post(command("mine", None)).await;
    wait_for(&mut read, "mine").await;

    let (mut obeyed, mut stale, mut halts) = (Vec::new(), Vec::new(), 0);
    while obeyed.is_empty() {
        let event = timeout(PATIENCE, events.next())
            .await
            .expect("it is there already");
        let Event::Message(parcel) = event.expect("the client lives") else {
            continue;
        };
        match (parcel.name(), gate.check(&parcel)) {
            ("halt", check) => {
                check.expect("a safe state needs no token");
                halts += 1;
            }
            (_, Ok(())) => obeyed.push((parcel.value(), parcel.fence)),
            (_, Err(why)) => stale.push((why.given, why.fence)),
        }
    }
    assert_eq!(obeyed, [(Value::from("mine"), Some(new))]);
    assert_eq!(stale, [(Some(old), new); 3]);
    assert_eq!(halts, 1);
    world.end().await;
}

/// Waits until a command has been read.
async fn wait_for(events: &mut Events, text: &str) {
    let found = async {
        while let Some(event) = events.next().await {
            if matches!(&event, Event::Message(parcel) if parcel.value() == Value::from(text)) {
                return true;
            }
        }
        false
    };
    assert!(
        timeout(PATIENCE, found).await.expect("it is under way"),
        "the client lives"
    );
}
