//! Threat 19: many hands on one token.

use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel};
use mom_tests::canary::fence_of;
use mom_tests::raw::{Raw, at};

use super::World;

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
