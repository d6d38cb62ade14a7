//! `mom://`: whichever door opens, what has worked comes first, and the same link goes on over another door.

use std::time::Duration;

use mom_broker::Broker;
use mom_client::{Builder, Client, Event, Reconnect, Trust};
use mom_tests::faulty::{End, Fault, FaultyNetwork};
use mom_tests::programs::PATIENCE;
use mom_tests::{lab, tls};
use tokio::time::timeout;

/// Nobody's address here as far as a client can tell, although the system takes connections there to its loopback.
const ELSEWHERE: &str = "0.0.0.0";

fn pin(broker: &Broker) -> Trust {
    Trust::Pinned(broker.fingerprint().expect("it has a certificate"))
}

fn builder(host: &str, network: &FaultyNetwork, broker: &Broker) -> Builder {
    let quick = Reconnect {
        first: Duration::from_millis(1),
        most: Duration::from_millis(10),
        give_up_after: None,
    };
    Client::builder(format!("mom://{host}:{}", network.address.port()))
        .user("alice")
        .password("alice")
        .trust(pin(broker))
        .link(Duration::from_secs(60))
        .reconnect(quick)
}

/// The door through which alice has come, as the hub sees it.
async fn door(broker: &Broker) -> (String, bool) {
    let operator = Client::builder(format!("bins://{}", broker.local_addr())).trust(pin(broker));
    let operator = operator
        .user("carol")
        .password("carol")
        .no_reconnect()
        .connect()
        .await;
    let stats = operator
        .expect("an operator of the lab")
        .stats("/")
        .await
        .expect("she may");
    let alice = stats
        .peers
        .into_iter()
        .find(|peer| peer.peer == "alice")
        .expect("she is here");
    (alice.door, alice.tls)
}

async fn hub() -> Broker {
    lab::start_with(|config| config.tls = tls::of_hub()).await
}

/// A network whose first connection ends so.
async fn first_fails(broker: &Broker, end: End) -> FaultyNetwork {
    let fault = move |number| Fault {
        end: if number == 0 { end } else { End::Whole },
        ..Fault::default()
    };
    FaultyNetwork::to(broker.local_addr(), fault).await
}

/// The first door does not answer: the next one is tried a moment later. A password goes through none without TLS.
#[tokio::test]
async fn a_door_that_says_nothing_holds_nobody_up() {
    let broker = hub().await;
    let network = first_fails(&broker, End::Frozen(0)).await;
    let alice = timeout(PATIENCE, builder(ELSEWHERE, &network, &broker).connect()).await;
    let alice = alice.expect("in time").expect("a user of the lab");
    assert_eq!(door(&broker).await, ("websocket".to_owned(), true));
    alice.close().await;
    broker.stop().await;
}

/// What has worked is tried first when the connection is lost, and the link goes on.
#[tokio::test]
async fn a_door_that_has_worked_is_remembered() {
    let broker = hub().await;
    let network = first_fails(&broker, End::Reset(0)).await;
    let alice = builder("127.0.0.1", &network, &broker)
        .connect()
        .await
        .expect("by the second door");
    let came = network.came();
    assert_eq!(came, 2, "the first one is reset");
    let mut events = alice.channel("/chat").await.expect("anybody may").events();
    network.sever();
    let resumed = async { while !matches!(events.next().await, Some(Event::Resumed)) {} };
    timeout(PATIENCE, resumed).await.expect("it goes on");
    assert_eq!(network.came(), came + 1, "no other door was tried");
    alice.close().await;
    broker.stop().await;
}

/// A hub can be reached by another door than before: the same peer goes on.
#[tokio::test]
async fn the_link_goes_on_through_another_door() {
    let broker = hub().await;
    // The door that was used dies for good: what comes through it is cut at once.
    let (dead, is_dead) = tokio::sync::watch::channel(false);
    let network = FaultyNetwork::to(broker.local_addr(), move |number| Fault {
        end: match *is_dead.borrow() && number < 4 {
            true => End::Closed(0),
            false => End::Whole,
        },
        ..Fault::default()
    })
    .await;
    let alice = builder(ELSEWHERE, &network, &broker)
        .connect()
        .await
        .expect("a user of the lab");
    assert_eq!(door(&broker).await, ("tcp".to_owned(), true));
    let mut events = alice.channel("/chat").await.expect("anybody may").events();
    dead.send(true).expect("it is looked at");
    network.sever();
    let resumed = async { while !matches!(events.next().await, Some(Event::Resumed)) {} };
    timeout(PATIENCE, resumed).await.expect("it goes on");
    let (door, tls) = door(&broker).await;
    assert!(tls && door != "local", "{door}");
    assert_eq!(alice.name(), "alice");
    alice.close().await;
    broker.stop().await;
}
