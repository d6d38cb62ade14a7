//! The hub's clock: measured by pings, told to who asks, and by it the age of what arrives.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use mom_client::{Client, Code, Event, Family, Map, Parcel, Time, Value, WireError};

use crate::common::{Peer, local, logged_in, next, path};

const HOUR: i64 = 3_600_000_000;

/// The system's clock, so many µs ahead.
fn wall(ahead: i64) -> Time {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).expect("after 1970");
    Time::from_micros(i64::try_from(since.as_micros()).expect("before the year 9999") + ahead)
        .expect("a time")
}

fn stamps(received: Time, sent: Time) -> Map {
    Map::new().with("received", received).with("sent", sent)
}

impl Peer {
    /// Answers the quick pings of a client by a clock that is so many µs ahead.
    async fn measured(&mut self, ahead: i64, pings: usize) {
        for _ in 0..pings {
            let ping = self.hear_any().await.expect("a ping");
            assert!(
                ping.is(Family::Time, "ping") && ping.value().get("sent").is_some(),
                "{ping:?}"
            );
            let mut pong = Parcel::new(Family::Time, "pong").content(stamps(wall(ahead), wall(ahead)));
            pong.reference = ping.id;
            self.say(pong).await;
        }
    }

    /// Asks the client for its stamps; after the answer all that was said before has been taken in.
    async fn ask_stamps(&mut self, id: u64) -> (Time, Time) {
        let ping = Map::new().with("sent", wall(0));
        self.say(Parcel::new(Family::Time, "ping").id(id).content(ping))
            .await;
        loop {
            let pong = self.hear_any().await.expect("a pong");
            if pong.is(Family::Time, "pong") {
                assert_eq!(pong.reference, Some(id));
                let stamp = |key| pong.value().get(key).and_then(Value::as_time).expect("a stamp");
                return (stamp("received"), stamp("sent"));
            }
        }
    }
}

fn state(age: i64, error: Option<u64>, received: Time) -> Parcel {
    let mut parcel = Parcel::new(Family::Message, "state").context(path("/chat"));
    parcel.received = Some(received);
    parcel.age = Some(age);
    parcel.age_error = error;
    parcel
}

#[tokio::test]
async fn a_client_learns_the_hubs_clock_and_answers_by_its_own() {
    let (mut hub, builder) = local();
    let skew = Arc::new(AtomicI64::new(-HOUR));
    let mine = Arc::clone(&skew);
    let builder = builder.wall_clock(move || wall(mine.load(Ordering::Relaxed)));
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let clock = client.clock();
    assert_eq!(clock.now(), None, "nothing is known of the hub's clock yet");

    peer.measured(2 * HOUR, 4).await;
    let (received, sent) = peer.ask_stamps(7).await;
    let late = wall(-HOUR).micros() - sent.micros();
    assert!(
        received <= sent && (0..HOUR / 60).contains(&late),
        "{received} {sent}"
    );
    let (time, error) = clock.now().expect("four exchanges");
    let wrong = (time.micros() - wall(2 * HOUR).micros()).unsigned_abs();
    // Between the two readings of the clocks some time passes on a busy machine.
    assert!(
        wrong < 1_000_000 && error < Duration::from_secs(30),
        "{wrong} µs, ± {error:?}"
    );

    // A wall clock that is set anew is not what the hub's clock is counted by.
    skew.store(5 * HOUR, Ordering::Relaxed);
    let (time, _) = clock.now().expect("still");
    assert!((time.micros() - wall(2 * HOUR).micros()).abs() < 1_000_000);
    let (received, _) = peer.ask_stamps(8).await;
    assert!((received.micros() - wall(5 * HOUR).micros()).abs() < HOUR / 60);
}

