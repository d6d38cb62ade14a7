//! Grabbing, renewing, losing and giving back.

use std::time::Duration;

use mom_client::{
    After, Channel, Client, ClientError, Code, ErrorKind, Lost, Map, Token, TokenGuard, WireError,
};
use tokio::time::Instant;

use crate::common::{Peer, local, logged_in_with};

pub(crate) const TOKEN: &str = "/robot/token";

pub(crate) async fn token() -> (Client, Token, Peer) {
    let (mut hub, builder) = local();
    // So long that no heartbeat mixes with the renewals.
    let limits = Map::new().with("heartbeat", 10_000_000).with("gone", 30_000_000);
    let (client, mut peer) = logged_in_with(&mut hub, builder, limits).await;
    let (token, ()) = tokio::join!(client.token(TOKEN), peer.joined(TOKEN, "token", Map::new()));
    // Nobody else connects to this hub.
    drop(hub);
    (client, token.unwrap(), peer)
}

pub(crate) async fn grab(token: &Token, peer: &mut Peer, fence: i64, lease: i64) -> TokenGuard {
    let (guard, ()) = tokio::join!(token.grab(), peer.granted(TOKEN, fence, lease));
    guard.unwrap()
}

/// The channel whose commands need that token.
pub(crate) async fn guarded_arm(client: &Client, peer: &mut Peer) -> Channel {
    let guard = Map::new()
        .with("token", TOKEN)
        .with("names", vec!["command".into()]);
    let (arm, ()) = tokio::join!(
        client.channel("/robot/arm"),
        peer.join_one("/robot/arm", "channel", Map::new().with("guard", guard))
    );
    arm.unwrap()
}

/// Waits until the client has handled all that the hub said.
pub(crate) async fn settled(client: &Client, peer: &mut Peer) {
    let (answer, ()) = tokio::join!(client.info("/settled"), async {
        let request = peer.expect("context info /settled").await;
        peer.ok(&request, Map::new()).await;
    });
    answer.unwrap();
}

pub(crate) fn released(reason: &str, by: &str, fence: i64) -> Map {
    Map::new()
        .with("owner", "ally")
        .with("reason", reason)
        .with("by", by)
        .with("fence", fence)
}

#[tokio::test]
async fn a_grab_gives_fence_and_lease_or_says_who_drives() {
    let (_client, token, mut peer) = token().await;
    let guard = grab(&token, &mut peer, 7, 180_000).await;
    assert_eq!(
        (guard.fence(), guard.lease(), guard.is_lost()),
        (7, Some(Duration::from_secs(180)), false)
    );
    let (freed, ()) = tokio::join!(guard.release(), async {
        let request = peer.expect("token release /robot/token").await;
        assert_eq!(request.fence, Some(7), "no later ownership");
        peer.ok(&request, Map::new()).await;
    });
    freed.unwrap();

    let held = WireError::new(Code::HELD, "bob drives")
        .owner("bob", 1)
        .retry_after(Duration::from_secs(9));
    let (refused, ()) = tokio::join!(token.grab(), async {
        let request = peer.expect("token grab /robot/token").await;
        peer.refuse(&request, &held).await;
    });
    assert_eq!(refused.unwrap_err().wire(), Some(&held));

    let (endless, ()) = tokio::join!(token.grab(), async {
        let request = peer.expect("token grab /robot/token").await;
        peer.ok(
            &request,
            Map::new().with("fence", 8).with("lease", mom_client::Value::Null),
        )
        .await;
    });
    assert_eq!(endless.unwrap().lease(), None);
}

#[tokio::test]
async fn a_dropped_guard_gives_back_without_a_runtime() {
    let (client, token, mut peer) = token().await;
    let arm = guarded_arm(&client, &mut peer).await;
    let guard = grab(&token, &mut peer, 7, 180_000).await;
    arm.send("command", "grip open").await.unwrap();
    std::thread::spawn(move || drop(guard)).join().unwrap();
    peer.expect("message command /robot/arm").await;
    let release = peer.expect("token release /robot/token").await;
    assert_eq!(release.fence, Some(7));
    // Its answer is nobody's, and the token is still joined.
    settled(&client, &mut peer).await;
}

