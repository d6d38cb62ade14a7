//! Requests, replies, refusals and what is typed of them.

use std::time::Duration;

use crate::common::{local, logged_in, logged_in_with, next, path, tcp, words};
use mom_client::{
    Client, ClientError, Code, ContextKind, Delivery, ErrorKind, Event, Family, LinkState, Map, Parcel,
    Value, WireError,
};

#[tokio::test]
async fn the_login_says_who_and_what() {
    for form in ["pair", "tcp", "bin"] {
        let (mut hub, builder) = match form {
            "pair" => local(),
            scheme => tcp(scheme).await,
        };
        let script = async {
            let mut peer = hub.accept().await;
            let login = peer.log_in("ally", Map::new()).await;
            (peer, login)
        };
        let (client, (mut peer, login)) = tokio::join!(builder.nickname("ally").connect(), script);
        let client = client.unwrap();
        assert_eq!(login.id, Some(1), "ids rise from 1");
        assert!(login.timestamp.is_some());
        let content = Map::new()
            .with("name", "alice")
            .with("password", "secret")
            .with("nickname", "ally");
        assert_eq!(login.value(), content.into(), "{form}");
        assert_eq!(
            (client.name(), client.user(), client.level()),
            ("ally".into(), "alice".into(), 1)
        );
        assert_eq!(client.welcome().get("user"), Some(&"alice".into()));

        let (info, ()) = tokio::join!(client.info("/robot"), async {
            let request = peer.expect("context info /robot").await;
            assert_eq!(request.id, Some(2));
            peer.ok(&request, Map::new().with("members", 3)).await;
        });
        assert_eq!(info.unwrap(), Map::new().with("members", 3), "{form}");
    }
}

#[tokio::test]
async fn a_refused_login_says_why() {
    for form in ["pair", "tcp", "bin"] {
        let (mut hub, builder) = match form {
            "pair" => local(),
            scheme => tcp(scheme).await,
        };
        let (client, ()) = tokio::join!(builder.connect(), async {
            let mut peer = hub.accept().await;
            let login = peer.expect("login login /").await;
            peer.refuse(
                &login,
                &WireError::new(Code::BAD_LOGIN, "no such user or another password"),
            )
            .await;
        });
        assert_eq!(client.unwrap_err().code(), Some(&Code::BAD_LOGIN), "{form}");
    }
}

#[tokio::test]
async fn a_hub_that_cannot_be_had_is_an_error() {
    for (address, kind) in [
        ("ftp://127.0.0.1", ErrorKind::Local),
        ("tcp://", ErrorKind::Local),
        ("tcp://127.0.0.1:1", ErrorKind::Connection),
    ] {
        let error = Client::builder(address)
            .user("alice")
            .connect()
            .await
            .unwrap_err();
        assert_eq!(error.kind(), kind, "{address}: {error}");
    }
    let (hub, builder) = local();
    drop(hub);
    assert_eq!(builder.connect().await.unwrap_err().kind(), ErrorKind::Connection);
}

#[tokio::test(start_paused = true)]
async fn what_is_not_answered_times_out() {
    let (mut hub, builder) = local();
    let connected = tokio::join!(
        builder.request_timeout(Duration::from_secs(3)).connect(),
        hub.accept()
    );
    assert_eq!(connected.0.unwrap_err().kind(), ErrorKind::TimedOut);

    // Unless told, a chair has its time to answer, but a connection must not take so long.
    let (mut hub, builder) = local();
    let start = tokio::time::Instant::now();
    let connected = tokio::join!(builder.connect(), hub.accept());
    assert_eq!(connected.0.unwrap_err().kind(), ErrorKind::TimedOut);
    assert_eq!(start.elapsed(), Duration::from_secs(10));
    let (mut hub, builder) = local();
    // A hub that lives, though it says nothing.
    let limits = Map::new().with("heartbeat", 10_000_000).with("gone", 30_000_000);
    let (client, _peer) = logged_in_with(&mut hub, builder, limits).await;
    let start = tokio::time::Instant::now();
    assert_eq!(
        client.info("/robot").await.unwrap_err().kind(),
        ErrorKind::TimedOut
    );
    assert_eq!(start.elapsed(), Duration::from_secs(40));

    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder.request_timeout(Duration::from_secs(3))).await;
    let start = tokio::time::Instant::now();
    let error = client.info("/robot").await.unwrap_err();
    assert_eq!(start.elapsed(), Duration::from_secs(3));
    let ClientError::TimedOut { what, after } = error else {
        panic!("{error}")
    };
    assert_eq!(
        (what.as_str(), after),
        ("context info /robot", Duration::from_secs(3))
    );

    // The late answer goes to nobody, above all not to the next who asks.
    let late = peer.expect("context info /robot").await;
    let (info, ()) = tokio::join!(client.info("/other"), async {
        peer.ok(&late, Map::new().with("late", true)).await;
        let request = peer.expect("context info /other").await;
        peer.ok(&request, Map::new().with("late", false)).await;
    });
    assert_eq!(info.unwrap(), Map::new().with("late", false));
}

