//! Compression (M16): content travels compressed between peers that have agreed on it, opened by nobody on the way, and plain to
//! all others.

use std::time::Duration;

use mom_broker::Broker;
use mom_client::{Builder, Client, Event, Trust};
use mom_proto::codec::Form;
use mom_proto::{Code, Content, Family, Map, Packed, Parcel, Value};
use mom_tests::faulty::{Fault, FaultyNetwork};
use mom_tests::programs::PATIENCE;
use mom_tests::raw::{Raw, at, message};
use mom_tests::{lab, programs, tls};
use tokio::process::Command;
use tokio::time::timeout;

const CHAT: &str = "/chat";

/// What can be compressed well: a program for the arm.
fn program(lines: usize) -> String {
    (0..lines)
        .map(|line| format!("MoveL [[{line},0.0,712.0],[0.7071,0,0.7071,0]], vslow, fine, gripper;\n"))
        .collect()
}

/// What cannot.
fn noise(bytes: usize) -> Value {
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state.to_le_bytes()[3]
    };
    Value::Binary((0..bytes).map(|_| next()).collect::<Vec<u8>>().into())
}

async fn member(broker: &Broker, form: Form, user: &str) -> Raw {
    let mut raw = Raw::login(broker.local_addr(), form, user).await;
    raw.join(&[CHAT]).await;
    raw
}

async fn next_message(raw: &mut Raw) -> Parcel {
    loop {
        let parcel = raw.next().await.expect("the connection lives");
        if parcel.family == Family::Message {
            return parcel;
        }
    }
}

fn packed(parcel: &Parcel) -> Option<&Packed> {
    match &parcel.content {
        Some(Content::Packed(packed)) => Some(packed),
        _ => None,
    }
}

/// The frame of a message with compressed content that says that it unpacks to so many bytes.
fn frame_of(parcel: &Parcel, says: u64) -> Vec<u8> {
    let whole = Form::Packed.encode(parcel).expect("a message").to_vec();
    let read = Form::Packed.read(&whole).expect("our own");
    let length = packed(&read[0]).expect("it pays").length() as u64;
    let block = |length: u64| {
        let mut block = vec![1];
        let mut rest = length;
        loop {
            let more = if rest > 127 { 128 } else { 0 };
            block.push((rest & 127) as u8 | more);
            rest >>= 7;
            if more == 0 {
                break;
            }
        }
        block.insert(0, block.len() as u8);
        block
    };
    let (before, after) = (block(length), block(says));
    let place = whole
        .windows(before.len())
        .position(|bytes| bytes == before)
        .expect("the slot is there");
    let body = [&whole[4..place], &after, &whole[place + before.len()..]].concat();
    [&(body.len() as u32).to_be_bytes()[..], &body].concat()
}

/// A sender compresses once; the hub passes that on as it came to all that read it, and opens it once for the others.
#[tokio::test]
async fn compressed_content_passes_the_hub_as_it_came() {
    let broker = lab::start().await;
    let mut alice = member(&broker, Form::Packed, "alice").await;
    let mut readers = Vec::new();
    for form in [Form::Packed, Form::Packed, Form::Binary, Form::Xml, Form::Json] {
        readers.push(member(&broker, form, "bob").await);
    }
    for lines in [20, 2000] {
        let text = program(lines);
        let said = message("program", CHAT, text.as_str());
        let sent = Form::Packed
            .read(&Form::Packed.encode(&said).unwrap().to_vec())
            .unwrap();
        let sent = packed(&sent[0]).expect("it pays");
        alice.send_parcel(&said).await;
        for reader in &mut readers {
            let heard = next_message(reader).await;
            match reader.form() {
                Form::Packed => assert_eq!(packed(&heard), Some(sent), "the same bytes"),
                form => assert!(packed(&heard).is_none(), "{form:?}"),
            }
            assert_eq!(heard.value(), Value::from(text.as_str()), "{:?}", reader.form());
        }
        next_message(&mut alice).await;
    }
    broker.stop().await;
}