/// The hub answers in order: what was said under the token is taken or refused when it answers for the renewal.
#[tokio::test]
async fn a_release_may_wait_for_the_hub() {
    let (client, token, mut peer) = token().await;
    let arm = guarded_arm(&client, &mut peer).await;
    let guard = grab(&token, &mut peer, 7, 180_000).await;
    arm.message("command").priority(-9).send().await.unwrap();
    let (freed, ()) = tokio::join!(guard.release_after(After::Taken, Duration::from_secs(9)), async {
        peer.expect("message command /robot/arm").await;
        let renew = peer.expect("token renew /robot/token").await;
        settled(&client, &mut peer).await;
        peer.ok(&renew, Map::new()).await;
        let request = peer.expect("token release /robot/token").await;
        peer.ok(&request, Map::new()).await;
    });
    freed.unwrap();
}

/// The device says how a command of this peer goes.
async fn tell(device: &mut Peer, id: Option<u64>, peer: &str, state: &str) {
    let id = i64::try_from(id.expect("every message has one")).expect("small");
    let status = Map::new().with("peer", peer).with("id", id).with("state", state);
    device.message("status", "/robot/arm", status).await;
}

/// The last of several commands decides; how the others end, and what other peers are told, does not.
#[tokio::test]
async fn a_release_may_wait_for_the_last_command() {
    let (client, token, mut peer) = token().await;
    let arm = guarded_arm(&client, &mut peer).await;
    for end in ["finished", "error", "refused"] {
        let guard = grab(&token, &mut peer, 7, 180_000).await;
        arm.send("command", "grip open").await.unwrap();
        arm.send("command", "grip close").await.unwrap();
        let (freed, ()) = tokio::join!(guard.release_after(After::Done, Duration::from_secs(9)), async {
            let first = peer.expect("message command /robot/arm").await;
            let last = peer.expect("message command /robot/arm").await;
            let renew = peer.expect("token renew /robot/token").await;
            peer.ok(&renew, Map::new()).await;
            for (id, name, state) in [
                (first.id, "ally", "finished"),
                (last.id, "ally", "executing"),
                (last.id, "bob", "finished"),
            ] {
                tell(&mut peer, id, name, state).await;
            }
            settled(&client, &mut peer).await;
            match end {
                "refused" => {
                    let refusal = WireError::new(Code::NOT_OWNER, "too late");
                    peer.refuse(&last, &refusal).await;
                }
                state => tell(&mut peer, last.id, "ally", state).await,
            }
            let request = peer.expect("token release /robot/token").await;
            peer.ok(&request, Map::new()).await;
        });
        freed.unwrap();
    }
}

#[tokio::test(start_paused = true)]
async fn a_release_waits_for_the_hub_no_longer_than_it_may() {
    let (_client, token, mut peer) = token().await;
    let guard = grab(&token, &mut peer, 7, 180_000).await;
    let begin = Instant::now();
    let (late, ()) = tokio::join!(guard.release_after(After::Taken, Duration::from_secs(2)), async {
        peer.expect("token renew /robot/token").await;
        let request = peer.expect("token release /robot/token").await;
        assert_eq!(begin.elapsed().as_secs(), 2);
        peer.ok(&request, Map::new()).await;
    });
    assert_eq!(late.unwrap_err().kind(), ErrorKind::TimedOut);
    let mut guard = grab(&token, &mut peer, 8, 180_000).await;
    peer.event("released", TOKEN, released("preempted", "bob", 8))
        .await;
    guard.lost().await;
    guard
        .release_after(After::Taken, Duration::from_secs(2))
        .await
        .unwrap();
}

