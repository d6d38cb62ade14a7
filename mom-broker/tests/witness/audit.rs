//! Every grant, refusal, loss, login and change, as a line.

use mom_proto::{Family, Map, Parcel, Verb};
use serde_json::{Value as Json, json};

use crate::lab::{Lab, PASSWORD, Peer};

/// The lines without what is the same in all, `key=value` each.
fn words(line: &Json) -> String {
    let line = line.as_object().expect("an object");
    let words = line
        .iter()
        .filter(|(key, _)| !matches!(key.as_str(), "at" | "seq" | "sha256" | "version"));
    let word = |(key, value): (&String, &Json)| match value {
        Json::String(text) => format!("{key}={text}"),
        other => format!("{key}={other}"),
    };
    words.map(word).collect::<Vec<_>>().join(" ")
}

#[tokio::test]
async fn who_did_what_by_which_rule() {
    let lab = Lab::new("audit = { path = \"audit.jsonl\" }");
    let (broker, _clock) = lab.start().await;
    let mut alice = Peer::xml(&broker, "alice").await;
    let mut bob = Peer::binary(&broker, "bob").await;
    for peer in [&mut alice, &mut bob] {
        for path in ["/robot", "/robot/arm"] {
            assert_eq!(peer.verb(Verb::Join, path).await, "ok");
        }
    }
    assert_eq!(alice.verb(Verb::Grab, "/robot/token").await, "ok");
    assert_eq!(bob.verb(Verb::Grab, "/robot/token").await, "denied");
    let mut carol = Peer::xml(&broker, "carol").await;
    for path in ["/robot", "/robot/token"] {
        assert_eq!(carol.verb(Verb::Join, path).await, "ok");
    }
    assert_eq!(carol.verb(Verb::Grab, "/robot/token").await, "ok");
    assert_eq!(carol.verb(Verb::Release, "/robot/token").await, "ok");
    assert_eq!(carol.verb(Verb::Logout, "/").await, "ok");
    broker.stop().await;

    let lines = lab.lines("audit.jsonl");
    let times: Vec<&Json> = lines.iter().map(|line| &line["at"]).collect();
    assert!(
        times.iter().all(|at| **at == "2026-11-21T10:00:00.000000Z"),
        "{times:?}"
    );
    let seq: Vec<Json> = lines.iter().map(|line| line["seq"].clone()).collect();
    assert_eq!(seq, (1..=lines.len()).map(|n| json!(n)).collect::<Vec<_>>());
    assert_eq!(lines[0]["sha256"].as_str().map(str::len), Some(64));
    let epoch = 1_795_255_200_i64 << 20;
    let (one, two) = (epoch + 1, epoch + 2);
    let told: Vec<String> = lines.iter().map(words).collect();
    let expected = [
        "what=started config=lab.toml".to_owned(),
        "what=login peer=alice user=alice level=1 from=127.0.0.1".to_owned(),
        "what=login peer=bob user=bob level=1 from=127.0.0.1".to_owned(),
        format!(
            "what=granted peer=alice user=alice level=1 context=/robot/token rule=lab/alice drives fence={one}"
        ),
        "what=refused peer=bob user=bob level=1 verb=grab context=/robot/token rule=lab code=denied"
            .to_owned(),
        "what=login peer=carol user=carol level=5 from=127.0.0.1".to_owned(),
        format!(
            "what=lost peer=alice user=alice level=1 context=/robot/token fence={one} reason=preempted by=carol"
        ),
        format!(
            "what=granted peer=carol user=carol level=5 context=/robot/token rule=lab/carol may all fence={two} reason=preempted"
        ),
        format!(
            "what=lost peer=carol user=carol level=5 context=/robot/token fence={two} reason=released by=carol"
        ),
        "what=gone peer=carol user=carol level=5".to_owned(),
        // Both go when the broker does, in whatever order.
        "what=gone".to_owned(),
        "what=gone".to_owned(),
        "what=stopped".to_owned(),
    ];
    for (told, expected) in told.iter().zip(&expected) {
        match expected.as_str() {
            "what=gone" => assert!(told.starts_with(expected), "{told}"),
            _ => assert_eq!(*told, *expected),
        }
    }
    assert_eq!(told.len(), expected.len(), "{told:#?}");
}

