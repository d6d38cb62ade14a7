//! What nobody has thought of: random load beside the canary, which must not notice.

use std::time::{SystemTime, UNIX_EPOCH};
use std::{env, time::Duration};

use mom_broker::{Broker, Clock, Config};
use mom_proto::codec::Form;
use mom_proto::{Family, Value};
use mom_tests::attacks::configuration;
use mom_tests::canary::Canary;
use mom_tests::load::Load;
use mom_tests::raw::Raw;

/// Loads that are given to one hub together.
const LOADS: u64 = 2;

/// What the whole hub may hold: some of the load meets that bound.
const MEMORY: usize = 16 << 20;

/// `MOM_LOAD_SECONDS` is how long it lasts, `MOM_LOAD_SEED` what it does; a failure says with which.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn random_load_is_nothing_to_the_canary() {
    let number = |name: &str| env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
    let seconds = number("MOM_LOAD_SECONDS").unwrap_or(20);
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    let seed = number("MOM_LOAD_SEED").unwrap_or_else(|| now.map_or(1, |now| now.as_secs()));
    println!("MOM_LOAD_SEED={seed} MOM_LOAD_SECONDS={seconds}");
    let mut config = Config::load(&configuration()).expect("a right configuration");
    config.memory = Some(MEMORY);
    config.limits.outbox = 1 << 20;
    let broker = Broker::start_at(config, Clock::system())
        .await
        .expect("it starts");
    let address = broker.local_addr();
    let mut canary = Canary::start(address).await;
    let loads = (0..LOADS).map(|at| {
        let mut load = Load::new(address, seed.wrapping_add(at));
        tokio::spawn(async move {
            load.run(Duration::from_secs(seconds)).await;
            load.steps
        })
    });
    let mut steps = 0;
    for load in loads.collect::<Vec<_>>() {
        while !load.is_finished() {
            canary.check().await;
        }
        steps += load.await.expect("the load goes on");
    }
    assert!(steps > 100, "only {steps} steps");
    assert!(canary.stop().await > 0);
    broker.check();
    let mut carol = Raw::login(address, Form::Binary, "carol").await;
    let stats = carol
        .ask_about(Family::Context, "stats", "/")
        .await
        .expect("permitted");
    let used = stats
        .get("memory")
        .and_then(|memory| memory.get("used")?.as_int());
    let bound = Value::from(i64::try_from(MEMORY).expect("small")).as_int();
    assert!(used <= bound, "{stats:?}");
    broker.stop().await;
}
