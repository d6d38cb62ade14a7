//! Threats 15 and 16: passwords that are guessed, and logins that are too many.

use std::net::{IpAddr, Ipv4Addr};
use std::time::Duration;

use mom_broker::{Config, FailureRate};
use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel, WireError};
use mom_tests::login::{DeviceKey, challenge, log_in, make_costly, password};
use mom_tests::raw::{PATIENCE, Raw};
use tokio::task::JoinSet;

use super::{check_bad_login, clock};
use crate::threats::World;

const BURST: u32 = 5;

/// Six failures a minute at an account, a burst of five; an address has twice that.
fn strict(config: &mut Config) {
    let rate = |per_minute, burst| FailureRate { per_minute, burst };
    config.login.throttle.per_account = rate(6, BURST);
    config.login.throttle.per_address = rate(12, 2 * BURST);
    config.login.throttle.per_place = rate(6, BURST);
    config.login.attempts = 1000;
}

/// An address of loopback: 127.0.1.1 and so on.
fn address(number: usize) -> IpAddr {
    let (third, last) = (1 + number / 200, 1 + number % 200);
    IpAddr::from(Ipv4Addr::new(127, 0, third as u8, last as u8))
}

async fn from(world: &World, number: usize) -> Raw {
    Raw::connect_from(address(number), world.address(), Form::Binary).await
}

/// Guesses once; gives how long to wait if nothing was even tried.
async fn guess(raw: &mut Raw, user: &str) -> Option<Duration> {
    let error = password(raw, user, "guess").await.expect_err("a wrong guess");
    waiting(&error)
}

fn waiting(error: &WireError) -> Option<Duration> {
    match error.code.word() {
        "bad-login" => None,
        "try-later" => Some(
            error
                .retry_in()
                .filter(|wait| !wait.is_zero())
                .expect("for how long"),
        ),
        other => panic!("{other}: {error}"),
    }
}

/// From one address: so many guesses, then one now and then; and nothing is hashed for the others.
#[tokio::test]
async fn threat_15_guessing_from_one_address() {
    let clock = clock();
    let mut world = World::start_at(clock.clone(), strict).await;
    for (number, user) in ["bob", "nobody"].into_iter().enumerate() {
        let before = world.broker.login_stats().hashed;
        let mut eve = from(&world, number).await;
        let mut outcomes = Vec::new();
        for _ in 0..50 {
            outcomes.push(guess(&mut eve, user).await);
        }
        let tried = outcomes.iter().filter(|wait| wait.is_none()).count();
        assert_eq!(tried, BURST as usize, "{user}: {outcomes:?}");
        assert_eq!(outcomes.last(), Some(&Some(Duration::from_secs(10))), "{user}");
        // An unknown user costs as much as one that is known, and is throttled as much.
        assert_eq!(
            world.broker.login_stats().hashed - before,
            u64::from(BURST),
            "{user}"
        );
        clock.advance(Duration::from_millis(9_999));
        assert_eq!(guess(&mut eve, user).await, Some(Duration::from_millis(1)));
        clock.advance(Duration::from_millis(1));
        assert_eq!(guess(&mut eve, user).await, None);
        assert!(guess(&mut eve, user).await.is_some());
        world.check_nothing_arrived("guesses").await;
    }
    // One address at many accounts is slowed too; other addresses are not concerned.
    let mut eve = from(&world, 7).await;
    for number in 0..2 * BURST {
        assert_eq!(guess(&mut eve, &format!("user-{number}")).await, None);
    }
    assert_eq!(guess(&mut eve, "one-more").await, Some(Duration::from_secs(5)));
    let error = password(&mut eve, "alice", "alice")
        .await
        .expect_err("an attacker's address");
    assert!(waiting(&error).is_some());
    let mut alice = from(&world, 8).await;
    password(&mut alice, "alice", "alice")
        .await
        .expect("alice, elsewhere");
    clock.advance(Duration::from_secs(3600));
    world.end().await;
}

