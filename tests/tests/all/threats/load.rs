//! Threat 26: receivers that do not read.

use std::net::SocketAddr;
use std::time::Duration;

use bytes::Bytes;
use mom_broker::Config;
use mom_proto::codec::Form;
use mom_proto::{Delivery, Family, Parcel, Value};
use mom_tests::bridge::Way;
use mom_tests::raw::{PATIENCE, Raw, at, message};
use mom_tests::service::Home;

use super::{CHAT, World};

const OUTBOX: usize = 128 * 1024;
const SIZE: usize = 32 * 1024;
/// More than outbox, kernel and one batch of a connection can hold together.
const MOST: usize = 2000;

fn small(config: &mut Config) {
    (config.limits.outbox, config.limits.burst) = (OUTBOX, OUTBOX);
}

async fn world() -> World {
    World::start_with(small).await
}

/// A peer in the channel that will not read; the witness leaves it to the two of them.
async fn sleeper(world: &mut World, form: Form) -> Raw {
    let mut sleeper = Raw::connect_small(world.entrance(form), form).await;
    sleeper.log_in("bob").await;
    sleeper.join(&[CHAT]).await;
    sleeper
}

async fn speaker(address: SocketAddr) -> Raw {
    let mut speaker = Raw::login(address, Form::Binary, "carol").await;
    speaker.join(&[CHAT]).await;
    speaker
}

fn block(delivery: Delivery) -> Parcel {
    let mut parcel = message("block", CHAT, Value::Binary(Bytes::from(vec![7; SIZE])));
    parcel.delivery = Some(delivery);
    parcel.echo = Some(false);
    parcel.receipt = Some(true);
    parcel.address = Some(vec!["bob".into()]);
    parcel
}

/// Sends until a receipt says that a parcel was dropped; gives how many were taken before.
async fn fill(speaker: &mut Raw, delivery: Delivery) -> usize {
    for taken in 0..MOST {
        let receipt = speaker
            .ask(block(delivery))
            .await
            .expect("the sender did nothing wrong")
            .value();
        let dropped = receipt
            .get("dropped")
            .and_then(Value::as_list)
            .expect("a receipt");
        if !dropped.is_empty() {
            assert_eq!(dropped, [Value::from("bob")]);
            assert_eq!(receipt.get("delivered"), Some(&Value::Int(0)));
            return taken;
        }
    }
    panic!("{MOST} blocks of {SIZE} bytes were taken for a peer that reads nothing");
}

