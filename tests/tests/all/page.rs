//! What `docs/PROTOCOL.md` says beside its tables, by a peer that speaks in bytes.

use mom_broker::Broker;
use mom_client::{Client, Event};
use mom_proto::binary::{ChunkHead, chunks};
use mom_proto::codec::Form;
use mom_proto::{Content, ContextNumber, Delivery, Family, Limit, Map, Parcel, Time, Value, WireError};
use mom_tests::lab;
use mom_tests::raw::{PATIENCE, Raw, at, message};
use tokio::time::timeout;

const CHAT: &str = "/chat";

/// A frame around these bytes.
fn frame(bytes: &[u8]) -> Vec<u8> {
    let length = u32::try_from(bytes.len()).expect("a small frame");
    [&length.to_be_bytes()[..], bytes].concat()
}

/// The bytes of a parcel after the length in front.
fn size(parcel: &Parcel) -> usize {
    Form::Binary.encode(parcel).expect("a frame").len() - 4
}

/// A message of exactly so many bytes to a channel by its number, with an id of one byte.
fn sized(number: ContextNumber, bytes: usize) -> Parcel {
    let of = |content: usize| Parcel {
        number: Some(number),
        ..Parcel::new(Family::Message, "chat")
            .id(1)
            .content(Value::Binary(vec![7; content].into()))
    };
    let parcel = of(bytes - (size(&of(bytes - 100)) - (bytes - 100)));
    assert_eq!(size(&parcel), bytes);
    parcel
}

async fn enter(broker: &Broker, form: Form, user: &str, path: &str) -> (Raw, ContextNumber) {
    let mut peer = Raw::login(broker.local_addr(), form, user).await;
    let reply = peer.ask_about(Family::Context, "join", path).await.expect("may");
    let number = reply.get("number").and_then(Value::as_int).expect("a number");
    (peer, ContextNumber(number.unsigned_abs()))
}

/// Says it, and gives the echo.
async fn say(peer: &mut Raw, parcel: Parcel) -> Result<Parcel, WireError> {
    let id = peer.post(parcel).await;
    loop {
        let heard = peer.next().await.expect("the hub goes on");
        match heard.family {
            Family::Message => {
                assert_eq!(heard.id, Some(id));
                return Ok(heard);
            }
            Family::Error => return Err(WireError::from_parcel(&heard)),
            _ => {}
        }
    }
}

/// `Raw` takes nothing above the limit that it was told at login, whole or in chunks.
#[tokio::test]
async fn no_message_is_larger_than_its_receivers_were_told() {
    for most in [4000, 8 << 20] {
        let broker = lab::start_with(|config| config.limits.parcel = Limit::At(most as u64)).await;
        let (mut alice, number) = enter(&broker, Form::Binary, "alice", CHAT).await;
        let (mut bob, _) = enter(&broker, Form::Binary, "bob", CHAT).await;
        let first = say(&mut alice, sized(number, 200)).await.expect("small");
        bob.next_of(Family::Message, "chat").await;
        let stamps = size(&Parcel {
            context: None,
            ..first
        }) - 200;
        let mut carol = None;
        // Alone with binary receivers, and with one that reads XML, where it has to be written anew.
        for _ in 0..2 {
            for above in [stamps, 1] {
                let error = say(&mut alice, sized(number, most - stamps + above)).await;
                assert_eq!(error.expect_err("beyond").code.word(), "too-long");
            }
            let heard = say(&mut alice, sized(number, most - stamps))
                .await
                .expect("within");
            assert_eq!(heard.content, bob.next_of(Family::Message, "chat").await.content);
            match &mut carol {
                None => carol = Some(enter(&broker, Form::Xml, "carol", CHAT).await.0),
                Some(carol) => {
                    let lost = carol.next_of(Family::Event, "dropped").await.value();
                    assert_eq!(lost.get("reason"), Some(&Value::from("bad-content")));
                    say(&mut alice, sized(number, most / 2))
                        .await
                        .expect("within in XML");
                    carol.next_of(Family::Message, "chat").await;
                    bob.next_of(Family::Message, "chat").await;
                }
            }
        }
        broker.stop().await;
    }
}