/// What others say plain, the hub compresses where that pays: not what is small, not pictures, not what is compressed already.
#[tokio::test]
async fn the_hub_compresses_what_pays() {
    let broker = lab::start().await;
    let mut carol = member(&broker, Form::Json, "carol").await;
    let mut bob = member(&broker, Form::Packed, "bob").await;
    let large = program(2000);
    for (name, content, pays) in [
        ("program", Value::from(large.as_str()), true),
        ("program", Value::from(program(20)), false),
        ("image", Value::from(large.as_str()), false),
        ("scan", noise(100_000), false),
    ] {
        carol.send_parcel(&message(name, CHAT, content.clone())).await;
        let heard = next_message(&mut bob).await;
        assert_eq!(packed(&heard).is_some(), pays, "{name}");
        assert_eq!(heard.value(), content, "{name}");
    }
    // They stay in order: the small one waits for the large one before it.
    for number in 0..20 {
        let content = match number % 2 {
            0 => format!("{number} {large}"),
            _ => number.to_string(),
        };
        carol.send_parcel(&message("line", CHAT, content)).await;
    }
    for number in 0..20 {
        let heard = next_message(&mut bob).await.value();
        let text = heard.as_str().expect("a line").split(' ').next();
        assert_eq!(text, Some(number.to_string().as_str()));
    }
    broker.stop().await;
}

/// Only who has asked for it, and in the binary form, gets and sends any; what comes before that is not opened.
#[tokio::test]
async fn compression_is_agreed_on_at_login() {
    let broker = lab::start().await;
    let login = |ways: &[&str]| {
        let ways: Vec<Value> = ways.iter().map(|way| Value::from(*way)).collect();
        let content = Map::new()
            .with("name", "bob")
            .with("password", "bob")
            .with("compress", ways);
        Parcel::new(Family::Login, "login").content(content)
    };
    for (form, ways, agreed) in [
        (Form::Binary, &["zstd"][..], Some("zstd")),
        (Form::Binary, &["snappy", "zstd"], Some("zstd")),
        (Form::Binary, &["snappy"], None),
        (Form::Json, &["zstd"], None),
        (Form::Xml, &["zstd"], None),
        (Form::Json, &["zstd", "stream-zstd"], Some("stream-zstd")),
        (
            Form::Xml,
            &["stream-deflate", "stream-zstd"],
            Some("stream-deflate"),
        ),
        (Form::Binary, &["stream-deflate", "zstd"], Some("stream-deflate")),
    ] {
        let mut bob = Raw::connect(broker.local_addr(), form).await;
        let welcome = bob.ask(login(ways)).await.expect("a user of the lab").value();
        let told = welcome.get("compress").and_then(Value::as_str);
        assert_eq!(told, agreed, "{form:?} {ways:?}");
    }
    let mut bob = Raw::connect(broker.local_addr(), Form::Binary).await;
    let mut wrong = login(&[]);
    wrong.content = Some(Map::new().with("guest", true).with("compress", "zstd").into());
    let error = bob.ask(wrong).await.expect_err("no list");
    assert_eq!(error.code, Code::BAD_CONTENT);
    assert_eq!(
        error.get("slot").and_then(Value::as_str),
        Some("content/compress")
    );

    let said = message("program", CHAT, program(100)).id(77);
    let packed = Form::Packed.encode(&said).unwrap().to_vec();
    // Before the login, and after one that did not ask.
    for logged_in in [false, true] {
        if logged_in {
            bob.log_in("bob").await;
        }
        bob.send(&packed).await;
        let error = bob.next_error().await;
        assert_eq!(error.code, Code::BAD_SLOT, "{error}");
        assert_eq!(error.get("slot").and_then(Value::as_str), Some("content"));
    }
    bob.check_alive().await;
    broker.stop().await;
}

/// What would grow beyond a parcel is refused before it is opened; what lies about its length reaches nobody who has to open it
/// here, and those who open it themselves get an error.
#[tokio::test]
async fn a_bomb_is_refused() {
    let broker = lab::start().await;
    let mut alice = member(&broker, Form::Packed, "alice").await;
    let mut json = member(&broker, Form::Json, "bob").await;
    let mut reader = member(&broker, Form::Packed, "carol").await;
    let said = message("program", CHAT, program(2000));
    for says in [1 << 40, u64::MAX, 64 << 20] {
        alice.send(&frame_of(&said, says)).await;
        let error = alice.next_error().await;
        assert_eq!(error.code, Code::TOO_LONG, "{error}");
    }
    let length = message("program", CHAT, program(2000))
        .content
        .unwrap()
        .to_msgpack()
        .unwrap()
        .len() as u64;
    for says in [length - 1, length + 1, 3] {
        alice.send(&frame_of(&said, says)).await;
        let heard = next_message(&mut reader).await;
        let error = heard.content.expect("some").to_value().expect_err("a lie");
        assert_eq!(error.code, Code::BAD_CONTENT, "{error}");
        let told = json.next_of(Family::Event, "dropped").await.value();
        assert_eq!(
            told.get("reason").and_then(Value::as_str),
            Some("bad-content"),
            "{told:?}"
        );
    }
    alice.send_parcel(&message("chat", CHAT, "the hub lives")).await;
    assert_eq!(
        next_message(&mut json).await.value(),
        Value::from("the hub lives")
    );
    broker.stop().await;
}

