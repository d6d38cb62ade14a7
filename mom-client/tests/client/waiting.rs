//! Grabs that wait in the queue.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use mom_client::{ClientError, Code, ErrorKind, Map, Value, WireError};
use tokio::time::Instant;

use crate::common::Peer;
use crate::tokens::{TOKEN, grab, settled, token};

async fn queued(peer: &mut Peer, place: i64, expected: Option<i64>) {
    let mut content = Map::new().with("place", place);
    if let Some(expected) = expected {
        content.set("expected", expected);
    }
    peer.event("queued", TOKEN, content).await;
}

#[tokio::test(start_paused = true)]
async fn a_grab_waits_and_tells_its_places() {
    let (client, token, mut peer) = token().await;
    let mut places = Vec::new();
    let wait = token
        .grab()
        .wait(Duration::from_secs(30))
        .on_place(|place| places.push((place.place, place.expected)));
    let (guard, ()) = tokio::join!(wait, async {
        let request = peer.expect("token grab /robot/token").await;
        assert_eq!(request.value(), Map::new().with("wait", 30_000).into());
        queued(&mut peer, 2, Some(9000)).await;
        settled(&client, &mut peer).await;
        queued(&mut peer, 1, None).await;
        // Longer than any other request may take.
        tokio::time::sleep(Duration::from_secs(65)).await; // tidy: moves the paused clock
        peer.ok(&request, Map::new().with("fence", 7).with("lease", 9000))
            .await;
    });
    assert_eq!(guard.unwrap().fence(), 7);
    assert_eq!(places, [(2, Some(Duration::from_secs(9))), (1, None)]);
}

#[tokio::test(start_paused = true)]
async fn a_wait_in_vain_is_told_with_all_details() {
    let (_client, token, mut peer) = token().await;
    let late = WireError::new(Code::TIMED_OUT, "not within 30 s")
        .owner("bob", 1)
        .retry_after(Duration::from_secs(123))
        .detail("place", 1);
    let (refused, ()) = tokio::join!(token.grab().wait(Duration::from_secs(30)), async {
        let request = peer.expect("token grab /robot/token").await;
        queued(&mut peer, 1, None).await;
        peer.refuse(&request, &late).await;
    });
    let error = refused.unwrap_err();
    assert_eq!((error.kind(), error.wire()), (ErrorKind::Refused, Some(&late)));
    assert_eq!(
        error.refusal().unwrap().to_string(),
        "waited in vain: bob (level 1) holds it for 2 min 3 s more; you were 1st in the queue"
    );
}

#[tokio::test(start_paused = true)]
async fn an_endless_wait_is_bounded_only_until_the_hub_has_heard() {
    let (_client, token, mut peer) = token().await;
    let start = Instant::now();
    let (refused, request) = tokio::join!(token.grab().wait_forever(), async {
        peer.expect("token grab /robot/token").await
    });
    assert_eq!(request.value(), Map::new().with("wait", "unlimited").into());
    let ClientError::TimedOut { after, .. } = refused.unwrap_err() else {
        panic!("the hub says nothing")
    };
    assert_eq!((after, start.elapsed()), (Duration::from_secs(40), after));

    peer.refuse(&request, &WireError::new(Code::HELD, "too late"))
        .await;
    let (guard, ()) = tokio::join!(token.grab().wait_forever(), async {
        let request = peer.expect("token grab /robot/token").await;
        queued(&mut peer, 40, None).await;
        tokio::time::sleep(Duration::from_secs(3600)).await; // tidy: moves the paused clock
        peer.ok(&request, Map::new().with("fence", 7)).await;
    });
    assert_eq!(guard.unwrap().fence(), 7);
}

#[tokio::test]
async fn a_wait_that_is_given_up_leaves_the_queue() {
    let (client, token, mut peer) = token().await;
    let places = Arc::new(AtomicU64::new(0));
    let told = Arc::clone(&places);
    let wait = token
        .grab()
        .wait(Duration::from_secs(30))
        .on_place(move |place| told.store(place.place, Ordering::Relaxed));
    let request = tokio::select! {
        _ = wait => panic!("it is not granted"),
        request = async {
            let request = peer.expect("token grab /robot/token").await;
            queued(&mut peer, 3, None).await;
            settled(&client, &mut peer).await;
            request
        } => request,
    };
    assert_eq!(places.load(Ordering::Relaxed), 3);
    let release = peer.expect("token release /robot/token").await;
    peer.ok(&release, Map::new()).await;
    let withdrawn = WireError::new(Code::WITHDRAWN, "taken back");
    peer.refuse(&request, &withdrawn).await;
    settled(&client, &mut peer).await;
    // The next one has nothing to do with it.
    let guard = grab(&token, &mut peer, 8, 9000).await;
    assert!(!guard.is_lost());
}

#[tokio::test]
async fn what_is_granted_to_a_wait_given_up_is_given_back_once() {
    for granted_first in [false, true] {
        let (client, token, mut peer) = token().await;
        let request = tokio::select! {
            _ = token.grab().wait_forever() => panic!("it is not granted"),
            request = peer.expect("token grab /robot/token") => request,
        };
        // Given up before the hub said anything: `release` now might end another ownership.
        settled(&client, &mut peer).await;
        if !granted_first {
            queued(&mut peer, 1, None).await;
            peer.expect("token release /robot/token").await;
        }
        peer.ok(&request, Map::new().with("fence", 7).with("lease", Value::Null))
            .await;
        if granted_first {
            peer.expect("token release /robot/token").await;
        }
        settled(&client, &mut peer).await;
    }
}

#[tokio::test]
async fn a_guard_does_not_wait_for_a_token_that_it_has() {
    let (client, token, mut peer) = token().await;
    let one = grab(&token, &mut peer, 7, 180_000).await;
    let (two, ()) = tokio::join!(token.grab().wait(Duration::from_secs(1)), async {
        let request = peer.expect("token grab /robot/token").await;
        peer.ok(&request, Map::new().with("fence", 7).with("lease", 180_000))
            .await;
    });
    drop(two.unwrap());
    settled(&client, &mut peer).await;
    assert!(!one.is_lost());
}

#[tokio::test]
async fn a_lost_link_ends_the_wait() {
    let (_client, token, mut peer) = token().await;
    let (refused, ()) = tokio::join!(token.grab().wait_forever(), async {
        peer.expect("token grab /robot/token").await;
        queued(&mut peer, 1, None).await;
        peer.hang_up();
    });
    assert_eq!(refused.unwrap_err().kind(), ErrorKind::Connection);
}