#[tokio::test]
async fn replies_find_their_requests_in_any_order() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let (one, two, ()) = tokio::join!(client.info("/one"), client.info("/two"), async {
        let one = peer.expect("context info /one").await;
        let two = peer.expect("context info /two").await;
        peer.ok(&two, Map::new().with("n", 2)).await;
        peer.ok(&one, Map::new().with("n", 1)).await;
    });
    assert_eq!(
        (one.unwrap(), two.unwrap()),
        (Map::new().with("n", 1), Map::new().with("n", 2))
    );
}

#[tokio::test]
async fn a_refusal_keeps_its_details() {
    for form in ["pair", "tcp", "bin"] {
        let (mut hub, builder) = match form {
            "pair" => local(),
            scheme => tcp(scheme).await,
        };
        let (client, mut peer) = logged_in(&mut hub, builder).await;
        let refusal = WireError::new(Code::HELD, "alice drives")
            .rule("lab-token")
            .owner("alice", 1)
            .retry_after(Duration::from_millis(180_000));
        let (error, ()) = tokio::join!(client.lookup("/robot"), async {
            let request = peer.expect("context lookup /robot").await;
            peer.refuse(&request, &refusal).await;
        });
        let error = error.unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Refused);
        assert_eq!(error.wire(), Some(&refusal), "{form}");
        assert_eq!(error.wire().unwrap().retry_in(), Some(Duration::from_secs(180)));
    }
}

#[tokio::test]
async fn lists_and_lookups_are_typed() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let arm = || {
        Map::new()
            .with("path", "/robot/arm")
            .with("kind", "channel")
            .with("number", 4)
    };
    let script = async {
        let request = peer.expect("context lookup /robot/arm").await;
        peer.ok(&request, arm()).await;
        let request = peer.expect("context list /robot").await;
        let children: Vec<Value> = vec![arm().with("name", "arm").with("members", 2).into()];
        peer.ok(&request, Map::new().with("children", children)).await;
        let request = peer.expect("context members /robot").await;
        let bob = Map::new()
            .with("peer", "bob~2")
            .with("user", "bob")
            .with("level", 1);
        peer.ok(&request, Map::new().with("members", vec![bob.into()]))
            .await;
        let request = peer.expect("context lookup /bad").await;
        peer.ok(&request, Map::new().with("path", "/bad").with("kind", "thing"))
            .await;
        let request = peer.expect("context delete /robot/arm").await;
        peer.ok(&request, Map::new()).await;
    };
    let ask = async {
        let found = client.lookup("/robot/arm").await.unwrap();
        assert_eq!(
            (found.path, found.kind, found.number),
            (path("/robot/arm"), ContextKind::Channel, 4)
        );
        assert_eq!(found.members, None);
        let listed = client.list("/robot").await.unwrap();
        assert_eq!((listed.len(), listed[0].members), (1, Some(2)));
        let members = client.members("/robot").await.unwrap();
        assert_eq!(
            (members[0].peer.as_str(), members[0].user.as_str()),
            ("bob~2", "bob")
        );
        assert_eq!(
            client.lookup("/bad").await.unwrap_err().code(),
            Some(&Code::BAD_CONTENT)
        );
        client.delete("/robot/arm").await.unwrap();
        assert_eq!(
            client.lookup("robot").await.unwrap_err().code(),
            Some(&Code::BAD_PATH)
        );
    };
    tokio::join!(ask, script);
}

#[tokio::test]
async fn a_context_is_made_from_inside_its_parent() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let spec = Map::new().with("kind", "channel").with("manager", "open");
    let (made, ()) = tokio::join!(client.create("/home/chat", spec.clone()), async {
        peer.joined("/home", "session", Map::new()).await;
        let request = peer.expect("context create /home/chat").await;
        assert_eq!(request.value(), spec.clone().into());
        let made = Map::new()
            .with("path", "/home/chat")
            .with("kind", "channel")
            .with("number", 9);
        peer.ok(&request, made).await;
        peer.expect("context leave /home").await;
    });
    assert_eq!(made.unwrap().number, 9);
}