/// What a channel keeps stays compressed, and each late joiner gets it in a form that it reads.
#[tokio::test]
async fn late_joiners_get_what_was_kept_compressed() {
    let broker = lab::start().await;
    let mut carol = Raw::login(broker.local_addr(), Form::Packed, "carol").await;
    let spec = Map::new()
        .with("kind", "channel")
        .with("manager", "open")
        .with("keep", Map::new().with("parcels", 10));
    let create = Parcel::new(Family::Context, "create")
        .context(at("/desk"))
        .content(spec);
    carol.ask(create).await.expect("operators may");
    carol.join(&["/desk"]).await;
    let text = program(2000);
    carol
        .send_parcel(&message("program", "/desk", text.as_str()))
        .await;
    next_message(&mut carol).await;
    for form in [Form::Packed, Form::Binary, Form::Json, Form::Xml] {
        let mut late = Raw::login(broker.local_addr(), form, "bob").await;
        late.join(&["/desk"]).await;
        let heard = next_message(&mut late).await;
        assert_eq!(packed(&heard).is_some(), form == Form::Packed, "{form:?}");
        assert_eq!(heard.value(), Value::from(text.as_str()), "{form:?}");
    }
    broker.stop().await;
}

fn client(address: String, broker: &Broker, user: &str) -> Builder {
    Client::builder(address)
        .user(user)
        .password(user)
        .trust(Trust::Pinned(broker.fingerprint().expect("it has a certificate")))
        .compress(true)
}

/// How many bytes the hub has taken from a user's connection, and given to it.
async fn carried(asking: &Client, user: &str) -> (u64, u64) {
    let stats = asking.stats("/").await.expect("operators may");
    let peer = stats.peers.into_iter().find(|peer| peer.user == user);
    let peer = peer.expect("it is here");
    (peer.received, peer.sent)
}

/// On TCP, a WebSocket and a tunnel, with TLS and without, in each form: a tenth of the bytes travels, both ways.
#[tokio::test]
async fn clients_compress_on_every_door() {
    let broker = lab::start_with(|config| config.tls = tls::of_hub()).await;
    let address = broker.local_addr();
    let carol = client(format!("bins://{address}"), &broker, "carol")
        .connect()
        .await;
    let carol = carol.expect("a user of the lab");
    let text = program(4000);
    for door in [
        "bin",
        "bins",
        "ws",
        "wss",
        "http",
        "https",
        "tcp",
        "tcps",
        "json",
        "jsons",
        "ws?form=json",
        "wss?form=json",
        "http?form=xml",
        "https?form=json",
    ] {
        let (scheme, query) = door.split_at(door.find('?').unwrap_or(door.len()));
        let bob = client(format!("{scheme}://{address}{query}"), &broker, "bob")
            .connect()
            .await;
        let bob = bob.unwrap_or_else(|error| panic!("{door}: {error}"));
        let chat = bob.channel(CHAT).await.expect("anybody may");
        let mut events = chat.events();
        let before = carried(&carol, "bob").await;
        chat.send("program", text.as_str()).await.expect("anybody may");
        let heard = async {
            loop {
                match events.next().await {
                    Some(Event::Message(parcel)) => return parcel,
                    Some(_) => {}
                    None => panic!("{door}: the connection has ended"),
                }
            }
        };
        let heard = timeout(PATIENCE, heard).await.expect("it comes back");
        assert_eq!(heard.value(), Value::from(text.as_str()), "{door}");
        let after = carried(&carol, "bob").await;
        let most = text.len() as u64 / 10;
        assert!(
            after.0 - before.0 < most,
            "{door}: {before:?} {after:?} of {}",
            text.len()
        );
        assert!(
            after.1 - before.1 < most,
            "{door}: {before:?} {after:?} of {}",
            text.len()
        );
        bob.close().await;
    }
    carol.close().await;
    broker.stop().await;
}