/// Reliable parcels are never dropped silently: the receiver is closed, and hears why if it reads then.
#[tokio::test]
async fn threat_26_a_slow_receiver_is_closed() {
    for form in Form::ALL {
        a_slow_receiver_is_closed(world().await, form).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_26_a_slow_receiver_is_closed_at_other_doors() {
    for form in Form::ALL {
        for way in Way::beside(form) {
            a_slow_receiver_is_closed(World::start_by_with(way, form, small).await, form).await;
        }
    }
}

async fn a_slow_receiver_is_closed(mut world: World, form: Form) {
    let mut bob = sleeper(&mut world, form).await;
    let mut carol = speaker(world.address()).await;
    let taken = fill(&mut carol, Delivery::Reliable).await;
    assert!(taken >= OUTBOX / SIZE / 2, "the outbox holds something: {taken}");
    world.check_nothing_arrived("a slow receiver").await;
    assert_eq!(bob.last_error().await.expect("a reason").word(), "slow-receiver");
    // It is gone for the channel too.
    let error = loop {
        match carol.ask(block(Delivery::Reliable)).await {
            Ok(_) => {}
            Err(error) => break error,
        }
    };
    assert_eq!(error.code.word(), "unknown-peer");
    world.end().await;
}

/// A receiver that reads, and that a burst has overtaken, is not slow.
#[tokio::test]
async fn threat_26_who_is_behind_by_a_burst_stays() {
    for form in Form::ALL {
        let mut world = World::start().await;
        let mut bob = sleeper(&mut world, form).await;
        let mut carol = speaker(world.address()).await;
        // More than five times `limits.outbox`.
        const BURST: u32 = 700;
        for number in 0..BURST {
            let mut parcel = block(Delivery::Reliable);
            (parcel.receipt, parcel.id) = (None, Some(number.into()));
            carol.send_parcel(&parcel).await;
        }
        carol.check_alive().await;
        for number in 0..BURST {
            let parcel = bob.next_of(Family::Message, "block").await;
            assert_eq!(parcel.id, Some(number.into()), "in {}", form.word());
        }
        world.end().await;
    }
}

/// A receiver that never reads again is cut off all the same: nothing of it stays.
#[tokio::test]
async fn threat_26_a_dead_receiver_is_cut() {
    let mut world = world().await;
    let mut bob = sleeper(&mut world, Form::Binary).await;
    let mut carol = speaker(world.address()).await;
    fill(&mut carol, Delivery::Reliable).await;
    bob.send_until_closed(&[0xff; 64]).await;
    world.end().await;
}

/// What may be dropped is dropped, both are told how much, and nobody is closed.
#[tokio::test]
async fn threat_26_drops_are_told() {
    for (delivery, reason) in [(Delivery::Fleeting, "queue-full"), (Delivery::Latest, "replaced")] {
        let mut world = world().await;
        let mut bob = sleeper(&mut world, Form::Xml).await;
        let mut carol = speaker(world.address()).await;
        let mut sent = 0;
        // Drops are told now and then, and a quick hub takes much in between.
        let begin = std::time::Instant::now();
        let told = loop {
            assert!(begin.elapsed() < PATIENCE, "nothing was dropped of {sent}");
            let id = carol.post(block(delivery)).await;
            sent += 1;
            let answer = carol.next().await.expect("the speaker is connected");
            if answer.is(Family::Event, "dropped") {
                carol.answer(id).await.expect("taken or dropped, but not refused");
                break answer.value();
            }
            assert!(
                answer.family == Family::Event || answer.reference == Some(id),
                "{answer:?}"
            );
        };
        assert_eq!(told.get("reason"), Some(&Value::from(reason)), "{told:?}");
        assert_eq!(told.get("receiver"), Some(&Value::from("bob")), "{told:?}");
        let count = told.get("count").and_then(Value::as_int).expect("a count");
        assert!(count >= 1 && count <= sent as i64, "{count} of {sent}");
        world.check_nothing_arrived("drops").await;
        // Bob wakes up: what was not dropped is there, what was is told, and the connection lives.
        let (mut blocks, mut dropped) = (0, 0);
        while dropped == 0 {
            let heard = bob.next().await.expect("not closed");
            blocks += usize::from(heard.is(Family::Message, "block"));
            if heard.is(Family::Event, "dropped") {
                dropped = heard
                    .value()
                    .get("count")
                    .and_then(Value::as_int)
                    .expect("a count");
            }
        }
        assert!(blocks < sent, "{blocks} of {sent}");
        bob.check_alive().await;
        world.end().await;
    }
}

/// A peer that asks without end is told when to come again; to keep a token, to give it up and to stop are never refused
/// for it, and others do not notice.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn requests_without_end_are_put_off() {
    let home = Home::new("[limits]\nrequests = 50\n");
    let service = home.start().await;
    let mut alice = Raw::login(service.address(), Form::Binary, "alice").await;
    let mut bob = Raw::login(service.address(), Form::Xml, "bob").await;
    alice.join(&["/robot", "/robot/arm"]).await;
    let token = |name: &str| Parcel::new(Family::Token, name).context(at("/robot/token"));
    alice.ask(token("grab")).await.expect("it is free");
    let mut refused = None;
    // At 50 a second this many take longer than they do.
    for _ in 0..2000 {
        if let Err(error) = alice.ask(token("info")).await {
            refused = Some(error);
            break;
        }
    }
    let error = refused.expect("too many");
    assert_eq!(error.code.word(), "try-later", "{error}");
    let wait = error.retry_in().expect("it says when");
    assert!(wait <= Duration::from_secs(1), "{wait:?}");
    for _ in 0..100 {
        alice.ask(token("renew")).await.expect("never limited");
        let stop = message("stop", "/robot/arm", mom_proto::Value::Null);
        let id = alice
            .post(Parcel {
                receipt: Some(true),
                ..stop
            })
            .await;
        alice.answer(id).await.expect("never limited");
    }
    bob.ask(Parcel::new(Family::Context, "list").context(at("/")))
        .await
        .expect("not bob's fault");
    alice.ask(token("release")).await.expect("never limited");
    assert_eq!(service.terminate().await.code(), Some(0));
}
