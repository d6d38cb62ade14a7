//! Threat 16: while logins rain, an owner renews and a stop arrives.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use mom_proto::codec::Form;
use mom_proto::{Code, Family, Map, Parcel};
use mom_tests::login::make_costly;
use mom_tests::raw::{Raw, message};
use tokio::task::JoinSet;

use super::World;
use super::arena::{self, ARM, Robot, about, grab};

const CONNECTIONS: usize = 200;
const WAITING: usize = 16;

/// What became of the logins of one connection.
#[derive(Default)]
struct Drops {
    granted: usize,
    put_off: usize,
    refused: usize,
}

/// Logs in again and again until it is told to stop: also a peer that is in may do so, and has to be hashed for.
async fn rain(mut peer: Raw, password: &'static str, stop: Arc<AtomicBool>) -> Drops {
    let mut drops = Drops::default();
    while !stop.load(Ordering::Acquire) {
        let content = Map::new().with("name", "bob").with("password", password);
        let login = Parcel::new(Family::Login, "login").content(content);
        match peer.ask(login).await {
            Ok(_) => drops.granted += 1,
            Err(error) if error.code == Code::TRY_LATER => drops.put_off += 1,
            Err(error) if error.code == Code::BAD_LOGIN => {
                drops.refused += 1;
                // Once more and the hub closes the connection, which is another test.
                if drops.refused == 2 {
                    break;
                }
            }
            Err(error) => panic!("{error}"),
        }
    }
    drops
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_16_control_goes_on_while_logins_rain() {
    let mut world = World::start_with(|config| {
        config.login.waiting = WAITING;
        make_costly(&mut config.users, "bob");
        // Some of so many are never lucky; that they are closed after a while is not what is tried here.
        config.limits.login_time = 600_000;
    })
    .await;
    let address = world.address();
    arena::make(address, Map::new().with("lease", 60_000)).await;
    let mut robot = Robot::enter(address, Form::Binary).await;
    let mut owner = arena::driver(address, Form::Xml, "alice").await;
    let fence = grab(&mut owner).await;
    robot.expect(&format!("grabbed {} {fence}", owner.name())).await;

    let stop = Arc::new(AtomicBool::new(false));
    let mut storm = JoinSet::new();
    for number in 0..CONNECTIONS {
        let form = Form::ALL[number % 3];
        let password = if number % 20 == 0 { "guess" } else { "bob" };
        let peer = Raw::connect(address, form).await;
        storm.spawn(rain(peer, password, Arc::clone(&stop)));
    }
    // Each round begins and ends in the rain: passwords are hashed before it and after it.
    for _ in 0..5 {
        let before = world.broker.login_stats().hashed;
        owner.ask(about("renew")).await.expect("the owner may");
        owner.post(message("stop", ARM, "")).await;
        robot.expect("stop").await;
        world.canary.check().await;
        while world.broker.login_stats().hashed == before {
            tokio::task::yield_now().await;
        }
    }
    stop.store(true, Ordering::Release);
    let (mut granted, mut put_off) = (0, 0);
    while let Some(drops) = storm.join_next().await {
        let drops = drops.expect("every login is answered");
        granted += drops.granted;
        put_off += drops.put_off;
    }
    assert!(granted > 0 && put_off > 0, "{granted} granted, {put_off} put off");
    let hashers = mom_broker::Config::default().login.hashers;
    assert!(world.broker.login_stats().most <= hashers);
    let lines = world.end().await;
    let refused = [("what", "refused"), ("verb", "login"), ("code", "try-later")];
    assert_eq!(
        lines.count(&refused),
        put_off as u64,
        "counted, not told one by one"
    );
}