/// From a thousand addresses at one account: as many guesses as from one. The right user gets in from where it
/// has been before at once, from elsewhere after the time that it is told, and with a key at any time.
#[tokio::test]
async fn threat_15_guessing_from_a_thousand_addresses() {
    let clock = clock();
    let mut world = World::start_at(clock.clone(), |config| {
        strict(config);
        let bob = config.users.iter_mut().find(|user| user.name == "bob");
        bob.expect("bob").keys = vec![DeviceKey::number(1).public()];
    })
    .await;
    let mut bob = from(&world, 2000).await;
    password(&mut bob, "bob", "bob").await.expect("bob, at home");
    let before = world.broker.login_stats().hashed;
    let mut tried = 0;
    for number in 0..1000 {
        let mut eve = from(&world, number).await;
        tried += u32::from(guess(&mut eve, "bob").await.is_none());
    }
    assert_eq!(tried, BURST);
    assert_eq!(world.broker.login_stats().hashed - before, u64::from(BURST));
    for _ in 0..3 {
        let mut bob = from(&world, 2000).await;
        password(&mut bob, "bob", "bob").await.expect("bob, at home");
    }
    let mut away = from(&world, 2001).await;
    let error = password(&mut away, "bob", "bob")
        .await
        .expect_err("an attack is on");
    let wait = waiting(&error).expect("try-later");
    let asked = challenge(&mut away, "bob").await.expect("a challenge");
    away.ask(DeviceKey::number(1).answer(&asked, "bob"))
        .await
        .expect("nobody can guess a key");
    clock.advance(wait);
    let mut away = from(&world, 2002).await;
    password(&mut away, "bob", "bob").await.expect("after that time");
    // It is known there from now on, whatever the others do.
    for number in 0..20 {
        guess(&mut from(&world, number).await, "bob").await;
    }
    let mut away = from(&world, 2002).await;
    password(&mut away, "bob", "bob").await.expect("known by now");
    world.check_nothing_arrived("guesses").await;
    clock.advance(Duration::from_secs(3600));
    world.end().await;
}

/// A place that the user knows is not a place to guess from, and who guesses there hinders nobody else's login.
#[tokio::test]
async fn threat_15_guessing_beside_the_right_user() {
    let clock = clock();
    let world = World::start_at(clock.clone(), strict).await;
    let mut bob = from(&world, 0).await;
    password(&mut bob, "bob", "bob").await.expect("bob");
    let mut eve = from(&world, 0).await;
    while guess(&mut eve, "alice").await.is_none() {}
    while guess(&mut eve, "nobody").await.is_none() {}
    while guess(&mut eve, "somebody").await.is_none() {}
    password(&mut bob, "bob", "bob").await.expect("bob's own count");
    let mut tried = 0;
    while guess(&mut eve, "bob").await.is_none() {
        tried += 1;
    }
    assert_eq!(tried, BURST);
    let mut elsewhere = from(&world, 1).await;
    password(&mut elsewhere, "bob", "bob")
        .await
        .expect("not under attack there");
    world.end().await;
}

/// Signatures that are wrong count for their address; a right one is taken from there at any time.
#[tokio::test]
async fn threat_15_other_failures_count_too() {
    let world = World::start_at(clock(), |config| {
        strict(config);
        let bob = config.users.iter_mut().find(|user| user.name == "bob");
        bob.expect("bob").keys = vec![DeviceKey::number(1).public()];
    })
    .await;
    let mut eve = from(&world, 0).await;
    for _ in 0..3 * BURST {
        let asked = challenge(&mut eve, "bob").await.expect("a challenge");
        let told = eve.ask(DeviceKey::number(9).answer(&asked, "bob")).await;
        check_bad_login(told, "a wrong key");
    }
    assert!(guess(&mut eve, "alice").await.is_some());
    let asked = challenge(&mut eve, "bob").await.expect("a challenge");
    let right = eve.ask(DeviceKey::number(1).answer(&asked, "bob")).await;
    right.expect("who has the key is not a guesser");
    // Bob's password is not concerned: nothing of his was guessed.
    let mut bob = from(&world, 1).await;
    password(&mut bob, "bob", "bob").await.expect("bob");
    world.end().await;
}

