//! Giving, asking, and what comes back.

use std::time::Duration;

use mom_client::{Code, Event, Given, Lapsed, Lost, Map, TokenGuard, WireError};

use crate::common::{Peer, next};
use crate::tokens::{TOKEN, grab, guarded_arm, released, settled, token};

fn grabbed(owner: &str, fence: i64) -> Map {
    Map::new()
        .with("owner", owner)
        .with("fence", fence)
        .with("lease", 180_000)
}

fn lapsed(what: &str, to: &str, reason: &str) -> Map {
    Map::new()
        .with("what", what)
        .with("by", "ally")
        .with("to", to)
        .with("reason", reason)
}

/// Offers to bob, for a minute or for good.
async fn offer(guard: &TokenGuard, peer: &mut Peer, delegated: bool) -> Given {
    let give = match delegated {
        true => guard.give("bob").time(Duration::from_secs(60)),
        false => guard.give("bob"),
    };
    let (given, ()) = tokio::join!(give, async {
        let request = peer.expect("token give /robot/token").await;
        peer.ok(&request, Map::new().with("within", 10_000)).await;
    });
    given.unwrap()
}

/// Bob accepts: he owns it with fence 8.
async fn taken(peer: &mut Peer) {
    peer.event("released", TOKEN, released("given", "bob", 7)).await;
    peer.event("grabbed", TOKEN, grabbed("bob", 8)).await;
}

/// Bob's ownership ends so.
async fn ended(peer: &mut Peer, reason: &str, by: &str) {
    let content = Map::new()
        .with("owner", "bob")
        .with("reason", reason)
        .with("by", by)
        .with("fence", 8);
    peer.event("released", TOKEN, content).await;
}

fn lost(reason: &str, by: Option<&str>) -> Lost {
    Lost {
        reason: reason.to_owned(),
        by: by.map(str::to_owned),
    }
}

/// Who is put out of a token's place hears nothing more of it, so nobody there waits for its return.
#[tokio::test]
async fn who_is_put_out_does_not_get_back_what_it_has_lent() {
    for path in [TOKEN, "/robot"] {
        let (client, token, mut peer) = token().await;
        let guard = grab(&token, &mut peer, 7, 180_000).await;
        let mut given = offer(&guard, &mut peer, true).await;
        taken(&mut peer).await;
        given.accepted().await.unwrap();
        let expelled = Map::new().with("peer", client.name()).with("by", "carol");
        peer.event("expelled", path, expelled).await;
        assert_eq!(
            given.returned().await.unwrap_err(),
            lost("revoked", Some("carol")),
            "{path}"
        );
    }
}

#[tokio::test]
async fn an_offer_says_to_whom_and_for_what() {
    let (_client, token, mut peer) = token().await;
    let guard = grab(&token, &mut peer, 7, 180_000).await;
    let give = guard
        .give("bob")
        .within(Duration::from_micros(1500))
        .time(Duration::from_secs(60))
        .commands(5);
    let no_such = WireError::new(Code::UNKNOWN_PEER, "no bob is here");
    let (refused, ()) = tokio::join!(give, async {
        let request = peer.expect("token give /robot/token").await;
        let expected = Map::new()
            .with("to", "bob")
            .with("within", 2)
            .with("for", 60_000)
            .with("commands", 5);
        assert_eq!(request.value(), expected.into());
        peer.refuse(&request, &no_such).await;
    });
    assert_eq!(refused.unwrap_err().wire(), Some(&no_such));
    assert!(!guard.is_lost());
}

#[tokio::test]
async fn what_is_given_for_good_is_lost() {
    let (client, token, mut peer) = token().await;
    let mut guard = grab(&token, &mut peer, 7, 180_000).await;
    let mut given = offer(&guard, &mut peer, false).await;
    settled(&client, &mut peer).await;
    assert!(!guard.is_lost(), "bob has not answered");
    taken(&mut peer).await;
    given.accepted().await.unwrap();
    assert_eq!(guard.lost().await, lost("given", Some("bob")));
    assert_eq!(given.returned().await.unwrap_err(), lost("given", Some("bob")));
    drop(guard);
    settled(&client, &mut peer).await;
}

