//! Lost links, and what becomes of everything when they are back.

use std::time::Duration;

use mom_client::{
    Builder, Client, Code, ErrorKind, Event, Family, LinkState, Map, Parcel, Reconnect, Thinning, WireError,
};
use tokio::time::Instant;

use crate::common::{Hub, Peer, local, logged_in, next, path, tcp};

fn quick(builder: Builder) -> Builder {
    builder.reconnect(Reconnect {
        first: Duration::from_millis(1),
        most: Duration::from_millis(10),
        give_up_after: None,
    })
}

async fn back(hub: &mut Hub, name: &str) -> Peer {
    let mut peer = hub.accept().await;
    peer.log_in(name, Map::new()).await;
    peer
}

#[tokio::test]
async fn everything_is_joined_again_parents_first() {
    for form in ["pair", "tcp", "bin"] {
        let (mut hub, builder) = match form {
            "pair" => local(),
            scheme => tcp(scheme).await,
        };
        let (client, mut peer) = logged_in(&mut hub, quick(builder)).await;
        let (arm, ()) = tokio::join!(
            client.channel("/robot/arm"),
            peer.joined("/robot/arm", "channel", Map::new())
        );
        let (chat, ()) = tokio::join!(
            client.channel("/chat"),
            peer.joined("/chat", "channel", Map::new())
        );
        let gone = client.clone();
        let (gone, ()) = tokio::join!(gone.channel("/gone"), peer.joined("/gone", "channel", Map::new()));
        drop(gone.unwrap());
        peer.expect("context leave /gone").await;
        let (mut on_arm, mut on_chat, mut others) = (
            arm.unwrap().events(),
            chat.unwrap().events(),
            client.unaddressed(),
        );
        peer.hang_up();
        for events in [&mut on_arm, &mut on_chat, &mut others] {
            assert_eq!(next(events).await, Event::LinkDown, "{form}");
        }

        let mut peer = back(&mut hub, "ally~2").await;
        client
            .state()
            .wait_for(|link| *link == LinkState::Connected)
            .await
            .unwrap();
        assert_eq!(client.name(), "ally~2");
        // What is sent now comes after the joins.
        client
            .send(Parcel::new(Family::Message, "chat").context(path("/chat")))
            .await
            .unwrap();
        peer.joined("/chat", "channel", Map::new()).await;
        peer.joined("/robot/arm", "channel", Map::new()).await;
        peer.expect("message chat /chat").await;
        for events in [&mut on_arm, &mut on_chat, &mut others] {
            assert_eq!(next(events).await, Event::Rejoined, "{form}");
        }
        peer.message("chat", "/chat", "again").await;
        assert!(matches!(next(&mut on_chat).await, Event::Message(_)), "{form}");
        assert_eq!(others.try_next(), None);
    }
}

#[tokio::test]
async fn what_one_is_spared_of_is_asked_for_again() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, quick(builder)).await;
    let rate = |text: &str| Thinning {
        rate: text.parse().ok(),
        ..Thinning::default()
    };
    let member = Map::new().with("kind", "channel");
    let (joined, ()) = tokio::join!(client.channel_thinned("/chat", rate("5/s")), async {
        let join = peer.expect("context join /chat").await;
        assert_eq!(join.value(), Map::new().with("rate", "5/s").into());
        peer.ok(&join, member.clone()).await;
    });
    let chat = joined.unwrap();
    // Who is there already joins again; who says nothing of it changes nothing.
    let (joined, ()) = tokio::join!(client.channel_thinned("/chat", rate("1/min")), async {
        let join = peer.expect("context join /chat").await;
        assert_eq!(join.value(), Map::new().with("rate", "1/min").into());
        peer.ok(&join, member.clone()).await;
    });
    joined.unwrap();
    client.channel("/chat").await.unwrap();
    peer.hang_up();
    let mut peer = back(&mut hub, "ally").await;
    let join = peer.expect("context join /chat").await;
    assert_eq!(join.value(), Map::new().with("rate", "1/min").into());
    peer.ok(&join, member.clone()).await;
    client
        .state()
        .wait_for(|link| *link == LinkState::Connected)
        .await
        .unwrap();
    let (ended, ()) = tokio::join!(chat.thin(Thinning::default()), async {
        let join = peer.expect("context join /chat").await;
        assert_eq!(join.value(), Map::new().into(), "an empty map ends it");
        peer.ok(&join, member.clone()).await;
    });
    ended.unwrap();
    peer.hang_up();
    let mut peer = back(&mut hub, "ally").await;
    assert!(peer.expect("context join /chat").await.content.is_none());
}

