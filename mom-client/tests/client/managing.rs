//! Shared holds, breaking, inviting, expelling, and the hub's questions.

use std::time::Duration;

use mom_client::{Client, Code, ContextKind, Event, Family, Lost, Map, Parcel, WireError};

use crate::common::{Peer, local, logged_in, next, path};
use crate::tokens::{TOKEN, grab, released, settled, token};

fn holders(names: &[&str]) -> Vec<mom_client::Value> {
    names.iter().map(|name| (*name).into()).collect()
}

#[tokio::test]
async fn a_part_in_a_shared_hold_lasts_as_long_as_its_guards() {
    let (client, token, mut peer) = token().await;
    let mut parts = Vec::new();
    for _ in 0..2 {
        let (part, ()) = tokio::join!(token.inhibit(), async {
            let request = peer.expect("token inhibit /robot/token").await;
            peer.ok(&request, Map::new().with("holders", holders(&["ally"])))
                .await;
        });
        parts.push(part.unwrap());
    }
    drop(parts.pop());
    settled(&client, &mut peer).await;
    let last = parts.pop().unwrap();
    assert!(!last.is_lost());
    let (ended, ()) = tokio::join!(last.release(), async {
        let request = peer.expect("token uninhibit /robot/token").await;
        peer.ok(&request, Map::new()).await;
    });
    ended.unwrap();

    let (part, ()) = tokio::join!(token.inhibit(), async {
        let request = peer.expect("token inhibit /robot/token").await;
        peer.ok(&request, Map::new()).await;
    });
    drop(part);
    peer.expect("token uninhibit /robot/token").await;
}

#[tokio::test]
async fn an_owner_that_inhibits_owns_no_more() {
    let (_client, token, mut peer) = token().await;
    let mut guard = grab(&token, &mut peer, 7, 180_000).await;
    let mut events = token.events();
    let (part, ()) = tokio::join!(token.inhibit(), async {
        let request = peer.expect("token inhibit /robot/token").await;
        peer.event("released", TOKEN, released("released", "ally", 7))
            .await;
        let told = Map::new()
            .with("peer", "ally")
            .with("holders", holders(&["ally"]));
        peer.event("inhibited", TOKEN, told).await;
        peer.ok(&request, Map::new()).await;
    });
    assert_eq!(guard.lost().await.reason, "released");
    assert!(matches!(next(&mut events).await, Event::Released { .. }));
    let inhibited = Event::Inhibited {
        peer: "ally".to_owned(),
        holders: vec!["ally".to_owned()],
        path: path(TOKEN),
    };
    assert_eq!(next(&mut events).await, inhibited);

    // Another's part that ends is not ours.
    let mut part = part.unwrap();
    for (who, reason) in [("bob", "left"), ("ally", "broken")] {
        assert!(!part.is_lost());
        let told = Map::new().with("peer", who).with("reason", reason);
        peer.event("uninhibited", TOKEN, told.with("holders", holders(&[])))
            .await;
        assert!(matches!(next(&mut events).await, Event::Uninhibited { peer, .. } if peer == who));
    }
    let broken = Lost {
        reason: "broken".to_owned(),
        by: None,
    };
    assert_eq!(part.lost().await, broken);
    // It needs no end.
    part.release().await.unwrap();
}

#[tokio::test]
async fn a_hold_is_broken_by_who_may() {
    let (_client, token, mut peer) = token().await;
    let denied = WireError::new(Code::DENIED, "only the chair").rule("lab");
    let (refused, ()) = tokio::join!(token.break_hold(), async {
        let request = peer.expect("token break /robot/token").await;
        peer.refuse(&request, &denied).await;
    });
    assert_eq!(refused.unwrap_err().refusal().unwrap().rule, Some("lab"));
    for (had, expected) in [
        (Map::new().with("owner", "bob"), "bob"),
        (
            Map::new().with("holders", holders(&["bob", "carol"])),
            "bob carol",
        ),
        (Map::new(), ""),
    ] {
        let (broken, ()) = tokio::join!(token.break_hold(), async {
            let request = peer.expect("token break /robot/token").await;
            peer.ok(&request, had).await;
        });
        assert_eq!(broken.unwrap().join(" "), expected);
    }
}

