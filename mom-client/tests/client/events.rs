//! What subscriptions give, and the heartbeats.

use std::time::Duration;

use mom_client::{
    Code, ContextInfo, ContextKind, Event, Family, GuardState, LinkState, Map, Member, Parcel, WireError,
};
use tokio::time::Instant;

use crate::common::{local, logged_in, logged_in_with, next, path, tcp, words};

fn alice(name: &str) -> Map {
    Map::new()
        .with("peer", name)
        .with("user", "alice")
        .with("level", 1)
}

#[tokio::test]
async fn events_go_to_their_context() {
    for form in ["pair", "tcp", "bin"] {
        let (mut hub, builder) = match form {
            "pair" => local(),
            scheme => tcp(scheme).await,
        };
        let (client, mut peer) = logged_in(&mut hub, builder).await;
        let mut others = client.unaddressed();
        let (chat, ()) = tokio::join!(
            client.channel("/chat"),
            peer.joined("/chat", "channel", Map::new())
        );
        let chat = chat.unwrap();
        let (mut one, mut two) = (chat.events(), chat.events());
        peer.event("joined", "/chat", alice("bob")).await;
        peer.message("chat", "/chat", "good morning").await;
        peer.message("chat", "/elsewhere", "not for the chat").await;
        for events in [&mut one, &mut two] {
            let Event::Joined(member) = next(events).await else {
                panic!("{form}: bob joined first")
            };
            let bob = Member {
                peer: "bob".to_owned(),
                user: "alice".to_owned(),
                level: 1,
                device: false,
            };
            assert_eq!(member, bob);
            let Event::Message(parcel) = next(events).await else {
                panic!("{form}: then the message")
            };
            assert_eq!((parcel.name(), parcel.value()), ("chat", "good morning".into()));
        }
        let Event::Message(parcel) = next(&mut others).await else {
            panic!("{form}: the rest")
        };
        assert_eq!(parcel.context, Some(path("/elsewhere")));
        assert_eq!(
            (one.try_next(), two.try_next(), others.try_next()),
            (None, None, None),
            "{form}"
        );
    }
}

#[tokio::test]
async fn what_comes_with_the_join_is_not_missed() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let mut others = client.unaddressed();
    let (chat, ()) = tokio::join!(client.channel("/chat"), async {
        let join = peer.expect("context join /chat").await;
        // Our own arrival says no more than the reply.
        peer.event("joined", "/chat", alice("ally")).await;
        peer.ok(
            &join,
            Map::new()
                .with("path", "/chat")
                .with("kind", "channel")
                .with("number", 3),
        )
        .await;
        peer.message("chat", "/chat", "at once").await;
        peer.message("last", "/elsewhere", "so all before has arrived")
            .await;
    });
    assert!(matches!(next(&mut others).await, Event::Message(parcel) if parcel.name() == "last"));
    let mut events = chat.unwrap().events();
    assert!(matches!(events.try_next(), Some(Event::Message(parcel)) if parcel.name() == "chat"));
    assert_eq!(events.try_next(), None);
}

#[tokio::test]
async fn who_is_slow_is_told_what_was_lost() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder.event_buffer(3)).await;
    let (chat, ()) = tokio::join!(
        client.channel("/chat"),
        peer.joined("/chat", "channel", Map::new())
    );
    let mut events = chat.unwrap().events();
    let mut others = client.unaddressed();
    for number in 0..8 {
        peer.message("chat", "/chat", number).await;
    }
    peer.message("last", "/elsewhere", "so all before has arrived")
        .await;
    next(&mut others).await;
    assert_eq!(next(&mut events).await, Event::Lagged(5));
    for number in 5..8 {
        assert!(matches!(next(&mut events).await, Event::Message(parcel) if parcel.value() == number.into()));
    }
    assert_eq!(events.try_next(), None);
}

