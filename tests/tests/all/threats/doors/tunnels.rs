//! Threat 17: the id of a tunnel is all that is needed to go on with it.

use mom_tests::asking::{Answer, Asking};

use crate::threats::{World, chat_json};

/// Asks over a connection of its own.
async fn ask(world: &World, first: String, body: &[u8]) -> Answer {
    let mut asking = Asking::connect(world.address()).await;
    asking.ask(&first, &["Host: hub"], body).await
}

fn id(answer: &Answer) -> String {
    answer.header("mom-tunnel").expect("an id").to_owned()
}

fn taken(answer: &Answer) -> (u16, Option<u64>) {
    let taken = answer.header("mom-taken").and_then(|taken| taken.parse().ok());
    (answer.status, taken)
}

/// One that is guessed, chosen, or from before the login gets nothing; what is sent again is taken once; what lacks something
/// before it is not taken.
#[tokio::test]
async fn threat_17_ids_of_tunnels() {
    let mut world = World::start().await;
    let before = id(&ask(&world, "POST /tunnel".to_owned(), b"").await);
    assert_eq!(before.len(), 32, "128 bits");
    let login = br#"{"family":"login","name":"login","id":1,"content":{"name":"bob","password":"bob"}}
{"family":"context","name":"join","id":2,"context":"/chat"}
"#;
    let answer = ask(&world, format!("POST /tunnel/{before}?at=0"), login).await;
    let mut at = login.len() as u64;
    assert_eq!(taken(&answer), (200, Some(at)));
    let after = id(&answer);
    assert_ne!(after, before);
    let said = chat_json("\"content\":\"once\"");
    for wrong in [
        &before,
        &"0".repeat(32),
        &after[..31],
        "chosen-by-a-client",
        "",
        "..",
    ] {
        for first in [
            format!("POST /tunnel/{wrong}?at={at}"),
            format!("GET /tunnel/{wrong}?at=0&wait=1"),
        ] {
            let answer = ask(&world, first.clone(), &said).await;
            assert_eq!(
                (answer.status, answer.code().as_deref()),
                (404, Some("unknown-tunnel")),
                "{first}"
            );
            assert_eq!(answer.header("mom-tunnel"), None, "{first}");
        }
    }
    world.check_nothing_arrived("ids of others").await;

    let gap = ask(&world, format!("POST /tunnel/{after}?at={}", at + 1), &said).await;
    assert_eq!(taken(&gap), (409, Some(at)));
    world.check_nothing_arrived("a gap").await;
    for _ in 0..3 {
        let answer = ask(&world, format!("POST /tunnel/{after}?at={at}"), &said).await;
        assert_eq!(taken(&answer), (200, Some(at + said.len() as u64)));
    }
    at += said.len() as u64;
    let heard = world.witness.next_of(mom_proto::Family::Message, "chat").await;
    assert_eq!(heard.value(), "once".into());
    world.check_nothing_arrived("the same again").await;

    of_two_who_poll_the_newer_hears(&world, &after, at).await;
    world.end().await;
}

/// The older one is answered at once, with nothing.
async fn of_two_who_poll_the_newer_hears(world: &World, id: &str, at: u64) {
    let all = ask(world, format!("GET /tunnel/{id}?at=0&wait=5000"), b"")
        .await
        .body
        .len();
    let mut older = Asking::connect(world.address()).await;
    let poll = format!("GET /tunnel/{id}?at={all}&wait=20000");
    older
        .send(mom_tests::asking::request(&poll, &["Host: hub"], b""))
        .await;
    let newer = async {
        let mut asking = Asking::connect(world.address()).await;
        loop {
            let answer = asking.ask(&poll, &["Host: hub"], b"").await;
            // It may be taken in first, and then have to go itself.
            if !answer.body.is_empty() {
                return answer;
            }
        }
    };
    let logout = b"{\"family\":\"login\",\"name\":\"logout\",\"id\":9}\n";
    let ended = async {
        // Once the older one has had to go the newer one is there.
        let answer = older.answer().await.expect("an answer");
        assert_eq!((answer.status, answer.body.len()), (200, 0), "{answer:?}");
        ask(world, format!("POST /tunnel/{id}?at={at}"), logout).await
    };
    let (newer, ended) = tokio::join!(newer, ended);
    assert_eq!((newer.status, ended.status), (200, 200));
}