#[tokio::test]
async fn the_status_of_a_token_is_typed() {
    let (_client, token, mut peer) = token().await;
    let (status, ()) = tokio::join!(token.status(), async {
        let request = peer.expect("context info /robot/token").await;
        let content = Map::new().with("fence", 4).with("holders", holders(&["bob"]));
        peer.ok(&request, content).await;
    });
    let status = status.unwrap();
    assert_eq!((status.fence, status.holders.join(" ")), (4, "bob".to_owned()));
}

#[tokio::test]
async fn peers_are_invited_by_a_member_and_expelled() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let (invited, ()) = tokio::join!(client.invite("/lab", "bob"), async {
        peer.join_one("/lab", "session", Map::new()).await;
        let request = peer.expect("context invite /lab").await;
        assert_eq!(request.value(), Map::new().with("peer", "bob").into());
        peer.ok(&request, Map::new()).await;
        peer.expect("context leave /lab").await;
    });
    invited.unwrap();
    let minute = Some(Duration::from_secs(60));
    for (text, time, expected) in [
        ("", None, Map::new()),
        ("out", minute, Map::new().with("text", "out").with("for", 60_000)),
    ] {
        let (expelled, ()) = tokio::join!(client.expel("/lab", "bob", text, time), async {
            let request = peer.expect("context expel /lab").await;
            let mut all = Map::new().with("peer", "bob");
            for (key, value) in expected {
                all.set(&key, value);
            }
            assert_eq!(request.value(), all.into());
            peer.ok(&request, Map::new()).await;
        });
        expelled.unwrap();
    }
}

#[tokio::test]
async fn an_invitation_is_told_where_the_rest_is() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let mut others = client.unaddressed();
    let content = Map::new()
        .with("by", "bob")
        .with("path", "/lab")
        .with("kind", "session");
    peer.event("invited", "/lab", content).await;
    let expected = Event::Invited {
        by: "bob".to_owned(),
        kind: Some(ContextKind::Session),
        path: path("/lab"),
    };
    assert_eq!(next(&mut others).await, expected);
}

#[tokio::test]
async fn who_is_expelled_is_told_and_in_nothing_there_any_more() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let (arm, ()) = tokio::join!(
        client.channel("/robot/arm"),
        peer.joined("/robot/arm", "channel", Map::new())
    );
    let robot = client.session("/robot").await.unwrap();
    let (mut on_robot, arm) = (robot.events(), arm.unwrap());
    let mut on_arm = arm.events();
    let out = |name: &str| {
        Map::new()
            .with("peer", name)
            .with("by", "carol")
            .with("text", "out")
    };
    peer.event("expelled", "/robot", out("bob")).await;
    peer.event("expelled", "/robot", out("ally")).await;
    for name in ["bob", "ally"] {
        let expected = Event::Expelled {
            peer: name.to_owned(),
            by: Some("carol".to_owned()),
            text: Some("out".to_owned()),
            path: path("/robot"),
        };
        assert_eq!(next(&mut on_robot).await, expected);
    }
    assert_eq!((on_robot.next().await, on_arm.next().await), (None, None));
    // Nothing is left that the hub has taken away already; and the way back begins with a join.
    drop((robot, arm, on_robot, on_arm));
    let (again, ()) = tokio::join!(client.session("/robot"), async {
        let join = peer.expect("context join /robot").await;
        peer.refuse(&join, &WireError::new(Code::DENIED, "expelled"))
            .await;
    });
    assert_eq!(again.unwrap_err().code(), Some(&Code::DENIED));
}

