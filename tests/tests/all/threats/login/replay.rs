//! Threat 14: a challenge is answered once, soon, by its key, on its connection.

use std::collections::HashSet;
use std::net::UdpSocket;
use std::time::Duration;

use mom_broker::Config;
use mom_proto::codec::Form;
use mom_proto::{Map, Value};
use mom_tests::login::{DeviceKey, challenge, log_in, password};
use mom_tests::raw::Raw;

use super::{check_bad_login, check_outside, clock};
use crate::threats::World;

fn with_keys(config: &mut Config) {
    for user in &mut config.users {
        match user.name.as_str() {
            "bob" => user.keys = vec![DeviceKey::number(1).public(), DeviceKey::number(2).public()],
            "camera" => {
                user.keys = vec![DeviceKey::number(3).public()];
                user.password = None;
            }
            _ => {}
        }
    }
    // Every test fails on purpose, many times.
    config.login.throttle.per_address.burst = 1000;
}

#[tokio::test]
async fn threat_14_a_challenge_is_answered_once() {
    let world = World::start_with(with_keys).await;
    let key = DeviceKey::number(1);
    for form in Form::ALL {
        let connect = || Raw::connect(world.address(), form);
        let mut bob = connect().await;
        let asked = challenge(&mut bob, "bob").await.expect("a challenge");
        let answer = key.answer(&asked, "bob");
        let welcome = bob.ask(answer.clone()).await.expect("bob's key").value();
        assert_eq!(welcome.get("user"), Some(&Value::from("bob")));
        check_bad_login(bob.ask(answer.clone()).await, "again, on the same connection");
        bob.check_alive().await;
        let asked = challenge(&mut bob, "bob").await.expect("another challenge");
        check_bad_login(bob.ask(answer.clone()).await, "to the next challenge there");
        check_bad_login(
            bob.ask(key.answer(&asked, "bob")).await,
            "a wrong answer used it up",
        );

        let mut eve = connect().await;
        check_bad_login(eve.ask(answer.clone()).await, "elsewhere, unasked");
        challenge(&mut eve, "bob").await.expect("a challenge");
        check_bad_login(eve.ask(answer).await, "elsewhere, to another challenge");
        check_outside(&mut eve, "replayed").await;

        // Bob answers what eve was asked, and the other way round.
        let (mut bob, mut eve) = (connect().await, connect().await);
        let to_bob = challenge(&mut bob, "bob").await.expect("a challenge");
        let to_eve = challenge(&mut eve, "bob").await.expect("a challenge");
        check_bad_login(
            eve.ask(key.answer(&to_bob, "bob")).await,
            "bound to its connection",
        );
        check_bad_login(
            bob.ask(key.answer(&to_eve, "bob")).await,
            "bound to its connection",
        );

        // Only the newest counts; any login takes the last one away.
        let first = challenge(&mut bob, "bob").await.expect("a challenge");
        challenge(&mut bob, "bob").await.expect("a challenge");
        check_bad_login(bob.ask(key.answer(&first, "bob")).await, "an older challenge");
        let mut bob = connect().await;
        let asked = challenge(&mut bob, "bob").await.expect("a challenge");
        check_bad_login(password(&mut bob, "bob", "wrong").await, "not bob's");
        check_bad_login(bob.ask(key.answer(&asked, "bob")).await, "given up");
    }
    world.end().await;
}

