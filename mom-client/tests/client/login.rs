//! How a client proves who it is, on its first link and on every later one.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use ed25519_dalek::{Signature, VerifyingKey};
use mom_client::{
    Builder, Client, Code, ErrorKind, Event, Family, Key, LinkState, Map, Parcel, Proof, Reconnect, Value,
    WireError,
};
use mom_proto::{LOGIN_CONTEXT, login_challenge};
use std::time::Duration;

use crate::common::{Hub, Peer, local, logged_in, next, path, tcp};

fn quick(builder: Builder) -> Builder {
    builder.reconnect(Reconnect {
        first: Duration::from_millis(1),
        most: Duration::from_millis(10),
        give_up_after: None,
    })
}

fn content(parcel: &Parcel) -> Map {
    parcel.value().as_map().cloned().expect("a map")
}

fn welcome(user: &str) -> Map {
    Map::new().with("peer", user).with("user", user).with("level", 1)
}

async fn challenge(peer: &mut Peer, login: &Parcel, hub: &str, context: &str) {
    let nonce = Value::Binary(vec![7; 32].into());
    let asked = Map::new()
        .with("nonce", nonce)
        .with("hub", hub)
        .with("context", context);
    let mut reply = Parcel::new(Family::Reply, "challenge").content(asked);
    reply.reference = login.id;
    peer.say(reply).await;
}

/// The hub's part: it asks the key, checks what it answers, and says welcome.
async fn let_in(peer: &mut Peer, key: &Key) {
    let login = peer.expect("login login /").await;
    let asked = Map::new()
        .with("name", "alice")
        .with("key", true)
        .with("nickname", "ally");
    assert_eq!(content(&login), asked);
    challenge(peer, &login, "lab", LOGIN_CONTEXT).await;
    let answer = peer.expect("login answer /").await;
    assert_ne!(answer.id, login.id);
    let signature = content(&answer);
    let signature = signature.get("signature").and_then(Value::as_binary).unwrap();
    let public = STANDARD.decode(&key.public()["ed25519 ".len()..]).unwrap();
    let public = VerifyingKey::from_bytes(&public.try_into().unwrap()).unwrap();
    let signed = login_challenge("lab", "alice", &[7; 32]);
    public
        .verify_strict(&signed, &Signature::from_slice(signature).unwrap())
        .unwrap();
    peer.ok(&answer, welcome("alice")).await;
}

#[tokio::test]
async fn a_key_answers_what_the_hub_asks_on_every_link() {
    let key = Key::generate().unwrap();
    for form in ["pair", "tcp", "bin"] {
        let (mut hub, builder) = match form {
            "pair" => local(),
            scheme => tcp(scheme).await,
        };
        let builder = quick(builder.key(key.clone()).nickname("ally").hub_name("lab"));
        let (client, mut peer) = tokio::join!(builder.connect(), async {
            let mut peer = hub.accept().await;
            let_in(&mut peer, &key).await;
            peer
        });
        let client = client.unwrap();
        let (chat, ()) = tokio::join!(
            client.channel("/chat"),
            peer.joined("/chat", "channel", Map::new())
        );
        peer.hang_up();
        let mut peer = hub.accept().await;
        let_in(&mut peer, &key).await;
        peer.join_one("/chat", "channel", Map::new()).await;
        drop(chat.unwrap());
        peer.expect("context leave /chat").await;
    }
}

async fn refused(hub: &mut Hub, builder: Builder, name: &str, context: &str) -> mom_client::ClientError {
    let (client, mut peer) = tokio::join!(builder.connect(), async {
        let mut peer = hub.accept().await;
        let login = peer.expect("login login /").await;
        challenge(&mut peer, &login, name, context).await;
        peer
    });
    assert_eq!(peer.hear_any().await, None, "nothing was signed");
    client.expect_err("refused")
}

#[tokio::test]
async fn a_key_signs_for_nobody_else() {
    let (mut hub, _) = local();
    let key = Key::generate().unwrap();
    let mut attempt = async |name: &str, context: &str| {
        let (next, builder) = local();
        hub = next;
        let builder = builder.key(key.clone()).hub_name("lab");
        refused(&mut hub, builder, name, context).await
    };
    let error = attempt("other", LOGIN_CONTEXT).await;
    assert_eq!(
        (error.kind(), error.code()),
        (ErrorKind::Local, Some(&Code::BAD_LOGIN))
    );
    assert!(error.to_string().contains("lab"), "{error}");
    assert_eq!(attempt("lab", "transfer-money-1").await.kind(), ErrorKind::Local);
    // A login by password has nothing to sign with.
    let (mut hub, builder) = local();
    let error = refused(&mut hub, builder, "lab", LOGIN_CONTEXT).await;
    assert_eq!(error.kind(), ErrorKind::Local);
}