async fn consult(peer: &mut Peer, number: u64) {
    let content = Map::new()
        .with("verb", "send")
        .with("peer", "bob~2")
        .with("user", "bob")
        .with("level", 1)
        .with("groups", holders(&["students"]))
        .with("message", "command")
        .with("size", 12)
        .with("kind", "channel")
        .with("within", 5000)
        .with("rule", "lab/chairs");
    let parcel = Parcel::new(Family::Manager, "consult")
        .context(path("/robot/arm"))
        .id(number)
        .content(content);
    peer.say(parcel).await;
}

async fn verdict(peer: &mut Peer, answer: Map) {
    let request = peer.expect("manager verdict").await;
    assert_eq!(request.value(), answer.into());
    peer.ok(&request, Map::new()).await;
}

#[tokio::test]
async fn questions_of_the_hub_are_answered() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let mut consults = client.consults();
    for number in 1..=4 {
        consult(&mut peer, number).await;
    }
    let first = consults.next().await.unwrap();
    assert_eq!(
        (first.number, first.verb.as_str(), first.context.as_str()),
        (1, "send", "/robot/arm")
    );
    assert_eq!(
        (first.peer.as_str(), first.user.as_str(), first.level),
        ("bob~2", "bob", 1)
    );
    assert_eq!(
        (first.groups.join(" "), first.message.as_deref(), first.size),
        ("students".to_owned(), Some("command"), Some(12))
    );
    assert_eq!(
        (first.kind.as_deref(), first.rule.as_deref(), first.within),
        (Some("channel"), Some("lab/chairs"), Duration::from_secs(5))
    );
    assert!(first.left() <= first.within);
    let answer = |number: i64, allow: bool| Map::new().with("consult", number).with("allow", allow);
    let (said, ()) = tokio::join!(first.allow(), verdict(&mut peer, answer(1, true)));
    said.unwrap();
    let second = consults.next().await.unwrap();
    let stands = answer(2, true).with("stands", true);
    let (said, ()) = tokio::join!(second.allow_from_now_on(), verdict(&mut peer, stands));
    said.unwrap();
    let third = consults.next().await.unwrap();
    let words = answer(3, false).with("text", "not now");
    let (said, ()) = tokio::join!(third.deny("not now"), verdict(&mut peer, words));
    said.unwrap();
    let fourth = consults.next().await.unwrap();
    let (late, ()) = tokio::join!(fourth.deny(""), async {
        let request = peer.expect("manager verdict").await;
        assert_eq!(request.value(), answer(4, false).into());
        peer.refuse(&request, &WireError::new(Code::TOO_LATE, "answered"))
            .await;
    });
    assert_eq!(late.unwrap_err().code(), Some(&Code::TOO_LATE));
    assert_eq!(consults.missed(), 0);
}

#[tokio::test]
async fn questions_wait_in_a_bounded_queue_and_end_with_the_client() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder.event_buffer(2).no_reconnect()).await;
    let mut others = client.unaddressed();
    consult(&mut peer, 1).await;
    assert!(
        matches!(next(&mut others).await, Event::Other(parcel) if parcel.name() == "consult"),
        "nobody answers, but it is not lost silently"
    );
    let mut consults = client.consults();
    for number in 2..=5 {
        consult(&mut peer, number).await;
    }
    // One that cannot be read is passed over.
    peer.say(Parcel::new(Family::Manager, "consult").id(9)).await;
    close(&client, peer).await;
    let taken = consults.next().await.unwrap();
    assert_eq!((taken.number, consults.missed()), (5, 3));
    assert!(consults.next().await.is_none());
    assert_eq!(others.next().await, None);
}

/// Ends the link, and waits until the client knows.
async fn close(client: &Client, peer: Peer) {
    peer.hang_up();
    let closed = |link: &mom_client::LinkState| matches!(link, mom_client::LinkState::Closed(_));
    client.state().wait_for(closed).await.unwrap();
}
