//! A broker on a store.

use std::path::Path as FilePath;
use std::sync::Arc;

use mom_config::{ConnectionCaps, WebConfig};
use mom_hub::{Holder, Record, Ticket};
use mom_net::Takes;
use mom_proto::{Code, Path, Time};
use mom_store::Store;
use tempfile::TempDir;
use tokio::sync::{Semaphore, watch};

use super::Broker;
use super::listen::{Entry, Listener};
use crate::connection::AdmissionLimiter;
use crate::web::Web;
use crate::{BrokerError, Clock, Config, StoreError};

fn config(state: &FilePath) -> Config {
    let mut config = Config::default();
    config.listen = vec!["127.0.0.1:0".into()];
    config.store.path = Some(state.to_owned());
    config
}

fn record(token: usize) -> Record {
    Record {
        path: Path::parse(&format!("/token/{token:02}")).expect("a path"),
        fence: 7,
        owner: Some(Holder {
            user: "alice".to_owned(),
            name: "ally".to_owned(),
        }),
        before: None,
        lease: Some(1),
    }
}

/// What the hub wants stored is in the files when the broker has stopped, awaited or not.
#[tokio::test]
async fn a_broker_that_stops_has_written_all() {
    let folder = TempDir::new().expect("a folder");
    let broker = Broker::start(config(folder.path())).await.expect("it starts");
    let records: Vec<Record> = (0..50).map(record).collect();
    for (number, record) in records.iter().enumerate() {
        let ticket = (number % 2 == 0).then_some(Ticket(number as u64));
        broker.services.board.keep(record.clone(), ticket);
    }
    broker.stop().await;
    let now = Time::from_micros(0).expect("a time");
    let opened = Store::open(folder.path(), now).expect("the broker has left it");
    assert_eq!(opened.records, records);
}

/// The store's epoch is the hub's, and a directory in use does not start.
#[tokio::test]
async fn a_broker_goes_on_after_what_is_stored() {
    let folder = TempDir::new().expect("a folder");
    let start = |seconds: i64| {
        let clock = Clock::manual(Time::from_micros(seconds * 1_000_000).expect("a time"));
        Broker::start_at(config(folder.path()), clock)
    };
    let broker = start(1000).await.expect("it starts");
    let second = start(2000).await.expect_err("in use");
    assert!(
        matches!(second, BrokerError::Store(StoreError::InUse { .. })),
        "{second}"
    );
    broker.stop().await;
    start(500).await.expect("a clock that went back").stop().await;
    let opened = Store::open(folder.path(), Time::from_micros(0).expect("a time"));
    assert_eq!(opened.expect("it opens").epoch, 1002);
}

/// Proxies that do not say whose connections theirs are keep nobody out but each other, and take no seats.
#[tokio::test]
async fn so_many_connections_of_proxies_are_untold() {
    let folder = TempDir::new().expect("a folder");
    let broker = Broker::start(config(folder.path())).await.expect("a broker");
    let caps = ConnectionCaps {
        all: 1,
        before_login: 1,
        per_address: 1,
        per_user: 1,
    };
    let doors = Arc::new(AdmissionLimiter::new(caps));
    let listener = Listener {
        services: broker.services.clone(),
        web: Arc::new(Web::new(Arc::clone(&doors), &WebConfig::default())),
        doors,
        tls: Arc::default(),
        takes: Takes::default(),
        proxies: vec!["10.0.0.0/8".parse().expect("a network")],
        stop: watch::channel(false).1,
    };
    let untold = Arc::new(Semaphore::new(2));
    let enter = |from: &str| listener.enter(from.parse().expect("an address"), &untold);
    let places = ["10.0.0.1:1", "10.0.0.2:1"].map(|from| enter(from).expect("a place"));
    assert!(places.iter().all(|entry| matches!(entry, Entry::Untold(..))));
    let refused = enter("10.0.0.3:1").err().expect("one too many");
    assert_eq!(refused.code, Code::TOO_MANY_CONNECTIONS);
    let known = enter("192.0.2.1:1").expect("another way in");
    assert!(matches!(known, Entry::Known(_)), "its seat was free");
    drop(places);
    assert!(enter("10.0.0.3:1").is_ok());
}