#[tokio::test]
async fn a_message_carries_its_slots_and_gets_a_receipt() {
    let (mut hub, builder) = tcp("bin").await;
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let (arm, ()) = tokio::join!(
        client.channel("/robot/arm"),
        peer.joined("/robot/arm", "channel", Map::new())
    );
    let arm = arm.unwrap();
    let message = arm
        .message("command")
        .object(&("grip", 0.5))
        .unwrap()
        .to(["arm", "bob"])
        .priority(-3)
        .expires(Duration::from_micros(1500))
        .delivery(Delivery::Latest)
        .no_echo()
        .fence(7)
        .reference(12)
        .based_on(41)
        .slot("colour", "red");
    let (receipt, parcel) = tokio::join!(message.send_acknowledged(), async {
        let parcel = peer.expect("message command /robot/arm").await;
        let dropped = vec![Value::from("bob")];
        peer.ok(&parcel, Map::new().with("delivered", 1).with("dropped", dropped))
            .await;
        parcel
    });
    let receipt = receipt.unwrap();
    assert_eq!((receipt.delivered, receipt.dropped), (1, vec!["bob".to_owned()]));
    assert_eq!(parcel.address, Some(vec!["arm".into(), "bob".into()]));
    assert_eq!(
        (parcel.priority, parcel.expires, parcel.delivery),
        (Some(-3), Some(2), Some(Delivery::Latest))
    );
    assert_eq!(
        (parcel.echo, parcel.fence, parcel.reference),
        (Some(false), Some(7), Some(12))
    );
    assert_eq!(
        parcel.extra,
        Map::new().with("based-on", 41).with("colour", "red")
    );
    assert_eq!(parcel.receipt, Some(true));
    assert_eq!(
        parcel.value(),
        vec![Value::from("grip"), Value::Double(0.5)].into()
    );
}

#[tokio::test]
async fn what_cannot_be_sent_fails_here() {
    let (mut hub, builder) = tcp("bin").await;
    let limits = Map::new().with("parcel", 1000);
    let (client, mut peer) = logged_in_with(&mut hub, builder, limits).await;
    let (chat, ()) = tokio::join!(
        client.channel("/chat"),
        peer.joined("/chat", "channel", Map::new())
    );
    let chat = chat.unwrap();
    let large = chat.send("chat", "x".repeat(1001)).await.unwrap_err();
    assert_eq!(
        (large.kind(), large.code()),
        (ErrorKind::Local, Some(&Code::TOO_LARGE))
    );
    let nameless = chat.send("", "x").await.unwrap_err();
    assert_eq!(
        (nameless.kind(), nameless.code()),
        (ErrorKind::Local, Some(&Code::BAD_NAME))
    );
    let endless = chat.send("chat", Value::Double(f64::NAN)).await.unwrap_err();
    assert_eq!(
        (endless.kind(), endless.code()),
        (ErrorKind::Local, Some(&Code::NOT_ENCODABLE))
    );
    let unfit = chat.message("chat").object(&f64::INFINITY).unwrap_err();
    assert_eq!(
        (unfit.kind(), unfit.code()),
        (ErrorKind::Local, Some(&Code::NOT_ENCODABLE))
    );
    chat.send("chat", "short").await.unwrap();
    peer.expect("message chat /chat").await;
}

#[tokio::test]
async fn a_proxy_of_another_kind_is_refused_and_left() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let (found, ()) = tokio::join!(client.channel("/robot"), async {
        peer.joined("/robot", "session", Map::new()).await;
        peer.expect("context leave /robot").await;
    });
    assert_eq!(found.unwrap_err().code(), Some(&Code::WRONG_KIND));
    assert_eq!(
        client.token("/").await.unwrap_err().code(),
        Some(&Code::WRONG_KIND)
    );
    client.session("/").await.unwrap();
}

#[tokio::test]
async fn a_refused_join_fails_all_that_lead_through_it() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let (found, ()) = tokio::join!(client.channel("/robot/arm"), async {
        let parent = peer.expect("context join /robot").await;
        let child = peer.expect("context join /robot/arm").await;
        peer.refuse(&parent, &WireError::new(Code::DENIED, "not for you").rule("lab"))
            .await;
        peer.refuse(&child, &WireError::new(Code::NOT_MEMBER, "join /robot first"))
            .await;
    });
    assert_eq!(
        found.unwrap_err().code(),
        Some(&Code::DENIED),
        "the cause, not what follows from it"
    );
    // The next attempt asks again.
    let (found, ()) = tokio::join!(
        client.channel("/robot/arm"),
        peer.joined("/robot/arm", "channel", Map::new())
    );
    assert_eq!(found.unwrap().path(), &path("/robot/arm"));
}