#[tokio::test]
async fn a_file_that_is_no_key_is_an_error_at_connect() {
    let (_hub, builder) = local();
    let error = builder.key_file("/no/such.key").connect().await.unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Local);
    assert!(error.to_string().contains("/no/such.key"), "{error}");
    // What is said last counts.
    let (mut hub, builder) = local();
    logged_in(&mut hub, builder.key_file("/no/such.key").password("x")).await;
}

#[tokio::test]
async fn tokens_and_guests() {
    let token = Map::new().with("token", "a.b.c");
    let guest = Map::new().with("guest", true).with("nickname", "gus");
    type Change = fn(Builder) -> Builder;
    let cases: [(Map, Change); 2] = [
        (token, |builder| builder.token("a.b.c")),
        (guest, |builder| builder.guest().nickname("gus")),
    ];
    for (said, change) in cases {
        let (mut hub, builder) = local();
        let (client, login) = tokio::join!(change(builder).connect(), async {
            let mut peer = hub.accept().await;
            (peer.log_in("ally", Map::new()).await, peer)
        });
        client.unwrap();
        assert_eq!(content(&login.0), said);
    }
}

/// A proof that is renewed in time is also the one for the next link.
#[tokio::test]
async fn authenticating_again() {
    let (mut hub, builder) = local();
    let (client, mut peer) = logged_in(&mut hub, quick(builder.token("old"))).await;
    let (chat, ()) = tokio::join!(
        client.channel("/chat"),
        peer.joined("/chat", "channel", Map::new())
    );
    let chat = chat.unwrap();
    let mut events = chat.events();
    let again = async |peer: &mut Peer, answer: Result<Map, WireError>| {
        let (outcome, ()) = tokio::join!(client.authenticate_again(Proof::Token("new".to_owned())), async {
            let login = peer.expect("login login /").await;
            assert_eq!(content(&login), Map::new().with("token", "new"));
            match answer {
                Ok(welcome) => peer.ok(&login, welcome).await,
                Err(error) => peer.refuse(&login, &error).await,
            }
        });
        outcome
    };
    let bad = WireError::new(Code::BAD_LOGIN, "expired");
    let error = again(&mut peer, Err(bad)).await.unwrap_err();
    assert_eq!(error.code(), Some(&Code::BAD_LOGIN));
    assert_eq!(client.level(), 1);
    again(&mut peer, Ok(welcome("alice").with("level", 4)))
        .await
        .unwrap();
    assert_eq!((client.level(), client.name()), (4, "alice".to_owned()));
    peer.message("chat", "/chat", "still here").await;
    assert!(
        matches!(next(&mut events).await, Event::Message(_)),
        "nothing was lost"
    );
    peer.hang_up();
    assert_eq!(next(&mut events).await, Event::LinkDown);
    let mut peer = hub.accept().await;
    let login = peer.log_in("alice", Map::new()).await;
    assert_eq!(content(&login), Map::new().with("token", "new"));
    peer.join_one("/chat", "channel", Map::new()).await;
    assert_eq!(next(&mut events).await, Event::Rejoined);
    // A token of another user makes another peer of it, which has joined nothing yet.
    again(&mut peer, Ok(welcome("bob"))).await.unwrap();
    assert_eq!(client.user(), "bob");
    assert_eq!(next(&mut events).await, Event::LinkDown);
    peer.join_one("/chat", "channel", Map::new()).await;
    assert_eq!(next(&mut events).await, Event::Rejoined);
    assert_eq!(*client.state().borrow(), LinkState::Connected);
    chat.send("chat", "good morning").await.unwrap();
    assert_eq!(peer.hear().await.context, Some(path("/chat")));
}

/// A key can take the place of a password on a live link.
#[tokio::test]
async fn a_key_authenticates_again() {
    let key = Key::generate().unwrap();
    let (mut hub, builder) = local();
    let (client, mut peer): (Client, Peer) = logged_in(&mut hub, builder.nickname("ally")).await;
    let (outcome, ()) = tokio::join!(
        client.authenticate_again(Proof::Key(key.clone())),
        let_in(&mut peer, &key)
    );
    outcome.unwrap();
}

/// A time in the wrong unit is found before a hub is even connected to.
#[tokio::test]
async fn a_heartbeat_out_of_range_is_refused_here() {
    for millis in [0, 99, 10_001, 500_000] {
        let (hub, builder) = local();
        let error = builder
            .heartbeat(Duration::from_millis(millis))
            .connect()
            .await
            .expect_err("out of range");
        assert_eq!(error.kind(), ErrorKind::Local, "{error}");
        assert!(
            error
                .to_string()
                .contains("a heartbeat must be from 100ms to 10s"),
            "{error}"
        );
        let Hub::Local(mut came) = hub else {
            unreachable!("a local one")
        };
        assert!(came.try_recv().is_err(), "{millis}: nobody was connected to");
    }
}
