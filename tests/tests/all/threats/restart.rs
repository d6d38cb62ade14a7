//! Threat 30: the broker is killed, or ended in order, while a peer drives, and starts again on the same store.
//! Fences rise, and nobody has a token while its owner of before could still believe that it has it.

use std::time::{Duration, Instant};

use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel, Value, WireError};
use mom_tests::canary::fence_of;
use mom_tests::raw::Raw;
use mom_tests::service::Home;

use super::arena::{self, Robot, about, command, grab};

const COMMANDS: usize = 200;

const LEASE: Duration = Duration::from_secs(3);

/// The arena by file, with a lease that a test can wait for, and a token without one.
const ARENA: &str = r#"
[store]
path = "state"

[[contexts]]
path = "/arena"
kind = "session"
manager = "open"

[[contexts]]
path = "/arena/token"
kind = "token"
manager = { kind = "level-or-lease", lease = 3000 }

[[contexts]]
path = "/arena/arm"
kind = "channel"
guard = { token = "/arena/token", names = ["command"] }

[[contexts]]
path = "/arena/other"
kind = "token"
manager = { kind = "first-come" }
"#;

/// A grab that waits for its turn.
async fn wait(peer: &mut Raw) -> u64 {
    let grab = about("grab").content(Map::new().with("wait", "unlimited"));
    let id = peer.post(grab).await;
    peer.next_of(Family::Event, "queued").await;
    id
}

/// Checks that a restart is in the way, and for no longer than this.
fn check_kept(answer: Result<Parcel, WireError>, most: Duration) {
    let error = answer.expect_err("kept for who had it");
    assert_eq!(error.code.word(), "held", "{error}");
    assert_eq!(error.get("rule"), Some(&Value::from("restart")), "{error}");
    let left = error.retry_in().expect("when it is over");
    assert!(left <= most, "{error}");
}

/// kill -9 while a peer drives: the next one has the token no sooner than the lease of before could have ended.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_30_killed_and_started_again() {
    let home = Home::new(ARENA);
    let service = home.start().await;
    let mut alice = arena::driver(service.address(), Form::Xml, "alice").await;
    let before = grab(&mut alice).await;
    service.kill().await;
    assert!(alice.next().await.is_none(), "the link is gone with it");

    let begun = Instant::now();
    let service = home.start().await;
    let mut robot = Robot::enter(service.address(), Form::Binary).await;
    let mut bob = arena::driver(service.address(), Form::Binary, "bob").await;
    let mut carol = arena::driver(service.address(), Form::Xml, "carol").await;
    // No level helps: it is not about who may, but about who may still be driving.
    check_kept(carol.ask(about("grab")).await, LEASE);
    let info = carol.ask(about("info")).await.expect("anybody may").value();
    let kept = info.get("reserved").expect("it says for whom");
    assert_eq!(kept.get("peer"), Some(&Value::from("alice")), "{info:?}");
    carol.ask(command("mine", None)).await.expect_err("nobody drives");
    let waiting = wait(&mut bob).await;
    let granted = bob.answer(waiting).await.expect("it is his turn");
    let waited = begun.elapsed();
    assert!(waited >= LEASE, "{waited:?}");
    let after = fence_of(&granted.value());
    assert!(after > before, "{after} after {before}");
    robot.expect(&format!("grabbed bob {after}")).await;
    bob.post(command("go", None)).await;
    robot.expect(&format!("command go {after}")).await;
    assert_eq!(service.terminate().await.code(), Some(0));
}

/// Its owner has it again at once, as the same user under the same name, past all who wait.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_30_the_owner_comes_back() {
    let home = Home::new(ARENA);
    let service = home.start().await;
    let mut alice = arena::driver(service.address(), Form::Binary, "alice").await;
    let before = grab(&mut alice).await;
    service.kill().await;

    let service = home.start().await;
    let address = service.address();
    // Another name of the same user is another device of hers.
    let mut other = arena::nicknamed(address, "alice", "ally").await;
    check_kept(other.ask(about("grab")).await, LEASE);
    let mut bob = arena::enter(address, Form::Xml, "bob").await;
    let waiting = wait(&mut bob).await;
    let mut robot = Robot::enter(address, Form::Binary).await;
    let mut alice = arena::driver(address, Form::Binary, "alice").await;
    let after = grab(&mut alice).await;
    assert!(after > before);
    robot.expect(&format!("grabbed alice {after}")).await;
    // What she sent before the crash and sends again is told from what she sends now.
    let stale = alice.ask(command("again", Some(before))).await;
    assert_eq!(stale.expect_err("an old fence").code.word(), "older-fence");
    alice.post(command("go", Some(after))).await;
    robot.expect(&format!("command go {after}")).await;
    alice.ask(about("release")).await.expect("the owner may");
    let granted = bob.answer(waiting).await.expect("it is his turn");
    assert!(fence_of(&granted.value()) > after);
    assert_eq!(service.terminate().await.code(), Some(0));
}