#[tokio::test]
async fn threat_14_who_a_signature_is_for() {
    let world = World::start_with(with_keys).await;
    for form in Form::ALL {
        let attempt = async |what: &str, asked_as: &str, key: u8, hub: &str, user: &str| {
            let mut eve = Raw::connect(world.address(), form).await;
            let asked = challenge(&mut eve, asked_as).await.expect("everybody is asked");
            assert_eq!(asked.get("context"), Some(&Value::from("mom-login-1")));
            assert_eq!(asked.get("hub"), Some(&Value::from("mom")));
            let nonce = asked.get("nonce").and_then(Value::as_binary);
            assert_eq!(nonce.map(|nonce| nonce.len()), Some(32));
            let answer = DeviceKey::number(key).answer_as(&asked, hub, user);
            let outcome = eve.ask(answer).await;
            if outcome.is_err() {
                check_outside(&mut eve, what).await;
            }
            outcome
        };
        for (what, asked_as, key, hub, user) in [
            ("another's key", "bob", 9, "mom", "bob"),
            ("the key of another user", "bob", 3, "mom", "bob"),
            ("as another user", "bob", 3, "mom", "camera"),
            ("for another hub", "bob", 1, "other", "bob"),
            ("a user without keys", "alice", 1, "mom", "alice"),
            ("nobody", "mallory", 1, "mom", "mallory"),
            ("no name at all", "../*", 1, "mom", "../*"),
        ] {
            let told = attempt(what, asked_as, key, hub, user).await;
            let text = check_bad_login(told, what);
            assert_eq!(text, "no user has this name and a key that made this signature");
        }
        attempt("bob's other key", "bob", 2, "mom", "bob")
            .await
            .expect("bob");
        attempt("without a password", "camera", 3, "mom", "camera")
            .await
            .expect("camera");
        // Who has no password has not an empty one either.
        for word in ["", "camera", "no such user"] {
            let mut eve = Raw::connect(world.address(), form).await;
            check_bad_login(password(&mut eve, "camera", word).await, word);
        }
    }
    world.end().await;
}

#[tokio::test]
async fn threat_14_a_challenge_is_answered_soon() {
    let clock = clock();
    let world = World::start_at(clock.clone(), with_keys).await;
    for (passed, in_time) in [(9999, true), (10_000, false), (3_600_000, false)] {
        let mut bob = Raw::connect(world.address(), Form::Xml).await;
        let asked = challenge(&mut bob, "bob").await.expect("a challenge");
        clock.advance(Duration::from_millis(passed));
        let outcome = bob.ask(DeviceKey::number(1).answer(&asked, "bob")).await;
        match in_time {
            true => drop(outcome.expect("in time")),
            false => drop(check_bad_login(outcome, "too late")),
        }
    }
    world.end().await;
}

#[tokio::test]
async fn threat_14_no_nonce_comes_twice() {
    let world = World::start_with(with_keys).await;
    let mut seen = HashSet::new();
    for _ in 0..4 {
        let mut eve = Raw::connect(world.address(), Form::Binary).await;
        for _ in 0..250 {
            let asked = challenge(&mut eve, "bob").await.expect("a challenge");
            let nonce = asked.get("nonce").and_then(Value::as_binary).cloned();
            assert!(seen.insert(nonce.expect("a nonce")));
        }
    }
    world.end().await;
}

/// An address of this machine that is not loopback. Nothing is sent.
fn elsewhere() -> Option<std::net::IpAddr> {
    let socket = UdpSocket::bind(("0.0.0.0", 0)).ok()?;
    socket.connect(("192.0.2.1", 9)).ok()?;
    let address = socket.local_addr().ok()?.ip();
    (!address.is_loopback() && !address.is_unspecified()).then_some(address)
}

/// An eavesdropper hears no secret: the hub does not even wait for the rest of it.
#[tokio::test]
async fn threat_14_secrets_from_elsewhere() {
    let Some(address) = elsewhere() else {
        println!("skipped: this machine has no address but loopback");
        return;
    };
    let broker = mom_tests::lab::start_with(|config| {
        with_keys(config);
        config.listen = vec![format!("{address}:0").into()];
    })
    .await;
    for form in Form::ALL {
        for content in [
            Map::new().with("name", "bob").with("password", "bob"),
            Map::new().with("token", "x.y.z"),
        ] {
            let mut bob = Raw::connect(broker.local_addr(), form).await;
            let login = mom_proto::Parcel::new(mom_proto::Family::Login, "login").content(content);
            bob.post(login).await;
            assert_eq!(bob.next_error().await.code.word(), "insecure");
            bob.check_closed().await;
        }
        let mut bob = Raw::connect(broker.local_addr(), form).await;
        let error = log_in(&mut bob, Map::new().with("guest", true)).await;
        check_bad_login(error, "no guests here");
        let asked = challenge(&mut bob, "bob").await.expect("a challenge");
        let welcome = bob.ask(DeviceKey::number(1).answer(&asked, "bob")).await;
        welcome.expect("a key is taken from anywhere");
    }
    broker.stop().await;
}