#[tokio::test(start_paused = true)]
async fn what_is_given_for_a_time_comes_back_and_is_renewed_again() {
    // The hub names the way in which the other's ownership ended.
    for (reason, by) in [("returned", "bob"), ("disconnected", ""), ("expired", "")] {
        let (client, token, mut peer) = token().await;
        let guard = grab(&token, &mut peer, 7, 180_000).await;
        let mut given = offer(&guard, &mut peer, true).await;
        assert_eq!(given.to(), "bob");
        taken(&mut peer).await;
        given.accepted().await.unwrap();
        assert!(guard.is_lost());
        drop(guard);
        settled(&client, &mut peer).await;
        ended(&mut peer, reason, by).await;
        peer.event("grabbed", TOKEN, grabbed("ally", 9).with("deadman", 6000))
            .await;
        let guard = given.returned().await.unwrap();
        assert_eq!(
            (guard.fence(), guard.deadman()),
            (9, Some(Duration::from_secs(6)))
        );
        peer.expect("token renew /robot/token").await;
        drop(guard);
        peer.expect("token release /robot/token").await;
    }
}

#[tokio::test]
async fn what_somebody_else_takes_from_the_other_does_not_come_back() {
    for (reason, next_owner, expected) in [
        ("preempted", Some("carol"), lost("preempted", Some("carol"))),
        ("broken", None, lost("broken", Some("carol"))),
        ("expired", Some("carol"), lost("expired", Some("carol"))),
    ] {
        let (_client, token, mut peer) = token().await;
        let guard = grab(&token, &mut peer, 7, 180_000).await;
        let given = offer(&guard, &mut peer, true).await;
        taken(&mut peer).await;
        ended(&mut peer, reason, "carol").await;
        if let Some(owner) = next_owner {
            peer.event("grabbed", TOKEN, grabbed(owner, 9)).await;
        }
        assert_eq!(given.returned().await.unwrap_err(), expected);
    }
}

#[tokio::test]
async fn an_offer_that_comes_to_nothing_leaves_the_guard_as_it_is() {
    for reason in ["declined", "timed-out", "left"] {
        let (client, token, mut peer) = token().await;
        let guard = grab(&token, &mut peer, 7, 180_000).await;
        let mut given = offer(&guard, &mut peer, true).await;
        // These are about others.
        peer.event("lapsed", TOKEN, lapsed("offer", "carol", "declined"))
            .await;
        peer.event("lapsed", TOKEN, lapsed("request", "bob", "timed-out"))
            .await;
        settled(&client, &mut peer).await;
        peer.event("lapsed", TOKEN, lapsed("offer", "bob", reason)).await;
        let expected = Lapsed {
            to: "bob".to_owned(),
            reason: reason.to_owned(),
        };
        assert_eq!(given.accepted().await.unwrap_err(), expected);
        let same = given.returned().await.unwrap();
        assert_eq!((same.fence(), guard.is_lost()), (7, false));
        drop(guard);
        settled(&client, &mut peer).await;
        drop(same);
        peer.expect("token release /robot/token").await;
    }
}

#[tokio::test]
async fn an_offer_ends_with_the_ownership() {
    for link in [false, true] {
        let (_client, token, mut peer) = token().await;
        let guard = grab(&token, &mut peer, 7, 180_000).await;
        let mut given = offer(&guard, &mut peer, true).await;
        if link {
            peer.hang_up();
            assert_eq!(given.accepted().await.unwrap_err().reason, "disconnected");
            assert_eq!(given.returned().await.unwrap_err(), lost("disconnected", None));
            continue;
        }
        peer.event("released", TOKEN, released("preempted", "bob", 7))
            .await;
        peer.event("grabbed", TOKEN, grabbed("bob", 8)).await;
        peer.event("lapsed", TOKEN, lapsed("offer", "bob", "lost")).await;
        assert_eq!(given.accepted().await.unwrap_err().reason, "lost");
        assert_eq!(
            given.returned().await.unwrap_err(),
            lost("preempted", Some("bob"))
        );
    }
}

#[tokio::test]
async fn a_token_that_comes_back_to_nobody_is_released() {
    for dropped_before in [true, false] {
        let (client, token, mut peer) = token().await;
        let guard = grab(&token, &mut peer, 7, 180_000).await;
        let given = offer(&guard, &mut peer, true).await;
        taken(&mut peer).await;
        settled(&client, &mut peer).await;
        let mut kept = Some(given);
        if dropped_before {
            drop(kept.take());
            settled(&client, &mut peer).await;
        }
        ended(&mut peer, "returned", "bob").await;
        peer.event("grabbed", TOKEN, grabbed("ally", 9)).await;
        if !dropped_before {
            settled(&client, &mut peer).await;
            drop(kept);
        }
        peer.expect("token release /robot/token").await;
        settled(&client, &mut peer).await;
    }
}