/// What is kept is marked when a joiner gets it, and so a little larger than it was.
#[tokio::test]
async fn no_kept_message_is_larger_than_a_joiner_was_told() {
    let broker = lab::start_with(|config| config.limits.parcel = Limit::At(4000)).await;
    let mut carol = Raw::login(broker.local_addr(), Form::Binary, "carol").await;
    let spec = Map::new().with("kind", "channel").with("manager", "open");
    let spec = spec.with("keep", Map::new().with("parcels", 9));
    let create = Parcel::new(Family::Context, "create").context(at("/kept"));
    carol.ask(create.content(spec)).await.expect("operators may");
    let reply = carol
        .ask_about(Family::Context, "join", "/kept")
        .await
        .expect("may");
    let number = reply.get("number").and_then(Value::as_int).expect("a number");
    let number = ContextNumber(number.unsigned_abs());
    let first = say(&mut carol, sized(number, 200)).await.expect("small");
    let stamps = size(&Parcel {
        context: None,
        ..first
    }) - 200;
    for bytes in [4000 - stamps, 4000 - 128] {
        say(&mut carol, sized(number, bytes)).await.expect("within");
    }
    let (mut bob, _) = enter(&broker, Form::Binary, "bob", "/kept").await;
    for bytes in [200, 4000 - 128] {
        let kept = bob.next_of(Family::Message, "chat").await;
        assert_eq!(kept.content, sized(number, bytes).content);
        assert_eq!(kept.extra.get("history"), Some(&Value::Bool(true)));
    }
    broker.stop().await;
}

/// All of it in one write: what follows a login is handled as who has logged in by then.
#[tokio::test]
async fn a_client_need_not_wait_for_the_answer_to_its_login() {
    let broker = lab::start().await;
    for form in Form::ALL {
        let bytes = |password: &str| {
            let content = Map::new().with("name", "bob").with("password", password);
            let mut large = message("chat", CHAT, "x".repeat(20_000)).id(3);
            large.receipt = Some(true);
            let parcels = [
                Parcel::new(Family::Login, "login").content(content).id(1),
                Parcel::new(Family::Context, "join").context(at(CHAT)).id(2),
                large,
            ];
            let frames = parcels.map(|parcel| form.encode(&parcel).expect("a frame"));
            match form {
                Form::Xml | Form::Json => frames.map(|frame| frame.to_vec()).concat(),
                Form::Binary | Form::Packed => {
                    let [login, join, large] = frames;
                    [login.to_vec(), join.to_vec(), chunks(&large, 1, 9000).concat()].concat()
                }
            }
        };
        let mut bob = Raw::connect(broker.local_addr(), form).await;
        bob.send(&bytes("bob")).await;
        for id in 1..=3 {
            let answer = bob.answer(id).await;
            assert!(answer.is_ok_and(|answer| answer.is(Family::Reply, "ok")), "{id}");
        }
        let mut eve = Raw::connect(broker.local_addr(), form).await;
        eve.send(&bytes("eve")).await;
        for (id, code) in [(1, "bad-login"), (2, "not-logged-in")] {
            assert_eq!(eve.answer(id).await.expect_err("eve").code.word(), code);
        }
        // A stranger may neither say much nor cut it.
        let end = if form != Form::Binary {
            "too-large"
        } else {
            "bad-frame"
        };
        assert_eq!(eve.last_error().await.expect("the end").word(), end);
    }
    broker.stop().await;
}