#[tokio::test]
async fn guards_of_one_ownership_share_it() {
    let (client, token, mut peer) = token().await;
    let one = grab(&token, &mut peer, 7, 180_000).await;
    let two = grab(&token, &mut peer, 7, 180_000).await;
    drop(one);
    settled(&client, &mut peer).await;
    assert!(!two.is_lost());
    drop(two);
    peer.expect("token release /robot/token").await;
}

#[tokio::test]
async fn a_guard_dropped_while_another_is_asked_for_does_not_give_back() {
    let denied = WireError::new(Code::DENIED, "not twice");
    for (refusal, told) in [(None, "kept"), (Some(denied), "given back")] {
        let (client, token, mut peer) = token().await;
        let one = grab(&token, &mut peer, 7, 180_000).await;
        let (two, ()) = tokio::join!(token.grab(), async {
            let request = peer.expect("token grab /robot/token").await;
            drop(one);
            match &refusal {
                None => {
                    let lease = Map::new().with("fence", 7).with("lease", 180_000);
                    peer.ok(&request, lease).await;
                }
                Some(refusal) => peer.refuse(&request, refusal).await,
            }
        });
        if told == "given back" {
            peer.expect("token release /robot/token").await;
        }
        settled(&client, &mut peer).await;
        assert_eq!(two.is_ok(), told == "kept");
    }
}

#[tokio::test(start_paused = true)]
async fn a_lease_is_renewed_at_a_third_of_it() {
    let (_client, token, mut peer) = token().await;
    let start = Instant::now();
    let guard = grab(&token, &mut peer, 7, 180_000).await;
    for (at, lease) in [(60, 90_000), (90, 90_000), (120, 30_000), (130, 30_000)] {
        let renew = peer.expect("token renew /robot/token").await;
        assert_eq!(start.elapsed().as_secs(), at);
        peer.ok(&renew, Map::new().with("fence", 7).with("lease", lease))
            .await;
    }
    assert!(!guard.is_lost());
    assert_eq!(guard.lease(), Some(Duration::from_secs(30)));
}

#[tokio::test(start_paused = true)]
async fn a_deadman_time_shorter_than_the_lease_is_fed_at_a_third_of_it() {
    let (_client, token, mut peer) = token().await;
    let start = Instant::now();
    let (guard, ()) = tokio::join!(token.grab(), async {
        let request = peer.expect("token grab /robot/token").await;
        let terms = Map::new().with("fence", 7).with("lease", 180_000);
        peer.ok(&request, terms.with("deadman", 6000)).await;
    });
    let guard = guard.unwrap();
    assert_eq!(
        (guard.lease(), guard.deadman()),
        (Some(Duration::from_secs(180)), Some(Duration::from_secs(6)))
    );
    for (at, terms) in [
        (2, Map::new().with("lease", 3000).with("deadman", 6000)),
        // Without a lease, as with the hub's null, the deadman time alone counts.
        (3, Map::new().with("deadman", 9000)),
        (6, Map::new().with("lease", 30_000)),
        (16, Map::new().with("lease", 30_000)),
    ] {
        let renew = peer.expect("token renew /robot/token").await;
        assert_eq!(start.elapsed().as_secs(), at);
        peer.ok(&renew, terms.with("fence", 7)).await;
    }
    assert_eq!(guard.deadman(), None);
}

#[tokio::test(start_paused = true)]
async fn a_renewal_that_may_pass_later_is_tried_again() {
    let (client, token, mut peer) = token().await;
    let start = Instant::now();
    let guard = grab(&token, &mut peer, 7, 180_000).await;
    let renew = peer.expect("token renew /robot/token").await;
    let busy = WireError::new(Code::TRY_LATER, "busy").retry_after(Duration::from_secs(5));
    peer.refuse(&renew, &busy).await;
    // This one is never answered.
    peer.expect("token renew /robot/token").await;
    assert_eq!(start.elapsed().as_secs(), 65);
    peer.expect("token renew /robot/token").await;
    assert_eq!(start.elapsed().as_secs(), 125);
    settled(&client, &mut peer).await;
    assert!(!guard.is_lost());
}