#[tokio::test]
async fn ages_go_on_by_the_hubs_clock() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder.wall_clock(|| wall(-HOUR))).await;
    let clock = client.clock();
    let parcel = state(40_000, Some(300), wall(HOUR));
    assert_eq!(clock.age(&parcel), None);
    peer.measured(HOUR, 4).await;
    peer.ask_stamps(1).await;

    let second = 1_000_000;
    let age = clock
        .age(&state(40_000, Some(300), wall(HOUR - 2 * second)))
        .expect("an age");
    assert!((2_040_000..10 * second).contains(&age.micros), "{age:?}");
    let error = age.error_micros.expect("known at both ends");
    assert!(error >= 300 && age.at_most() == Some(age.duration() + Duration::from_micros(error)));

    let age = clock
        .age(&state(0, None, wall(HOUR - second)))
        .expect("since the hub had it");
    assert!(
        age.micros >= second && age.error().is_none() && age.at_most().is_none(),
        "{age:?}"
    );
    let mut unstamped = state(0, None, wall(HOUR));
    unstamped.received = None;
    assert_eq!(clock.age(&unstamped), None, "not from the hub");
}

#[tokio::test]
async fn what_is_over_is_not_handed_out() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let clock = client.clock();
    peer.measured(HOUR, 4).await;
    let (chat, ()) = tokio::join!(
        client.channel("/chat"),
        peer.joined("/chat", "channel", Map::new())
    );
    let chat = chat.expect("joined");
    let mut events = chat.events();

    let say = |name: &str, age, expires| {
        let mut parcel = state(age, Some(10), wall(HOUR));
        parcel.name = name.into();
        parcel.expires = expires;
        parcel
    };
    for parcel in [
        say("old", 700_000, Some(500)),
        say("without", 700_000, None),
        say("stop", 700_000, Some(500)),
        say("fresh", 700_000, Some(60_000)),
    ] {
        peer.say(parcel).await;
    }
    for expected in ["without", "stop", "fresh"] {
        match next(&mut events).await {
            Event::Message(parcel) => assert_eq!(parcel.name(), expected),
            other => panic!("{other:?} instead of {expected}"),
        }
    }
    assert_eq!(clock.expired(), 1);

    // What waited too long here is over as well.
    peer.say(say("soon over", 59_000, Some(60))).await;
    peer.say(say("last", 0, None)).await;
    peer.ask_stamps(5).await;
    let over = say("soon over", 59_000, Some(60));
    while !clock.is_expired(&over) {
        tokio::task::yield_now().await;
    }
    match next(&mut events).await {
        Event::Message(parcel) => assert_eq!(parcel.name(), "last"),
        other => panic!("{other:?}"),
    }
    assert_eq!((clock.expired(), events.try_next()), (2, None));
}

#[tokio::test]
async fn a_hub_without_stamps_is_asked_once_a_heartbeat() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let ping = peer.hear_any().await.expect("the first ping");
    let mut pong = Parcel::new(Family::Time, "pong").content(Map::new().with("received", wall(0)));
    pong.reference = ping.id;
    peer.say(pong).await;
    peer.ask_stamps(1).await;
    let lookup = async { client.lookup("/chat").await };
    let answer = async {
        // No other ping came before the request.
        let request = peer.hear_any().await.expect("a request");
        assert!(request.is(Family::Context, "lookup"), "{request:?}");
        peer.refuse(&request, &WireError::new(Code::DENIED, "no")).await;
    };
    let (refused, ()) = tokio::join!(lookup, answer);
    assert!(refused.is_err() && client.clock().now().is_none());
}

/// All clones of a client share its clock.
#[tokio::test]
async fn a_new_link_begins_anew() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    peer.measured(HOUR, 4).await;
    peer.ask_stamps(1).await;
    let clock = Client::clock(&client.clone());
    assert!(clock.now().is_some());
    peer.hang_up();
    let mut peer = hub.accept().await;
    peer.log_in("ally", Map::new()).await;
    peer.measured(-HOUR, 4).await;
    peer.ask_stamps(2).await;
    let (time, _) = clock.now().expect("of the new link");
    assert!((time.micros() - wall(-HOUR).micros()).abs() < HOUR / 60);
}