/// Padded numbers, empty chunks, streams whose number comes again, content that is not a value: taken as the page says.
#[tokio::test]
async fn odd_frames_are_taken() {
    let broker = lab::start().await;
    let (mut alice, number) = enter(&broker, Form::Binary, "alice", CHAT).await;
    let (mut bob, _) = enter(&broker, Form::Binary, "bob", CHAT).await;
    let number = u8::try_from(number.0).expect("few contexts");
    // The bits of context, name, id and content, and an id with two groups of nothing; 0xc1 begins no value.
    let padded = frame(&[0, 0xb3, 0x80, 0, number | 0x80, 0, 9, 0x87, 0x80, 0, 0xc1]);
    // A bit, a slot and a frame of a version to come; no bit says that there is content.
    let later = frame(&[0, 0x93, 0x80, 0x80, 0x01, number, 9, 8, 3, 1, 2, 3, 0xc1]);
    let said = |id: u64| Form::Binary.encode(&message("chat", CHAT, "in chunks").id(id));
    let chunked = |id: u64, stream: u64| {
        let frame = said(id).expect("a frame").to_vec();
        let whole = Some(frame.len() - 4);
        let (one, two) = frame[4..].split_at(5);
        let head = |whole, last, piece| ChunkHead::new(stream, whole, last, piece).bytes().to_vec();
        [
            [head(whole, false, 0), head(None, false, 5), one.to_vec()].concat(),
            [head(None, false, 0), head(None, false, two.len()), two.to_vec()].concat(),
            head(None, true, 0),
        ]
    };
    let given_up = [&chunked(99, 0)[0][..], &frame(&[1, 0, 4, 1, 2, 3])].concat();
    let again = [chunked(10, 0).concat(), given_up, chunked(11, 0).concat()];
    let all = [padded, frame(&[200, 1, 2, 3]), later, again.concat()];
    alice.send(&all.concat()).await;
    for id in [7, 8, 10, 11] {
        let heard = bob.next_of(Family::Message, "chat").await;
        assert_eq!(heard.id, Some(id));
        match (id, &heard.content) {
            (7, Some(Content::Encoded(bytes))) => assert_eq!(bytes[..], [0xc1], "unopened"),
            (8, None) => {}
            _ => assert_eq!(heard.value(), Value::from("in chunks"), "{heard:?}"),
        }
    }
    alice.check_alive().await;
    broker.stop().await;
}

/// Receivers see what a sender wrote for the hub, too; only what the hub knows better is its own.
#[tokio::test]
async fn slots_reach_receivers_as_they_were_sent() {
    let broker = lab::start().await;
    let (mut bob, _) = enter(&broker, Form::Binary, "bob", CHAT).await;
    let (mut carol, _) = enter(&broker, Form::Xml, "carol", CHAT).await;
    for form in Form::ALL {
        let (mut alice, _) = enter(&broker, form, "alice", CHAT).await;
        let mut said = message("chat", CHAT, "all of it").id(5);
        said.reference = Some(4);
        said.address = Some(vec!["carol".into(), "bob".into()]);
        said.timestamp = Time::from_micros(1_795_255_200_000_000);
        said.priority = Some(-3);
        said.expires = Some(1 << 40);
        said.delivery = Some(Delivery::Latest);
        said.echo = Some(false);
        said.receipt = Some(true);
        said.extra = Map::new().with("z", 1).with("based-on", 7);
        alice.send_parcel(&said).await;
        alice.answer(5).await.expect("a receipt");
        for receiver in [&mut bob, &mut carol] {
            let heard = receiver.next_of(Family::Message, "chat").await;
            let expected = Parcel {
                sender: Some(alice.name().into()),
                received: heard.received,
                age: Some(0),
                number: heard.number,
                ..said.clone()
            };
            assert_eq!(heard, expected);
            assert_eq!(heard.number.is_some(), receiver.form() == Form::Binary);
        }
    }
    broker.stop().await;
}

/// Slots at the limit of the hub are beyond it with the stamps, and more so in XML: the limit is not one of receivers.
#[tokio::test]
async fn a_client_takes_slots_that_grew_on_their_way() {
    let broker = lab::start().await;
    let (mut alice, _) = enter(&broker, Form::Binary, "alice", CHAT).await;
    let beside = |length: usize| {
        let key = " ".repeat(10_000);
        let extra = Map::new().with(&key, "a name").with("most", "x".repeat(length));
        let parcel = Parcel::new(Family::Message, "chat").context(at(CHAT)).id(1);
        Parcel { extra, ..parcel }
    };
    let said = beside(50_000 + 65_536 - size(&beside(50_000)));
    for scheme in ["tcp", "bin"] {
        let builder = Client::builder(format!("{scheme}://{}", broker.local_addr()));
        let bob = builder.user("bob").password("bob").connect().await.expect("bob");
        let mut events = bob.channel(CHAT).await.expect("people may").events();
        alice.post(said.clone()).await;
        loop {
            let event = timeout(PATIENCE, events.next()).await.expect(scheme);
            if let Event::Message(heard) = event.expect("the hub goes on") {
                assert_eq!(heard.extra, said.extra);
                break;
            }
        }
        bob.close().await;
    }
    broker.stop().await;
}
