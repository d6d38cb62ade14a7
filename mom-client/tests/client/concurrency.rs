//! Many tasks on one client, and a link that takes nothing.

use std::collections::BTreeMap;
use std::time::Duration;

use mom_client::{Event, Family, Map, Parcel};
use tokio::time::timeout;

use crate::common::{Peer, local, logged_in, next, path, words};

/// Answers everything, and checks that joins and leaves, grabs and releases take turns.
async fn serve(mut peer: Peer) -> u64 {
    let mut inside: BTreeMap<String, bool> = BTreeMap::new();
    let mut fence = 0;
    while let Some(parcel) = peer.hear_any().await {
        let context = parcel
            .context
            .as_ref()
            .map(ToString::to_string)
            .unwrap_or_default();
        let turn = match parcel.name() {
            "join" => Some((context.clone(), true)),
            "leave" => Some((context.clone(), false)),
            // Grabbing again is renewing, so only what follows a release is a new ownership.
            "grab" => {
                fence += u64::from(inside.insert(format!("token {context}"), true) != Some(true));
                None
            }
            "release" => Some((format!("token {context}"), false)),
            _ => None,
        };
        if let Some((what, now)) = turn {
            let before = inside.insert(what, now).unwrap_or(false);
            assert_ne!(before, now, "{} out of turn", words(&parcel));
        }
        let kind = match context.as_str() {
            "/robot" => "session",
            "/robot/token" => "token",
            _ => "channel",
        };
        let content = Map::new()
            .with("path", context.as_str())
            .with("kind", kind)
            .with("number", 1)
            .with("fence", i64::try_from(fence).unwrap())
            .with("lease", 180_000);
        if parcel.name() == "logout" {
            return fence;
        }
        peer.ok(&parcel, content).await;
    }
    fence
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn proxies_of_many_tasks_take_turns_at_the_hub() {
    let (mut hub, builder) = local();
    let (client, peer) = logged_in(&mut hub, builder).await;
    let server = tokio::spawn(serve(peer));
    let tasks = (0..8).map(|task| {
        let client = client.clone();
        tokio::spawn(async move {
            for turn in 0..50 {
                let arm = client.channel("/robot/arm").await.unwrap();
                let events = arm.events();
                drop(arm);
                if (task + turn) % 3 == 0 {
                    let token = client.token("/robot/token").await.unwrap();
                    let guard = token.grab().await.unwrap();
                    drop(token);
                    assert!(guard.fence() > 0);
                }
                drop(events);
            }
        })
    });
    for task in tasks.collect::<Vec<_>>() {
        task.await.unwrap();
    }
    client.close().await;
    assert!(server.await.unwrap() > 0, "the token was held");
}

#[tokio::test(start_paused = true)]
async fn a_blocked_link_stops_neither_reading_nor_control() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let mut others = client.unaddressed();
    let send = || client.send(Parcel::new(Family::Message, "state").context(path("/chat")));
    let mut sent = 0;
    // Time stands still while anything can go on, so this ends when the queue is full.
    while let Ok(result) = timeout(Duration::from_millis(1), send()).await {
        result.unwrap();
        sent += 1;
    }
    assert!(sent > 4096, "{sent}");

    peer.message("chat", "/chat", "still heard").await;
    assert!(matches!(next(&mut others).await, Event::Message(_)));

    let (info, before) = tokio::join!(client.info("/"), async {
        let mut before = 0;
        loop {
            let parcel = peer.hear().await;
            if parcel.is(Family::Context, "info") {
                peer.ok(&parcel, Map::new()).await;
                return before;
            }
            before += 1;
        }
    });
    info.unwrap();
    assert!(before < sent / 2, "{before} of {sent} messages went before");
    timeout(Duration::from_secs(1), send()).await.unwrap().unwrap();
}