fn guarded(owner: Option<&str>, fence: u64) -> Option<GuardState> {
    Some(GuardState {
        token: path("/robot/token"),
        names: vec!["command".to_owned()],
        owner: owner.map(str::to_owned),
        fence,
    })
}

#[tokio::test]
async fn a_token_s_events_reach_it_and_the_channels_that_it_guards() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let guard = Map::new()
        .with("token", "/robot/token")
        .with("names", vec!["command".into()]);
    let guard = Map::new().with("guard", guard.with("owner", "bob").with("fence", 5));
    let (arm, ()) = tokio::join!(
        client.channel("/robot/arm"),
        peer.joined("/robot/arm", "channel", guard)
    );
    let (token, ()) = tokio::join!(
        client.token("/robot/token"),
        peer.join_one("/robot/token", "token", Map::new().with("fence", 5))
    );
    let (arm, token) = (arm.unwrap(), token.unwrap());
    let (mut on_arm, mut on_token, gate) = (arm.events(), token.events(), arm.gate());
    assert_eq!(arm.guard(), guarded(Some("bob"), 5));

    let released = Map::new()
        .with("owner", "bob")
        .with("reason", "preempted")
        .with("by", "carol")
        .with("fence", 5);
    peer.event("released", "/robot/token", released).await;
    for events in [&mut on_arm, &mut on_token] {
        let Event::Released {
            reason, by, fence, ..
        } = next(events).await
        else {
            panic!("released first")
        };
        assert_eq!(
            (reason.as_str(), by.as_deref(), fence),
            ("preempted", Some("carol"), 5)
        );
    }
    assert_eq!(arm.guard(), guarded(None, 5));

    let grabbed = Map::new()
        .with("owner", "carol")
        .with("level", 5)
        .with("fence", 6)
        .with("lease", 1000);
    peer.event("grabbed", "/robot/token", grabbed).await;
    let expected = Event::Grabbed {
        owner: "carol".to_owned(),
        level: 5,
        fence: 6,
        lease: Some(Duration::from_secs(1)),
        path: path("/robot/token"),
    };
    assert_eq!(
        (next(&mut on_arm).await, next(&mut on_token).await),
        (expected.clone(), expected)
    );
    assert_eq!(arm.guard(), guarded(Some("carol"), 6));

    for (fence, passes) in [(5, false), (6, true)] {
        let mut command = Parcel::new(Family::Message, "command").context(path("/robot/arm"));
        command.fence = Some(fence);
        peer.say(command).await;
        let Event::Message(parcel) = next(&mut on_arm).await else {
            panic!("a command")
        };
        assert_eq!(gate.check(&parcel).is_ok(), passes);
    }
}

#[tokio::test]
async fn a_session_hears_of_what_is_made_and_deleted_in_it() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let (robot, ()) = tokio::join!(
        client.session("/robot"),
        peer.joined("/robot", "session", Map::new())
    );
    let (arm, ()) = tokio::join!(
        client.channel("/robot/arm"),
        peer.join_one("/robot/arm", "channel", Map::new())
    );
    let (mut on_robot, mut on_arm) = (robot.unwrap().events(), arm.unwrap().events());
    let made = Map::new()
        .with("path", "/robot/tool")
        .with("kind", "channel")
        .with("number", 8)
        .with("by", "bob");
    peer.event("created", "/robot", made).await;
    let tool = ContextInfo {
        path: path("/robot/tool"),
        kind: ContextKind::Channel,
        number: 8,
        members: None,
        stop: None,
    };
    assert_eq!(next(&mut on_robot).await, Event::Created(tool));
    peer.event(
        "deleted",
        "/robot/arm",
        Map::new().with("path", "/robot/arm").with("kind", "channel"),
    )
    .await;
    let deleted = Event::Deleted {
        path: path("/robot/arm"),
    };
    assert_eq!(
        (next(&mut on_robot).await, next(&mut on_arm).await),
        (deleted.clone(), deleted)
    );
    assert_eq!(on_arm.next().await, None, "nothing comes from there any more");
    assert_eq!(on_robot.try_next(), None);
    // One made at the same path is another one, which has to be joined.
    let (again, ()) = tokio::join!(
        client.channel("/robot/arm"),
        peer.join_one("/robot/arm", "channel", Map::new())
    );
    assert_eq!(again.unwrap().path(), &path("/robot/arm"));
}