#[tokio::test]
async fn a_context_is_left_when_its_last_proxy_goes_after_what_was_sent() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let (arm, ()) = tokio::join!(
        client.channel("/robot/arm"),
        peer.joined("/robot/arm", "channel", Map::new())
    );
    let arm = arm.unwrap();
    // Known already, so nothing is asked.
    let robot = client.session("/robot").await.unwrap();
    let other = arm.clone();
    drop(arm);
    other.send("command", "grip open").await.unwrap();
    let events = other.events();
    drop(other);
    peer.expect("message command /robot/arm").await;
    let (found, ()) = tokio::join!(client.info("/x"), async {
        let request = peer.expect("context info /x").await;
        peer.ok(&request, Map::new()).await;
    });
    found.unwrap();
    drop(events);
    peer.expect("context leave /robot/arm").await;
    drop(robot);
    peer.expect("context leave /robot").await;
    // Nobody waits there any more, not even for a first subscriber.
    let mut others = client.unaddressed();
    peer.message("state", "/robot", "late").await;
    assert!(matches!(next(&mut others).await, Event::Message(_)));
}

#[tokio::test]
async fn to_leave_is_to_leave_all_below() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let (arm, ()) = tokio::join!(
        client.channel("/robot/arm"),
        peer.joined("/robot/arm", "channel", Map::new())
    );
    let arm = arm.unwrap();
    let mut events = arm.events();
    let robot = client.session("/robot").await.unwrap();
    let (left, ()) = tokio::join!(robot.leave(), async {
        let request = peer.expect("context leave /robot").await;
        peer.ok(&request, Map::new()).await;
    });
    left.unwrap();
    assert_eq!(events.next().await, None);
    drop((arm, events));
    // Nothing is left twice.
    let (found, ()) = tokio::join!(client.info("/x"), async {
        let request = peer.expect("context info /x").await;
        peer.ok(&request, Map::new()).await;
    });
    found.unwrap();
}

#[tokio::test]
async fn a_refused_send_is_told_to_its_channel() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, builder).await;
    let (arm, ()) = tokio::join!(
        client.channel("/robot/arm"),
        peer.joined("/robot/arm", "channel", Map::new())
    );
    let arm = arm.unwrap();
    let (mut events, mut others) = (arm.events(), client.unaddressed());
    let refusal = WireError::new(Code::NOT_OWNER, "bob drives").owner("bob", 1);
    arm.send("command", "grip open").await.unwrap();
    let sent = peer.expect("message command /robot/arm").await;
    peer.refuse(&sent, &refusal).await;
    assert_eq!(next(&mut events).await, Event::Refused(refusal.clone(), sent.id));

    // Where no channel is known, those who take the rest are told.
    client
        .send(Parcel::new(Family::Message, "chat").context(path("/chat")))
        .await
        .unwrap();
    let sent = peer.expect("message chat /chat").await;
    peer.refuse(&sent, &refusal).await;
    assert_eq!(next(&mut others).await, Event::Refused(refusal, sent.id));
    assert_eq!((events.try_next(), others.try_next()), (None, None));
}

#[tokio::test]
async fn closing_says_goodbye_after_all_that_was_sent() {
    for form in ["pair", "tcp", "bin"] {
        for drop_it in [false, true] {
            let (mut hub, builder) = match form {
                "pair" => local(),
                scheme => tcp(scheme).await,
            };
            let (client, mut peer) = logged_in(&mut hub, builder).await;
            let (mut state, mut others) = (client.state(), client.unaddressed());
            client
                .send(Parcel::new(Family::Message, "chat").context(path("/chat")))
                .await
                .unwrap();
            let script = async {
                peer.expect("message chat /chat").await;
                let logout = peer.expect("login logout /").await;
                peer.ok(&logout, Map::new()).await;
                assert_eq!(peer.hear_any().await.map(|parcel| words(&parcel)), None);
                peer.hang_up();
            };
            let close = async {
                match drop_it {
                    true => drop(client),
                    false => client.close().await,
                }
            };
            tokio::join!(close, script);
            assert_eq!(
                *state
                    .wait_for(|link| *link != LinkState::Connected)
                    .await
                    .unwrap(),
                LinkState::Closed(None)
            );
            assert_eq!(others.next().await, None, "{form}");
        }
    }
}