/// What was agreed on holds as long as the link: after a loss both ends go on compressed, and what was under way comes once.
#[tokio::test]
async fn a_link_goes_on_compressed() {
    let broker = lab::start_with(|config| config.tls = tls::of_hub()).await;
    let network = FaultyNetwork::to(broker.local_addr(), |_| Fault::default()).await;
    let carol = client(format!("bins://{}", broker.local_addr()), &broker, "carol")
        .connect()
        .await;
    let carol = carol.expect("a user of the lab");
    let bob = client(format!("bins://{}", network.address), &broker, "bob")
        .link(Duration::from_secs(60))
        .connect()
        .await
        .expect("a user of the lab");
    let (ours, theirs) = (
        bob.channel(CHAT).await.unwrap(),
        carol.channel(CHAT).await.unwrap(),
    );
    let (mut at_bob, mut at_carol) = (ours.events(), theirs.events());
    let text = program(2000);
    for round in 0..6_i64 {
        let said = |who: &str| {
            Map::new()
                .with("who", who)
                .with("round", round)
                .with("text", text.as_str())
        };
        ours.send("program", said("bob")).await.expect("anybody may");
        theirs.send("program", said("carol")).await.expect("anybody may");
        network.sever();
    }
    for (who, events) in [("bob", &mut at_bob), ("carol", &mut at_carol)] {
        let mut rounds = Map::new();
        let all = async {
            for _ in 0..12 {
                let parcel = loop {
                    match events.next().await {
                        Some(Event::Message(parcel)) => break parcel,
                        Some(_) => {}
                        None => panic!("{who}: the connection has ended"),
                    }
                };
                let said = parcel.value();
                assert_eq!(said.get("text").and_then(Value::as_str), Some(text.as_str()));
                let from = said
                    .get("who")
                    .and_then(Value::as_str)
                    .expect("a peer")
                    .to_owned();
                let round = said.get("round").and_then(Value::as_int).expect("a round");
                let expected = rounds.get(&from).and_then(Value::as_int).unwrap_or_default();
                assert_eq!(round, expected, "{who} hears {from}: in order, and each once");
                rounds.set(&from, round + 1);
            }
        };
        timeout(PATIENCE, all).await.expect("all comes");
    }
    let (taken, given) = carried(&carol, "bob").await;
    let plain = 6 * text.len() as u64;
    assert!(
        taken < plain / 2 && given < plain,
        "{taken} and {given} of {plain}"
    );
    bob.close().await;
    carol.close().await;
    broker.stop().await;
}

/// The command line asks for it, too.
#[tokio::test]
async fn mom_compresses_when_told() {
    let broker = lab::start().await;
    let mut bob = member(&broker, Form::Packed, "bob").await;
    for (options, compressed) in [(&[][..], false), (&["--compress"][..], true)] {
        // Short enough for the hub to leave it as it is.
        let script = program(30);
        let mut command = Command::new(programs::program("mom"));
        command.args(["send", CHAT, "program", &script]).args(options);
        command.args(["--hub", &format!("bin://{}", broker.local_addr())]);
        command.env("MOM_USER", "alice").env("MOM_PASSWORD", "alice");
        let output = timeout(PATIENCE, command.output())
            .await
            .expect("in time")
            .expect("it runs");
        assert!(output.status.success(), "{output:?}");
        let heard = next_message(&mut bob).await;
        assert_eq!(packed(&heard).is_some(), compressed, "{options:?}");
        assert_eq!(heard.value(), Value::from(script.as_str()));
    }
    broker.stop().await;
}

/// Compression takes nobody around a bound of bytes: they are counted decompressed, regardless of who compressed them.
#[tokio::test]
async fn a_quota_counts_what_content_unpacks_to() {
    let broker = lab::start_at(lab::clock(), |_| {}).await;
    let mut carol = Raw::login(broker.local_addr(), Form::Packed, "carol").await;
    let limit = Map::new()
        .with("bytes", 1)
        .with("bytes-burst", 200_000)
        .with("verbs", vec![Value::from("send")]);
    let quota = Map::new()
        .with("kind", "quota")
        .with("limits", vec![Value::from(limit)]);
    let open = Map::new()
        .with("kind", "chain")
        .with("of", vec![Value::from(quota)]);
    let spec = Map::new().with("kind", "channel").with("manager", open);
    let create = Parcel::new(Family::Context, "create")
        .context(at("/desk"))
        .content(spec);
    carol.ask(create).await.expect("operators may");
    carol.join(&["/desk"]).await;
    let said = || {
        let mut said = message("program", "/desk", program(2000));
        said.receipt = Some(true);
        said
    };
    let size = said().content.expect("a text").size();
    assert!((100_000..200_000).contains(&size), "{size}");
    carol.ask(said()).await.expect("the first one");
    let error = carol.ask(said()).await.expect_err("more than is left");
    assert_eq!(error.code.word(), "over-quota", "{error}");
    broker.stop().await;
}
