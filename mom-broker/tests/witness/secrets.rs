//! No secret is ever written down, however it was typed.

use mom_net::Address;
use mom_proto::codec::Frame;
use mom_proto::{Family, Limits, Map, Parcel, Value};

use crate::lab::{Lab, PASSWORD};
use crate::program::Running;

/// Says something on a connection of its own, and waits for the answer.
async fn say(address: &str, parcels: Vec<Parcel>) -> Vec<String> {
    let address: Address = format!("tcp://{address}").parse().expect("an address");
    let mut link = mom_net::connect(&address, &Limits::default(), None)
        .await
        .expect("it listens");
    let mut answers = Vec::new();
    for parcel in parcels {
        link.writer.send(parcel.id(1)).await.expect("it hears");
        loop {
            match link.reader.next().await.expect("a link") {
                Some(Frame::Parcel(parcel)) if parcel.family == Family::Event => {}
                Some(Frame::Parcel(parcel)) => {
                    answers.push(parcel.name().to_owned());
                    break;
                }
                other => panic!("{other:?}"),
            }
        }
    }
    answers
}

fn login(content: impl Into<Value>) -> Parcel {
    Parcel::new(Family::Login, "login").content(content.into())
}

#[tokio::test]
async fn passwords_are_nowhere() {
    const WRONG: &str = "hunter2-Wx9-wrong";
    let lab = Lab::new("log = \"trace\"\naudit = { path = \"audit.jsonl\" }\nlogin = { attempts = 100 }");
    let running = Running::start(&lab, &["--record", "control.jsonl"]);
    let address = &running.address;
    let named = |name: &str, password: &str| Map::new().with("name", name).with("password", password);
    let right = login(named("alice", PASSWORD));
    // After the login a mistyped verb goes to the hub, secret and all.
    let mut mistyped = login(named("alice", WRONG));
    mistyped.name = "logon".into();
    let said = say(
        address,
        vec![right.clone(), mistyped, login(named("alice", WRONG))],
    )
    .await;
    assert_eq!(said, ["ok", "unknown-verb", "bad-login"]);
    let said = say(
        address,
        vec![
            login(named(WRONG, "x")),
            login(named("bob", WRONG)),
            login(
                Map::new()
                    .with("name", "bob")
                    .with("password", 424_242_424_242_i64),
            ),
            login(Map::new().with("name", "bob").with(WRONG, "x")),
            login(WRONG),
            login(named("bob", "x").with("nickname", format!("{WRONG}/").as_str())),
            login(Map::new().with("token", "eyJhbGciOi.eyJzdWIi.SIGNED")),
            login(named(WRONG, PASSWORD)),
        ],
    )
    .await;
    assert!(said.iter().all(|word| word != "ok"), "{said:?}");
    let challenge = login(Map::new().with("name", "bob").with("key", true));
    let signature = bytes::Bytes::from_static(&[b'S'; 64]);
    let answer = Parcel::new(Family::Login, "answer").content(Map::new().with("signature", signature));
    assert_eq!(
        say(address, vec![challenge, answer]).await,
        ["challenge", "bad-login"]
    );
    let mut hidden = Parcel::new(Family::Message, "say").content(WRONG);
    hidden.receipt = Some(true);
    hidden.context = mom_proto::Path::parse("/chat").ok();
    let mut join = Parcel::new(Family::Context, "join");
    join.context.clone_from(&hidden.context);
    let said = say(address, vec![right, join, hidden]).await;
    assert_eq!(said, ["ok", "ok", "ok"]);
    running.stop();
    for name in ["audit.jsonl", "control.jsonl", "log.txt"] {
        let text = lab.read(name);
        for secret in [
            PASSWORD,
            WRONG,
            "424242424242",
            "eyJhbGciOi",
            "SIGNED",
            "argon2",
            "SSSS",
            "U1NTU1",
        ] {
            let line = text.lines().find(|line| line.contains(secret));
            assert_eq!(line, None, "{secret} in {name}");
        }
    }
    assert!(lab.read("log.txt").contains("login refused"));
    assert!(lab.read("audit.jsonl").contains("\"bad-login\""));
    assert!(lab.read("control.jsonl").contains("\"alice\""));
}

#[cfg(target_os = "linux")]
#[tokio::test]
async fn a_full_disk_stops_nothing() {
    let lab = Lab::new("audit = { path = \"/dev/full\" }");
    let running = Running::start(&lab, &[]);
    let address = &running.address;
    let content = Map::new().with("name", "alice").with("password", PASSWORD);
    assert_eq!(say(address, vec![login(content)]).await, ["ok"]);
    running.stop();
    let log = lab.read("log.txt");
    assert!(log.contains("the audit log cannot be written"), "{log}");
    assert!(log.contains("stopped"), "{log}");
}

#[tokio::test]
async fn without_a_file_the_log_has_it() {
    let lab = Lab::new("log = \"warn,audit=info\"");
    let running = Running::start(&lab, &[]);
    let address = &running.address;
    let content = Map::new().with("name", "alice").with("password", PASSWORD);
    assert_eq!(say(address, vec![login(content)]).await, ["ok"]);
    running.stop();
    let log = lab.read("log.txt");
    assert!(
        log.contains(" INFO ") && log.contains("audit: {\"at\":\"") && log.contains("\"what\":\"stopped\""),
        "{log}"
    );
}
