//! Threats 19 and 24: many hands on one token.

use mom_proto::codec::Form;
use mom_proto::{Code, Family, Map, Parcel, WireError};
use mom_tests::canary::fence_of;
use mom_tests::raw::{Raw, at};

use super::World;
use super::arena::{self, Robot, about, grab};

const PEERS: usize = 64;
const ROUNDS: u64 = 50;
const TOKEN: &str = "/arena/token";

/// Through sockets as many as take a few seconds; the hub alone is tried with 1 000 peers and 10 000 rounds.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_19_one_grant_each() {
    let mut world = World::start().await;
    let mut host = Raw::login(world.address(), Form::Xml, "carol").await;
    for (path, kind) in [("/arena", "session"), (TOKEN, "token")] {
        let mut spec = Map::new().with("kind", kind);
        if kind == "token" {
            spec.set("manager", "robot-token");
        }
        let create = Parcel::new(Family::Context, "create")
            .context(at(path))
            .content(spec);
        host.ask(create).await.expect("an operator may");
        if kind == "session" {
            host.join(&[path]).await;
        }
    }
    let mut peers = Vec::new();
    for number in 0..PEERS {
        let form = if number % 2 == 0 { Form::Xml } else { Form::Binary };
        let mut peer = Raw::login(world.address(), form, "bob").await;
        peer.join(&["/arena"]).await;
        peers.push(peer);
    }
    let mut highest = 0;
    for round in 0..ROUNDS {
        let grab = Parcel::new(Family::Token, "grab").context(at(TOKEN));
        let mut ids = Vec::with_capacity(PEERS);
        for peer in &mut peers {
            ids.push(peer.post(grab.clone()).await);
        }
        let mut winners = Vec::new();
        for (number, (peer, id)) in peers.iter_mut().zip(ids).enumerate() {
            match peer.answer(id).await {
                Ok(grant) => winners.push((number, fence_of(&grant.value()))),
                Err(error) => assert_eq!(error.code.word(), "held", "round {round}: {error}"),
            }
        }
        let [(winner, fence)] = winners[..] else {
            panic!("round {round}: granted to {winners:?}");
        };
        assert!(fence > highest, "round {round}: {fence} after {highest}");
        highest = fence;
        let released = peers[winner].ask_about(Family::Token, "release", TOKEN).await;
        released.expect("the owner may");
        world.canary.check().await;
    }
    world.end().await;
}

/// How a round of threat 24 went for its four.
struct Outcome {
    released: bool,
    accepted: bool,
    rival: bool,
}

/// Threat 24: preempting, releasing, and taking what was offered, all at once from as many sockets: they happen one
/// after the other, the loser hears how, and an equal level takes nothing.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_24_preempt_release_and_give_at_once() {
    let mut world = World::start().await;
    arena::make(world.address(), Map::new()).await;
    let mut robot = Robot::enter(world.address(), Form::Binary).await;
    let mut alice = arena::enter(world.address(), Form::Xml, "alice").await;
    let mut bob = arena::enter(world.address(), Form::Binary, "bob").await;
    let mut rival = arena::enter(world.address(), Form::Xml, "bob").await;
    let mut carol = arena::enter(world.address(), Form::Binary, "carol").await;
    let mut grants = 0;
    for round in 0..ROUNDS {
        let fence = grab(&mut alice).await;
        robot.expect(&format!("grabbed {} {fence}", alice.name())).await;
        let offer = about("give").content(Map::new().with("to", bob.name()));
        // After some offers that came to nothing the next ones have to wait; all else goes on.
        if let Err(error) = alice.ask(offer).await {
            assert_eq!(error.code, Code::TRY_LATER, "the owner may");
        }
        let mut ids = [0; 4];
        for turn in 0..4 {
            // Who is first on the wire changes; who is first in the hub the hub says.
            let place = usize::try_from(round + turn).expect("a small number") % 4;
            ids[place] = match place {
                0 => alice.post(about("release")).await,
                1 => bob.post(about("accept")).await,
                2 => rival.post(about("grab")).await,
                _ => carol.post(about("grab")).await,
            };
        }
        let outcome = Outcome {
            released: check(alice.answer(ids[0]).await, "not-owner"),
            accepted: check(bob.answer(ids[1]).await, "no-offer"),
            rival: check(rival.answer(ids[2]).await, "held"),
        };
        let granted = carol.answer(ids[3]).await.expect("nobody is above her");
        let last = fence_of(&granted.value());
        let names = [alice.name(), bob.name(), rival.name(), carol.name()];
        let story = story(&mut robot, names, last).await;
        check_story(&story, (names[0], fence), names, &outcome);
        carol.ask(about("release")).await.expect("the owner may");
        robot.expect("halt").await;
        robot
            .expect(&format!("released {} released {last}", carol.name()))
            .await;
        world.canary.check().await;
        grants += 1 + story.iter().filter(|line| line.starts_with("grabbed")).count() as u64;
    }
    let lines = world.end().await;
    for what in ["granted", "lost"] {
        assert_eq!(
            lines.count(&[("what", what), ("context", TOKEN)]),
            grants,
            "{what}"
        );
    }
}

/// Whether a request was granted; if not, it was for this reason.
fn check(answer: Result<Parcel, WireError>, code: &str) -> bool {
    match answer {
        Ok(_) => true,
        Err(error) => {
            assert_eq!(error.code.word(), code, "{error}");
            false
        }
    }
}

/// What the robot hears up to the last grant.
async fn story(robot: &mut Robot, names: [&str; 4], last: u64) -> Vec<String> {
    let end = format!("grabbed {} {last}", names[3]);
    let mut story = Vec::new();
    loop {
        let heard = robot.hears().await;
        let over = heard == end;
        story.push(heard);
        if over {
            return story;
        }
    }
}

/// Each owner loses the token before the next one has it, for the reason that its rival was told, and after the robot
/// was halted, also where both agreed.
fn check_story(story: &[String], first: (&str, u64), names: [&str; 4], outcome: &Outcome) {
    let [alice, bob, rival, carol] = names;
    let (mut owner, mut fence) = (Some(first.0), first.1);
    let (mut halted, mut owners) = (false, vec![alice]);
    let mut reasons = Vec::new();
    for line in story {
        let words: Vec<&str> = line.split(' ').collect();
        match words[..] {
            ["halt"] => halted = true,
            ["released", who, reason, of] => {
                assert_eq!((Some(who), of), (owner.take(), &*fence.to_string()), "{story:?}");
                assert!(halted, "{story:?}");
                reasons.push(reason);
            }
            ["grabbed", who, higher] => {
                assert_eq!(owner, None, "{story:?}");
                let higher = higher.parse().expect("a fence");
                assert!(higher > fence, "{story:?}");
                let known = names.into_iter().find(|name| *name == who);
                (owner, fence, halted) = (known, higher, false);
                owners.push(known.expect("one of the four"));
            }
            _ => panic!("{story:?}"),
        }
    }
    assert_eq!(owners.last(), Some(&carol));
    assert_eq!(outcome.accepted, owners.contains(&bob), "{story:?}");
    assert_eq!(outcome.rival, owners.contains(&rival), "{story:?}");
    let lost = match (outcome.released, outcome.accepted) {
        (true, false) => "released",
        (false, true) => "given",
        (false, false) => "preempted",
        (true, true) => panic!("who gave it away cannot release it: {story:?}"),
    };
    assert_eq!(reasons[0], lost, "{story:?}");
    // An equal level only ever had it free.
    assert!(!outcome.rival || outcome.released, "{story:?}");
}
