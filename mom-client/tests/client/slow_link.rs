//! A link that takes nothing for a while.

use mom_client::{Code, Delivery, ErrorKind, Event, Family, Map, Parcel};
use mom_proto::Time;

use crate::common::{local, logged_in, next, path};

/// Of states the newest is worth sending: it takes the place of what has not left, and the sender hears how many did not.
#[tokio::test]
async fn the_newest_state_takes_the_place_of_older_ones() {
    const STATES: i64 = 500;
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let (arm, ()) = tokio::join!(client.channel("/arm"), peer.joined("/arm", "channel", Map::new()));
    let arm = arm.unwrap();
    let mut events = arm.events();
    // The hub reads nothing meanwhile.
    for number in 0..STATES {
        let state = arm.message("state").content(number);
        state.delivery(Delivery::Latest).send().await.unwrap();
        tokio::task::yield_now().await;
    }
    let mut heard = Vec::new();
    while heard.last() != Some(&(STATES - 1)) {
        heard.push(peer.expect("message state /arm").await.value().as_int().unwrap());
    }
    assert!(heard.is_sorted() && heard.len() < 200, "{heard:?}");
    let mut replaced = 0;
    while replaced + heard.len() < usize::try_from(STATES).unwrap() {
        let Event::Dropped {
            reason,
            count,
            parcel,
        } = next(&mut events).await
        else {
            panic!("nothing else has happened")
        };
        assert_eq!((&*reason, parcel.context), ("replaced", Some(path("/arm"))));
        replaced += usize::try_from(count).unwrap();
    }
}

/// What is over is not sent: who waits for its answer gets an error, all others hear `dropped`.
#[tokio::test]
async fn what_is_over_is_not_sent() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let (arm, ()) = tokio::join!(client.channel("/arm"), peer.joined("/arm", "channel", Map::new()));
    let arm = arm.unwrap();
    let mut events = arm.events();
    let old = |name: &str| {
        let mut parcel = Parcel::new(Family::Message, name).context(path("/arm"));
        (parcel.timestamp, parcel.expires) = (Time::from_micros(0), Some(1000));
        parcel
    };
    client.send(old("step")).await.unwrap();
    let error = client.request(old("step")).await.unwrap_err();
    assert_eq!(
        (error.kind(), error.code()),
        (ErrorKind::Local, Some(&Code::EXPIRED))
    );
    let Event::Dropped { reason, count, .. } = next(&mut events).await else {
        panic!("the first of the two")
    };
    assert_eq!((&*reason, count), ("expired", 1));
    arm.send("chat", "still there").await.unwrap();
    peer.expect("message chat /arm").await;
}