/// What is not a login counts for its address as a wrong one does, though it costs no hash.
#[tokio::test]
async fn threat_15_logins_that_cannot_be_read_count_too() {
    let clock = clock();
    let world = World::start_at(clock.clone(), strict).await;
    let mut eve = from(&world, 0).await;
    let nonsense = [Map::new().with("password", 7), Map::new().with("name", "bob")];
    for number in 0..2 * BURST {
        let nonsense = &nonsense[number as usize % 2];
        let error = log_in(&mut eve, nonsense.clone()).await.expect_err("no login");
        assert_eq!(error.code.word(), "bad-content");
        // A name that is not valid may be a person's mistake.
        let mistaken = Map::new().with("guest", true).with("nickname", "a/b");
        let error = log_in(&mut eve, mistaken).await.expect_err("no name");
        assert_eq!(error.code.word(), "bad-name");
    }
    let answer = Parcel::new(Family::Login, "answer").content(Map::new());
    let later = eve.ask(answer).await.expect_err("no answer");
    assert_eq!(waiting(&later), Some(Duration::from_secs(5)));
    let later = log_in(&mut eve, nonsense[0].clone()).await.expect_err("no login");
    assert_eq!(waiting(&later), Some(Duration::from_secs(5)));
    let mut bob = from(&world, 1).await;
    password(&mut bob, "bob", "bob").await.expect("bob, elsewhere");
    clock.advance(Duration::from_secs(5));
    let error = log_in(&mut eve, Map::new()).await.expect_err("no login");
    assert_eq!(error.code.word(), "bad-content");
    world.end().await;
}

/// Threat 15: one connection has few attempts, whatever the address has.
#[tokio::test]
async fn threat_15_one_connection_has_three_attempts() {
    let world = World::start_with(|_| {}).await;
    for form in Form::ALL {
        let mut eve = Raw::connect(world.address(), form).await;
        for _ in 0..3 {
            check_bad_login(password(&mut eve, "bob", "guess").await, "a guess");
        }
        assert_eq!(eve.next_error().await.code.word(), "too-many-logins");
        eve.check_closed().await;
    }
    world.end().await;
}

/// Threat 16: so many logins at once that they would hold the processor for long: few are hashed at a time, some
/// wait, the others are told when to come again; who is in does not notice.
#[tokio::test]
async fn threat_16_logins_at_once() {
    const AT_ONCE: usize = 200;
    const WAITING: usize = 16;
    let mut world = World::start_with(|config| {
        config.login.waiting = WAITING;
        make_costly(&mut config.users, "bob");
    })
    .await;
    let before = world.broker.login_stats().hashed;
    let address = world.address();
    let mut logins = JoinSet::new();
    let mut peers = Vec::new();
    for number in 0..AT_ONCE {
        let form = Form::ALL[number % 3];
        peers.push(Raw::connect(address, form).await);
    }
    for mut peer in peers {
        logins.spawn(async move { (password(&mut peer, "bob", "bob").await, peer) });
    }
    for _ in 0..5 {
        world.check_nothing_arrived("many logins").await;
    }
    let (mut granted, mut put_off) = (0, None);
    let all = async {
        while let Some(done) = logins.join_next().await {
            match done.expect("a login ends") {
                (Ok(_), _) => granted += 1,
                (Err(error), peer) => {
                    assert!(waiting(&error).is_some(), "{error}");
                    put_off = Some(peer);
                }
            }
        }
    };
    tokio::time::timeout(PATIENCE, all)
        .await
        .expect("all are answered");
    let stats = world.broker.login_stats();
    assert!(
        granted >= WAITING && stats.hashed - before == granted as u64,
        "{granted}: {stats:?}"
    );
    assert!(stats.most <= Config::default().login.hashers, "{stats:?}");
    assert_eq!(stats.hashing, 0);
    if let Some(mut peer) = put_off {
        // Being put off is not a failure: the connection is as it was.
        peer.ask(Parcel::new(Family::Time, "ping")).await.expect("a pong");
        password(&mut peer, "bob", "bob").await.expect("later");
    }
    world.end().await;
}