#[tokio::test]
async fn an_offer_is_accepted_or_declined() {
    let (client, token, mut peer) = token().await;
    let mut events = token.events();
    let offer = Map::new()
        .with("by", "carol")
        .with("to", "ally")
        .with("level", 5)
        .with("within", 10_000)
        .with("fence", 3)
        .with("commands", 4);
    peer.event("offer", TOKEN, offer).await;
    let Event::Offer { by, to, commands, .. } = next(&mut events).await else {
        panic!("an offer")
    };
    assert_eq!((by.as_str(), to.as_str(), commands), ("carol", "ally", Some(4)));
    let (guard, ()) = tokio::join!(token.accept(), async {
        let request = peer.expect("token accept /robot/token").await;
        assert_eq!(request.content, None);
        let granted = grabbed("ally", 4).with("from", "carol").with("commands", 4);
        peer.event("grabbed", TOKEN, granted.clone()).await;
        peer.ok(&request, granted).await;
    });
    let guard = guard.unwrap();
    let delegation = guard.delegation().unwrap();
    assert_eq!(
        (guard.fence(), delegation.from.as_str(), delegation.commands),
        (4, "carol", Some(4))
    );
    drop(guard);
    peer.expect("token release /robot/token").await;

    let (declined, ()) = tokio::join!(token.decline(), async {
        let request = peer.expect("token decline /robot/token").await;
        peer.refuse(&request, &WireError::new(Code::NO_OFFER, "none"))
            .await;
    });
    assert_eq!(declined.unwrap_err().code(), Some(&Code::NO_OFFER));
    settled(&client, &mut peer).await;
}

#[tokio::test(start_paused = true)]
async fn an_owner_is_asked_and_has_the_time_that_it_was_given() {
    let (_client, token, mut peer) = token().await;
    let ask = token.request().within(Duration::from_secs(50)).text("the cup");
    let (guard, ()) = tokio::join!(ask, async {
        let request = peer.expect("token request /robot/token").await;
        let expected = Map::new().with("within", 50_000).with("text", "the cup");
        assert_eq!(request.value(), expected.into());
        tokio::time::sleep(Duration::from_secs(89)).await; // tidy: moves the paused clock
        peer.ok(&request, grabbed("ally", 8)).await;
    });
    assert_eq!(guard.unwrap().fence(), 8);
    peer.expect("token release /robot/token").await;

    let (refused, ()) = tokio::join!(token.request(), async {
        let request = peer.expect("token request /robot/token").await;
        peer.refuse(&request, &WireError::new(Code::DECLINED, "in a minute"))
            .await;
    });
    let error = refused.unwrap_err();
    assert_eq!(error.refusal().unwrap().to_string(), "in a minute");
}

#[tokio::test]
async fn an_owner_answers_who_asks() {
    let (client, token, mut peer) = token().await;
    let arm = guarded_arm(&client, &mut peer).await;
    let mut guard = grab(&token, &mut peer, 7, 180_000).await;
    let mut events = token.events();
    let asks = |name: &str| {
        Map::new()
            .with("peer", name)
            .with("user", "bob")
            .with("level", 1)
            .with("within", 30_000)
            .with("text", "please")
    };
    peer.event("requested", TOKEN, asks("bob~2")).await;
    let Event::Requested { member, text, .. } = next(&mut events).await else {
        panic!("a request")
    };
    assert_eq!((member.peer.as_str(), text.as_deref()), ("bob~2", Some("please")));
    let (declined, ()) = tokio::join!(token.decline_request("bob~2", "soon"), async {
        let request = peer.expect("token decline /robot/token").await;
        let expected = Map::new().with("peer", "bob~2").with("text", "soon");
        assert_eq!(request.value(), expected.into());
        peer.ok(&request, Map::new()).await;
    });
    declined.unwrap();
    // What was sent before goes before.
    arm.send("command", "grip open").await.unwrap();
    let (accepted, ()) = tokio::join!(token.accept_request("carol"), async {
        peer.expect("message command /robot/arm").await;
        let request = peer.expect("token accept /robot/token").await;
        assert_eq!(request.value(), Map::new().with("peer", "carol").into());
        peer.event("released", TOKEN, released("given", "carol", 7)).await;
        peer.ok(&request, Map::new()).await;
    });
    accepted.unwrap();
    assert_eq!(guard.lost().await, lost("given", Some("carol")));
}