#[tokio::test]
async fn an_error_about_nothing_in_particular_is_told() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let mut others = client.unaddressed();
    let error = WireError::new(Code::TRY_LATER, "too much is going on");
    peer.say(error.to_parcel(None)).await;
    assert_eq!(next(&mut others).await, Event::Refused(error, None));
}

#[tokio::test(start_paused = true)]
async fn a_silent_client_says_that_it_lives() {
    let (mut hub, builder) = local();
    let limits = Map::new().with("heartbeat", 2000).with("gone", 9000);
    let (client, mut peer) = logged_in_with(&mut hub, builder, limits).await;
    let start = Instant::now();
    for beat in 0..=3 {
        let ping = peer.hear_any().await.unwrap();
        assert_eq!(
            (words(&ping).as_str(), start.elapsed().as_secs()),
            ("time ping", 2 * beat)
        );
        let mut pong = Parcel::new(Family::Time, "pong");
        pong.reference = ping.id;
        peer.say(pong).await;
    }
    // A ping of the hub is answered, and that is a sign of life too.
    tokio::time::sleep(Duration::from_millis(1500)).await; // tidy: moves the paused clock
    peer.say(Parcel::new(Family::Time, "ping").id(77)).await;
    let pong = peer.hear_any().await.unwrap();
    assert_eq!((words(&pong).as_str(), pong.reference), ("time pong", Some(77)));
    peer.hear_any().await.unwrap();
    assert_eq!(start.elapsed().as_millis(), 8000);
    drop(client);
}

#[tokio::test(start_paused = true)]
async fn a_client_that_only_sends_still_asks_whether_the_hub_lives() {
    let (mut hub, builder) = local();
    let limits = Map::new().with("heartbeat", 2000).with("gone", 9000);
    let (client, mut peer) = logged_in_with(&mut hub, builder, limits).await;
    let start = Instant::now();
    let mut pings = 0;
    while start.elapsed() < Duration::from_secs(20) {
        client
            .send(Parcel::new(Family::Message, "state").context(path("/chat")))
            .await
            .unwrap();
        let parcel = peer.hear_any().await.unwrap();
        if parcel.is(Family::Time, "ping") {
            pings += 1;
            let mut pong = Parcel::new(Family::Time, "pong");
            pong.reference = parcel.id;
            peer.say(pong).await;
        }
        tokio::time::sleep(Duration::from_millis(500)).await; // tidy: moves the paused clock
    }
    assert!(pings >= 5, "{pings} pings");
    assert_eq!(*client.state().borrow(), LinkState::Connected);
}

#[tokio::test(start_paused = true)]
async fn a_silent_hub_is_a_lost_link() {
    let (mut hub, builder) = local();
    let limits = Map::new().with("heartbeat", 2000).with("gone", 9000);
    let (client, _peer) = logged_in_with(&mut hub, builder.no_reconnect(), limits).await;
    let start = Instant::now();
    let mut state = client.state();
    state.changed().await.unwrap();
    assert!(matches!(*state.borrow_and_update(), LinkState::Stale { .. }));
    assert_eq!(start.elapsed().as_secs(), 3, "one and a half heartbeats");
    state.changed().await.unwrap();
    assert_eq!(start.elapsed().as_secs(), 9);
    let LinkState::Closed(Some(error)) = state.borrow().clone() else {
        panic!("closed, as it may not reconnect")
    };
    assert_eq!(error.code, Code::DISCONNECTED);
    let refused = client.info("/").await.unwrap_err();
    assert_eq!(refused.kind(), mom_client::ErrorKind::Closed);
}
