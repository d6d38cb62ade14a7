//! Who joins late gets what a channel has kept: in order, marked, with its true age, and never what moves a device.

use std::time::Duration;

use mom_broker::Broker;
use mom_client::{Client, Event};
use mom_proto::codec::Form;
use mom_proto::{Code, Family, HISTORY, Map, Parcel, Value};
use mom_tests::lab;
use mom_tests::programs::{program, text};
use mom_tests::raw::{PATIENCE, Raw, at, message};
use tokio::process::Command;
use tokio::task::spawn_blocking;
use tokio::time::timeout;

const PLACE: &str = "/desk";

/// Makes a channel that keeps something.
async fn made(carol: &mut Raw, keep: Map) {
    let spec = Map::new()
        .with("kind", "channel")
        .with("manager", "open")
        .with("keep", keep);
    let create = Parcel::new(Family::Context, "create")
        .context(at(PLACE))
        .content(spec);
    carol.ask(create).await.expect("operators may");
    carol.join(&[PLACE]).await;
}

async fn say(peer: &mut Raw, name: &str, text: &str) {
    let mut parcel = message(name, PLACE, text);
    parcel.receipt = Some(true);
    // What a peer says of history is not what the hub says.
    parcel.extra.set(HISTORY, true);
    if name == "unstop" {
        parcel.extra.set("stop", peer.newest_stop(PLACE).await);
    }
    peer.ask(parcel).await.expect("all may");
}

async fn login(broker: &Broker, form: Form, user: &str) -> Raw {
    Raw::login(broker.local_addr(), form, user).await
}

/// What a joiner hears from its request up to a message said after that: sender, text and age.
async fn heard(bob: &mut Raw, carol: &mut Raw) -> Vec<(String, String, i64)> {
    let id = bob
        .post(Parcel::new(Family::Context, "join").context(at(PLACE)))
        .await;
    bob.answer(id).await.expect("all may");
    say(carol, "mark", "end").await;
    let mut heard = Vec::new();
    loop {
        let parcel = bob.next().await.expect("the connection lives");
        if parcel.family != Family::Message {
            continue;
        }
        let mark = parcel.name() == "mark";
        if mark && parcel.extra.get(HISTORY).is_none() {
            return heard;
        }
        assert_eq!(parcel.extra.get(HISTORY), Some(&Value::from(true)), "{parcel:?}");
        let sender = parcel.sender.as_deref().unwrap_or_default().to_owned();
        let text = parcel.value().as_str().unwrap_or_default().to_owned();
        heard.push((sender, text, parcel.age.expect("an age")));
    }
}

fn line(sender: &str, text: &str, age: i64) -> (String, String, i64) {
    (sender.to_owned(), text.to_owned(), age)
}

#[tokio::test]
async fn the_newest_of_each_sender_with_its_age() {
    for (form, other) in [(Form::Xml, Form::Binary), (Form::Binary, Form::Xml)] {
        let clock = lab::clock();
        let broker = lab::start_at(clock.clone(), |_| {}).await;
        let mut carol = login(&broker, form, "carol").await;
        made(&mut carol, Map::new().with("latest", true)).await;
        let mut arm = login(&broker, other, "arm").await;
        arm.join(&[PLACE]).await;
        say(&mut carol, "state", "one").await;
        say(&mut arm, "state", "two").await;
        clock.advance(Duration::from_millis(30));
        say(&mut carol, "state", "three").await;
        clock.advance(Duration::from_millis(5));

        let mut bob = login(&broker, other, "bob").await;
        let expected = [line("arm", "two", 35_000), line("carol", "three", 5_000)];
        assert_eq!(heard(&mut bob, &mut carol).await, expected);

        // A state of nobody is not a state.
        arm.ask_about(Family::Context, "leave", PLACE)
            .await
            .expect("nobody is kept");
        let mut alice = login(&broker, form, "alice").await;
        let all = heard(&mut alice, &mut carol).await;
        assert_eq!(all[..1], [line("carol", "three", 5_000)]);
        assert_eq!(all.len(), 2, "and the mark of before: {all:?}");
    }
}