#[tokio::test]
async fn a_refused_rejoin_is_told_and_ends_the_subscription() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, quick(builder)).await;
    let (chat, ()) = tokio::join!(
        client.channel("/chat"),
        peer.joined("/chat", "channel", Map::new())
    );
    let (mut events, mut others) = (chat.unwrap().events(), client.unaddressed());
    peer.hang_up();
    let mut peer = back(&mut hub, "ally").await;
    let join = peer.expect("context join /chat").await;
    let denied = WireError::new(Code::DENIED, "not today").rule("lab");
    peer.refuse(&join, &denied).await;
    assert_eq!(next(&mut events).await, Event::LinkDown);
    assert_eq!(next(&mut events).await, Event::Refused(denied, None));
    assert_eq!(events.next().await, None);
    assert_eq!(
        (next(&mut others).await, next(&mut others).await),
        (Event::LinkDown, Event::Rejoined)
    );
}

#[tokio::test]
async fn the_gate_lets_nobody_pass_until_it_knows_again() {
    let guard = |owner: &str, fence: i64| {
        let guard = Map::new()
            .with("token", "/t")
            .with("names", vec!["command".into()]);
        Map::new().with("guard", guard.with("owner", owner).with("fence", fence))
    };
    for (owner, fence, passes) in [("ally", 5, true), ("bob", 6, false), ("ally", 4, false)] {
        let (mut hub, builder) = local();
        let (client, mut peer) = logged_in(&mut hub, quick(builder)).await;
        let (arm, ()) = tokio::join!(
            client.channel("/arm"),
            peer.joined("/arm", "channel", guard("ally", 5))
        );
        let arm = arm.unwrap();
        let (gate, mut events) = (arm.gate(), arm.events());
        let mut command = Parcel::new(Family::Message, "command");
        command.fence = Some(5);
        assert_eq!(gate.check(&command), Ok(()));
        peer.hang_up();
        assert_eq!(next(&mut events).await, Event::LinkDown);
        assert!(
            gate.check(&command).is_err(),
            "anybody may have grabbed it meanwhile"
        );
        let mut peer = back(&mut hub, "ally").await;
        peer.joined("/arm", "channel", guard(owner, fence)).await;
        assert_eq!(next(&mut events).await, Event::Rejoined);
        assert_eq!(gate.check(&command).is_ok(), passes, "{owner} {fence}");
    }
}

#[tokio::test]
async fn what_was_asked_fails_and_what_waited_is_counted() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, quick(builder)).await;
    let (chat, ()) = tokio::join!(
        client.channel("/chat"),
        peer.joined("/chat", "channel", Map::new())
    );
    let chat = chat.unwrap();
    let mut events = chat.events();
    let asked = client.clone();
    let asked = tokio::spawn(async move { asked.info("/").await });
    let request = peer.expect("context info /").await;
    assert!(request.id.is_some());
    // The hub reads no more, so most of these never leave.
    for number in 0..1000 {
        chat.send("chat", number).await.unwrap();
    }
    peer.hang_up();
    assert_eq!(asked.await.unwrap().unwrap_err().kind(), ErrorKind::Connection);
    let Event::Dropped {
        reason,
        count,
        parcel,
    } = next(&mut events).await
    else {
        panic!("what was lost first")
    };
    assert_eq!(
        (reason.as_str(), parcel.context),
        ("disconnected", Some(path("/chat")))
    );
    assert!((1..1000).contains(&count), "{count}");
    assert_eq!(next(&mut events).await, Event::LinkDown);

    // While it is down nothing is taken.
    let down = client.state().borrow().clone();
    assert!(matches!(down, LinkState::Trying { .. }), "{down:?}");
    assert_eq!(
        chat.send("chat", "x").await.unwrap_err().kind(),
        ErrorKind::Connection
    );
    assert_eq!(client.info("/").await.unwrap_err().kind(), ErrorKind::Connection);
    assert_eq!(
        client.channel("/other").await.unwrap_err().kind(),
        ErrorKind::Connection
    );
}