#[tokio::test]
async fn what_the_hub_does_not_see_is_told_too() {
    let lab = Lab::new("audit = { path = \"audit.jsonl\" }");
    let (broker, _clock) = lab.start().await;
    let mut alice = Peer::xml(&broker, "alice").await;
    assert_eq!(alice.verb(Verb::Join, "/chat").await, "ok");
    const SHOUTS: u64 = 500;
    for _ in 0..SHOUTS {
        assert_eq!(alice.message("shout", "/chat", "hey").await, "denied");
    }
    // Not a member there.
    assert_eq!(alice.message("say", "/robot/arm", "hey").await, "not-member");
    let mut eve = Peer::connect(&broker, "tcp").await;
    // A password in the place of the name, a wrong one in the right place, and once too often.
    assert_eq!(eve.login(PASSWORD, "x").await.name(), "bad-login");
    assert_eq!(eve.login("bob", "wrong").await.name(), "bad-login");
    eve.login("bob", "wrong again").await;
    // A key that bob has not.
    let mut mallory = Peer::connect(&broker, "bin").await;
    let challenge = Map::new().with("name", "bob").with("key", true);
    let challenge = Parcel::new(Family::Login, "login").content(challenge);
    assert_eq!(mallory.ask(challenge).await.name(), "challenge");
    let signature = Map::new().with("signature", bytes::Bytes::from_static(&[7; 64]));
    let answer = Parcel::new(Family::Login, "answer").content(signature);
    assert_eq!(mallory.ask(answer).await.name(), "bad-login");
    broker.stop().await;

    let lines = lab.lines("audit.jsonl");
    let of = |what: &str| -> Vec<String> {
        lines
            .iter()
            .map(words)
            .filter(|words| words.contains(what))
            .collect()
    };
    let shout = "what=refused peer=alice user=alice level=1 verb=send context=/chat message=shout \
                 rule=lab/nobody shouts code=denied";
    let shouts = of("message=shout");
    assert_eq!(shouts[0], shout);
    let counted: u64 = lines
        .iter()
        .filter(|line| line["message"] == "shout")
        .map(|line| line["count"].as_u64().unwrap_or(1))
        .sum();
    assert_eq!(counted, SHOUTS, "each is counted, in {} lines", shouts.len());
    assert!(shouts.len() < 50, "{}", shouts.len());
    assert_eq!(
        of("context=/robot/arm"),
        [
            "what=refused peer=alice user=alice level=1 verb=send context=/robot/arm message=say code=not-member"
        ]
    );
    let refused = |user: &str, code: &str| -> u64 {
        let alike = lines
            .iter()
            .filter(|line| line["verb"] == "login" && line["user"] == user && line["code"] == code);
        let from_here = alike.inspect(|line| assert_eq!(line["from"], "127.0.0.1", "{line}"));
        from_here.map(|line| line["count"].as_u64().unwrap_or(1)).sum()
    };
    for (user, code, count) in [
        ("unknown", "bad-login", 1),
        ("bob", "bad-login", 3),
        ("bob", "too-many-logins", 1),
    ] {
        assert_eq!(refused(user, code), count, "{user} {code}");
    }
}

#[tokio::test]
async fn a_broker_that_cannot_be_audited_does_not_start() {
    let lab = Lab::new("audit = { path = \"there/is/no/such/folder/audit.jsonl\" }");
    let refused = mom_broker::Broker::start(lab.config())
        .await
        .expect_err("no folder");
    let words = refused.to_string();
    assert!(
        words.contains("cannot write the audit log") && words.contains("such/folder/audit.jsonl"),
        "{words}"
    );

    let lab = Lab::new("audit = { path = \"audit.jsonl\" }");
    let (broker, _clock) = lab.start().await;
    let second = mom_broker::Broker::start(lab.config())
        .await
        .expect_err("one writer");
    assert!(second.to_string().contains("another broker"), "{second}");
    broker.stop().await;
}

#[tokio::test]
async fn the_file_is_begun_anew_when_it_is_long() {
    let lab = Lab::new("audit = { path = \"audit.jsonl\", size = 4096, keep = 2 }");
    let (broker, _clock) = lab.start().await;
    // More of one peer in a second would be folded; they stay, so that each has a name of its own.
    let mut peers = Vec::new();
    for _ in 0..8 {
        let mut alice = Peer::xml(&broker, "alice").await;
        assert_eq!(alice.verb(Verb::Join, "/robot").await, "ok");
        for _ in 0..8 {
            let wait = Map::new().with("wait", 0);
            assert_eq!(alice.verb_with(Verb::Grab, "/robot/token", wait).await, "ok");
            assert_eq!(alice.verb(Verb::Release, "/robot/token").await, "ok");
        }
        peers.push(alice);
    }
    broker.stop().await;
    let mut seqs = Vec::new();
    for name in ["audit.jsonl.2", "audit.jsonl.1", "audit.jsonl"] {
        assert!(lab.read(name).len() <= 4096, "{name}");
        seqs.extend(lab.lines(name).iter().filter_map(|line| line["seq"].as_u64()));
    }
    assert!(seqs.windows(2).all(|pair| pair[1] == pair[0] + 1), "{seqs:?}");
    assert!(seqs[0] > 1, "the oldest are gone");
    let files = std::fs::read_dir(lab.folder()).expect("readable").count();
    assert_eq!(files, 2 + 3, "configuration, users and three files");
}