#[tokio::test]
async fn a_history_without_what_moves_a_device() {
    let broker = lab::start().await;
    let mut carol = login(&broker, Form::Xml, "carol").await;
    made(&mut carol, Map::new().with("parcels", 3)).await;
    for (name, text) in [
        ("say", "a"),
        ("say", "b"),
        ("command", "left"),
        ("stop", ""),
        ("unstop", ""),
        ("say", "c"),
    ] {
        say(&mut carol, name, text).await;
    }
    let mut to_me = message("say", PLACE, "to me");
    to_me.address = Some(vec!["carol".into()]);
    to_me.receipt = Some(true);
    carol.ask(to_me).await.expect("all may");
    say(&mut carol, "say", "d").await;
    let mut bob = login(&broker, Form::Binary, "bob").await;
    let texts: Vec<String> = heard(&mut bob, &mut carol)
        .await
        .into_iter()
        .map(|(_, text, _)| text)
        .collect();
    assert_eq!(texts, ["b", "c", "d"]);
    let info = bob
        .ask_about(Family::Context, "info", PLACE)
        .await
        .expect("all may");
    let parcels = info
        .get("keep")
        .and_then(|keep| keep.get("parcels"))
        .and_then(Value::as_int);
    assert_eq!(parcels, Some(3));
}

#[tokio::test]
async fn what_is_kept_has_bounds() {
    let broker = lab::start().await;
    let mut carol = login(&broker, Form::Xml, "carol").await;
    for (keep, slot) in [
        (Map::new(), "content/keep"),
        (Map::new().with("parcels", 0), "content/keep/parcels"),
        (Map::new().with("parcels", 10_001), "content/keep/parcels"),
        (Map::new().with("bytes", 17 << 20), "content/keep/bytes"),
    ] {
        let spec = Map::new().with("kind", "channel").with("keep", keep);
        let create = Parcel::new(Family::Context, "create")
            .context(at(PLACE))
            .content(spec);
        let error = carol.ask(create).await.expect_err("out of bounds");
        assert_eq!(
            (&error.code, error.get("slot").and_then(Value::as_str)),
            (&Code::BAD_CONTENT, Some(slot))
        );
    }
}

#[tokio::test]
async fn a_client_hears_it_first() {
    let broker = lab::start().await;
    let mut carol = login(&broker, Form::Binary, "carol").await;
    made(&mut carol, Map::new().with("parcels", 500)).await;
    for number in 0..200 {
        say(&mut carol, "say", &number.to_string()).await;
    }
    let builder = Client::builder(format!("bin://{}", broker.local_addr()));
    let bob = builder
        .user("bob")
        .password("bob")
        .connect()
        .await
        .expect("a user of the lab");
    let mut events = bob.channel(PLACE).await.expect("all may").events();
    for number in 0..200 {
        match timeout(PATIENCE, events.next()).await.expect("it is given") {
            Some(Event::Message(parcel)) => assert_eq!(parcel.value().as_str(), Some(&*number.to_string())),
            other => panic!("{other:?} instead of {number}"),
        }
    }
}

/// Who watches sees what was before, and that it was.
#[tokio::test(flavor = "multi_thread")]
async fn the_command_line_marks_it() {
    let clock = lab::clock();
    let broker = lab::start_at(clock.clone(), |_| {}).await;
    let mut carol = login(&broker, Form::Binary, "carol").await;
    made(&mut carol, Map::new().with("parcels", 9)).await;
    say(&mut carol, "state", "up").await;
    clock.advance(Duration::from_secs(12));
    let built = spawn_blocking(|| program("mom")).await.expect("it is built");
    let watch = async |more: &[&str]| {
        let mut command = Command::new(&built);
        command
            .args(["watch", "--messages", "--count", "1", PLACE])
            .args(more);
        command.env("MOM_HUB", format!("tcp://{}", broker.local_addr()));
        command.env("MOM_USER", "bob").env("MOM_PASSWORD", "bob");
        let output = timeout(PATIENCE, command.kill_on_drop(true).output()).await;
        text(&output.expect("it ends").expect("it runs").stdout)
    };
    let line = watch(&[]).await;
    assert!(
        line.contains("carol state (history, at least 12 s old): up"),
        "{line}"
    );
    let json: serde_json::Value = serde_json::from_str(&watch(&["--json"]).await).expect("JSON");
    assert_eq!(
        (&json["history"], &json["age"], &json["content"]),
        (&true.into(), &12_000_000.into(), &"up".into()),
        "{json}"
    );
}