#[tokio::test(start_paused = true)]
async fn attempts_back_off() {
    let (mut hub, builder) = local();
    let builder = builder.reconnect(Reconnect {
        first: Duration::from_millis(100),
        most: Duration::from_millis(1000),
        give_up_after: None,
    });
    let (client, peer) = logged_in(&mut hub, builder).await;
    let mut since = Instant::now();
    peer.hang_up();
    for (attempt, most) in [100, 200, 400, 800, 1000, 1000].into_iter().enumerate() {
        let peer = hub.accept().await;
        let waited = since.elapsed();
        let most = Duration::from_millis(most);
        // The timer's grain is one ms.
        assert!(
            most / 2 <= waited && waited <= most + Duration::from_millis(2),
            "{attempt}: {waited:?}"
        );
        let down = client.state().borrow().clone();
        assert!(
            matches!(down, LinkState::Trying { attempt: failed, .. } if failed as usize == attempt),
            "{down:?}"
        );
        since = Instant::now();
        peer.hang_up();
    }
    let _peer = back(&mut hub, "ally").await;
    client
        .state()
        .wait_for(|link| *link == LinkState::Connected)
        .await
        .unwrap();
}

#[tokio::test(start_paused = true)]
async fn the_hub_s_word_decides_whether_to_come_back() {
    for (error, comes_back) in [
        (WireError::new(Code::SHUTDOWN, "maintenance"), true),
        (WireError::new(Code::SLOW_RECEIVER, "too slow"), true),
        (WireError::new(Code::BAD_FRAME, "no frame"), false),
        (
            WireError::new(Code::from_wire(499, "from-the-future"), "stay away"),
            false,
        ),
    ] {
        let (mut hub, builder) = local();
        let (client, mut peer) = logged_in(&mut hub, builder).await;
        let mut others = client.unaddressed();
        peer.say(error.to_parcel(None)).await;
        peer.hang_up();
        assert_eq!(next(&mut others).await, Event::Refused(error.clone(), None));
        if comes_back {
            assert_eq!(next(&mut others).await, Event::LinkDown);
            let _peer = back(&mut hub, "ally").await;
            assert_eq!(next(&mut others).await, Event::Rejoined);
        } else {
            closed_with(&client, &error).await;
            assert_eq!(others.next().await, None);
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_refused_login_ends_or_goes_on_by_its_code() {
    for (error, goes_on) in [
        (
            WireError::new(Code::FULL, "full").retry_after(Duration::from_secs(30)),
            true,
        ),
        (WireError::new(Code::SHUTDOWN, "still starting"), true),
        (
            WireError::new(Code::BAD_LOGIN, "the password is another now"),
            false,
        ),
        (WireError::new(Code::INSECURE, "not in plain"), false),
    ] {
        let (mut hub, builder) = local();
        let (client, peer) = logged_in(&mut hub, builder).await;
        peer.hang_up();
        let mut peer = hub.accept().await;
        let refused = Instant::now();
        let login = peer.expect("login login /").await;
        peer.refuse(&login, &error).await;
        if goes_on {
            let _peer = back(&mut hub, "ally").await;
            assert!(
                refused.elapsed() >= error.retry_in().unwrap_or_default(),
                "{error}"
            );
            client
                .state()
                .wait_for(|link| *link == LinkState::Connected)
                .await
                .unwrap();
        } else {
            closed_with(&client, &error).await;
        }
    }
}

#[tokio::test(start_paused = true)]
async fn it_gives_up_when_told_so() {
    let (mut hub, builder) = local();
    let builder = builder.reconnect(Reconnect {
        give_up_after: Some(Duration::from_secs(20)),
        ..Reconnect::default()
    });
    let (client, peer) = logged_in(&mut hub, builder).await;
    let start = Instant::now();
    peer.hang_up();
    drop(hub);
    client
        .state()
        .wait_for(|link| matches!(link, LinkState::Closed(_)))
        .await
        .unwrap();
    assert!(
        (20..26).contains(&start.elapsed().as_secs()),
        "{:?}",
        start.elapsed()
    );
    assert_eq!(
        client.info("/").await.unwrap_err().code(),
        Some(&Code::DISCONNECTED)
    );
}

#[tokio::test(start_paused = true)]
async fn a_client_dropped_while_down_stops_trying() {
    let (mut hub, builder) = local();
    let (client, peer) = logged_in(&mut hub, builder).await;
    let (mut others, state) = (client.unaddressed(), client.state());
    peer.hang_up();
    assert_eq!(next(&mut others).await, Event::LinkDown);
    drop(client);
    assert_eq!(others.next().await, None);
    assert_eq!(*state.borrow(), LinkState::Closed(None));
}

async fn closed_with(client: &Client, error: &WireError) {
    let mut state = client.state();
    let closed = state
        .wait_for(|link| matches!(link, LinkState::Closed(_)))
        .await
        .unwrap()
        .clone();
    assert_eq!(closed, LinkState::Closed(Some(error.clone())));
    let refused = client.info("/").await.unwrap_err();
    assert_eq!((refused.kind(), refused.wire()), (ErrorKind::Closed, Some(error)));
}