#[tokio::test(start_paused = true)]
async fn a_refused_renewal_is_a_loss() {
    for (error, by, gives_back) in [
        (
            WireError::new(Code::NOT_OWNER, "bob drives").owner("bob", 1),
            Some("bob"),
            false,
        ),
        (WireError::new(Code::DENIED, "the lab is closed"), None, true),
    ] {
        let (client, token, mut peer) = token().await;
        let mut guard = grab(&token, &mut peer, 7, 180_000).await;
        let renew = peer.expect("token renew /robot/token").await;
        peer.refuse(&renew, &error).await;
        let lost = guard.lost().await;
        assert_eq!(
            (lost.reason.as_str(), lost.by.as_deref()),
            (error.code.word(), by)
        );
        if gives_back {
            peer.expect("token release /robot/token").await;
        }
        drop(guard);
        settled(&client, &mut peer).await;
    }
}

#[tokio::test(start_paused = true)]
async fn a_loss_is_told_with_its_reason_and_ends_the_renewals() {
    for (name, content, expected) in [
        (
            "released",
            released("preempted", "carol", 7),
            Some(("preempted", Some("carol"))),
        ),
        (
            "released",
            released("expired", "bob", 7),
            Some(("expired", Some("bob"))),
        ),
        (
            "grabbed",
            Map::new().with("owner", "bob").with("fence", 8),
            Some(("grabbed", Some("bob"))),
        ),
        ("released", released("preempted", "carol", 6), None),
        ("grabbed", Map::new().with("owner", "ally").with("fence", 7), None),
    ] {
        let (client, token, mut peer) = token().await;
        let mut guard = grab(&token, &mut peer, 7, 180_000).await;
        peer.event(name, TOKEN, content).await;
        settled(&client, &mut peer).await;
        assert_eq!(guard.is_lost(), expected.is_some(), "{name} {expected:?}");
        let Some((reason, by)) = expected else { continue };
        let lost = Lost {
            reason: reason.to_owned(),
            by: by.map(str::to_owned),
        };
        assert_eq!(guard.lost().await, lost);
        tokio::time::sleep(Duration::from_secs(200)).await; // tidy: moves the paused clock
        // Neither renewed meanwhile nor given back now.
        guard.release().await.unwrap();
        settled(&client, &mut peer).await;
    }
}

#[tokio::test]
async fn a_loss_right_after_the_grant_is_not_missed() {
    let (_client, token, mut peer) = token().await;
    let (guard, ()) = tokio::join!(token.grab(), async {
        peer.granted(TOKEN, 7, 180_000).await;
        peer.event("released", TOKEN, released("preempted", "carol", 7))
            .await;
    });
    assert_eq!(guard.unwrap().lost().await.reason, "preempted");
}

#[tokio::test(start_paused = true)]
async fn a_grab_that_nobody_waits_for_is_given_back() {
    let (client, token, mut peer) = token().await;
    let ClientError::TimedOut { what, .. } = token.grab().await.unwrap_err() else {
        panic!("no answer came")
    };
    assert_eq!(what, "token grab /robot/token");
    peer.granted(TOKEN, 7, 180_000).await;
    peer.expect("token release /robot/token").await;
    settled(&client, &mut peer).await;
}

#[tokio::test]
async fn a_lost_link_is_a_lost_token() {
    let (_client, token, mut peer) = token().await;
    let mut guard = grab(&token, &mut peer, 7, 180_000).await;
    peer.hang_up();
    let lost = guard.lost().await;
    assert_eq!((lost.reason.as_str(), lost.by), ("disconnected", None));
}