/// Ended in order, nobody owns anything any more: the links were closed before, and each was told why.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_30_ended_in_order() {
    let home = Home::new(ARENA);
    let service = home.start().await;
    let mut robot = Robot::enter(service.address(), Form::Binary).await;
    let mut alice = arena::driver(service.address(), Form::Xml, "alice").await;
    let before = grab(&mut alice).await;
    robot.expect(&format!("grabbed alice {before}")).await;
    // Acknowledged, and not read yet: what was promised arrives before the end.
    for number in 0..COMMANDS {
        let mut command = command(&number.to_string(), None);
        command.receipt = Some(true);
        command.echo = Some(false);
        alice.ask(command).await.expect("the owner may");
    }
    let ended = tokio::spawn(service.terminate());
    for number in 0..COMMANDS {
        robot.expect(&format!("command {number} {before}")).await;
    }
    while let Some(heard) = robot.hears_or_ends().await {
        assert!(!heard.starts_with("command"), "{heard}");
    }
    let code = alice.last_error().await.expect("a reason");
    assert_eq!(code.word(), "shutdown");
    assert_eq!(ended.await.expect("it ends").code(), Some(0));

    let service = home.start().await;
    let mut bob = arena::enter(service.address(), Form::Xml, "bob").await;
    let after = grab(&mut bob).await;
    assert!(after > before);
    assert_eq!(service.terminate().await.code(), Some(0));
}

/// Killed again and again, also in the middle of a grant: no fence ever comes back, and what was granted is known.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_30_killed_again_and_again() {
    let home = Home::new(ARENA);
    let (mut highest, mut owner) = (0, None::<&str>);
    for round in 0..8 {
        let service = home.start().await;
        let user = ["alice", "bob"][round % 2];
        let mut peer = arena::enter(service.address(), Form::Binary, user).await;
        let info = peer.ask(about("info")).await.expect("anybody may").value();
        let fence = fence_of(&info);
        assert!(fence >= highest, "{fence} after {highest}");
        if let Some(owner) = owner {
            // It was told that it has the token, so it is known to have had it.
            let kept = info.get("reserved").and_then(|kept| kept.get("peer"));
            assert_eq!(kept, Some(&Value::from(owner)), "round {round}: {info:?}");
        }
        let id = peer
            .post(about("grab").content(Map::new().with("wait", "unlimited")))
            .await;
        owner = match round % 3 {
            // In the middle of it, wherever that is.
            0 => {
                drop(peer);
                None
            }
            _ => {
                let granted = peer.answer(id).await.expect("its turn comes");
                let fence = fence_of(&granted.value());
                assert!(fence > highest, "{fence} after {highest}");
                highest = fence;
                Some(user)
            }
        };
        service.kill().await;
    }
}

/// A token without a lease is kept for half a minute, as long as a lost link may go unnoticed. One that was free is
/// not kept at all.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_30_without_a_lease() {
    let home = Home::new(ARENA);
    let service = home.start().await;
    let mut alice = arena::enter(service.address(), Form::Xml, "alice").await;
    let grabbed = alice.ask_about(Family::Token, "grab", "/arena/other").await;
    let before = fence_of(&grabbed.expect("it is free"));
    service.kill().await;

    let service = home.start().await;
    let mut bob = arena::enter(service.address(), Form::Xml, "bob").await;
    let other = Parcel::new(Family::Token, "grab").context(mom_tests::raw::at("/arena/other"));
    check_kept(bob.ask(other).await, Duration::from_secs(30));
    assert!(grab(&mut bob).await > 0, "nobody had this one");
    let mut alice = arena::enter(service.address(), Form::Xml, "alice").await;
    let grabbed = alice.ask_about(Family::Token, "grab", "/arena/other").await;
    assert!(fence_of(&grabbed.expect("it was hers")) > before);
    assert_eq!(service.terminate().await.code(), Some(0));
}
