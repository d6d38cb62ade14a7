//! Threat 18: pages of other origins, and what a cookie is worth.

use mom_proto::codec::Form;
use mom_tests::asking::{Answer, Asking, upgrade};
use mom_tests::raw::Raw;

use crate::threats::World;

const LISTED: &str = "https://lab.example.org";

/// What is asked here, by which method.
const ASKED: [&str; 7] = [
    "GET /mom",
    "POST /tunnel",
    "OPTIONS /tunnel",
    "GET /tunnel/00112233445566778899aabbccddeeff",
    "POST /tunnel/00112233445566778899aabbccddeeff",
    "GET /",
    "GET /healthz",
];

async fn world() -> World {
    World::start_with(|config| config.web.origins = vec![LISTED.to_owned()]).await
}

/// Asks with this origin, for a WebSocket at its path.
async fn ask(world: &World, first: &str, host: &str, origin: Option<&str>) -> Answer {
    let mut lines = match first {
        "GET /mom" => upgrade("mom.json.v1"),
        _ => vec![String::new()],
    };
    lines[0] = format!("Host: {host}");
    lines.extend(origin.map(|origin| format!("Origin: {origin}")));
    let lines: Vec<&str> = lines.iter().map(String::as_str).collect();
    let mut asking = Asking::connect(world.address()).await;
    asking.ask(first, &lines, b"").await
}

/// Before the upgrade, before a tunnel is opened, and whatever the path is.
#[tokio::test]
async fn threat_18_foreign_origins() {
    let mut world = world().await;
    let port = world.address().port();
    let rebound = format!("rebound.example.net:{port}");
    for (host, origin) in [
        ("127.0.0.1", "https://evil.example.net"),
        ("127.0.0.1", "null"),
        ("127.0.0.1", "http://lab.example.org"),
        ("127.0.0.1", "https://lab.example.org.evil.example.net"),
        ("127.0.0.1", "https://lab.example.org, https://evil.example.net"),
        ("127.0.0.1", "http://localhost:1"),
        // A name that its owner has pointed at the hub's address: equal to the host, and still not the hub's own.
        (&rebound, &format!("http://{rebound}")),
        ("lab.example.org", "http://lab.example.org:80"),
    ] {
        for first in ASKED {
            let answer = ask(&world, first, host, Some(origin)).await;
            let what = format!("{first} from {origin}: {answer:?}");
            assert_eq!(
                (answer.status, answer.code().as_deref()),
                (403, Some("denied")),
                "{what}"
            );
            assert_eq!(answer.header("access-control-allow-origin"), None, "{what}");
            assert_eq!(answer.header("mom-tunnel"), None, "{what}");
        }
        world.check_nothing_arrived(origin).await;
    }
    world.end().await;
}

/// Those that are on the list, those of this machine at the hub's own port, and who is not a page at all.
#[tokio::test]
async fn threat_18_origins_that_may() {
    let world = world().await;
    let port = world.address().port();
    for origin in [
        Some(LISTED.to_owned()),
        Some(format!("http://localhost:{port}")),
        Some(format!("http://127.0.0.1:{port}")),
        None,
    ] {
        let origin = origin.as_deref();
        for (first, status) in ASKED.into_iter().zip([101, 201, 204, 404, 404, 200]) {
            let answer = ask(&world, first, "lab.example.org", origin).await;
            assert_eq!(answer.status, status, "{first} from {origin:?}: {answer:?}");
            assert_eq!(answer.header("access-control-allow-origin"), origin, "{first}");
            if let ("POST /tunnel", Some(_)) = (first, origin) {
                let exposed = answer.header("access-control-expose-headers").expect("CORS");
                assert!(exposed.contains("mom-tunnel"), "{exposed}");
            }
        }
    }
    world.end().await;
}

/// A browser sends cookies of itself, also for pages of others: no cookie logs anybody in.
#[tokio::test]
async fn threat_18_a_cookie_logs_nobody_in() {
    let world = world().await;
    let peer = Raw::login(world.address(), Form::Json, "bob").await;
    let mut asking = Asking::connect(world.address()).await;
    let mut lines = upgrade("mom.json.v1");
    lines.push(format!("Cookie: session={}; user=bob; mom=1", peer.name()));
    let lines: Vec<&str> = lines.iter().map(String::as_str).collect();
    assert_eq!(asking.ask("GET /mom", &lines, b"").await.status, 101);
    let line = br#"{"family":"context","name":"join","id":1,"context":"/chat"}"#;
    let head = [0x81, 0x80 | u8::try_from(line.len()).expect("short"), 0, 0, 0, 0];
    asking.send([&head, &line[..]].concat()).await;
    let heard = String::from_utf8_lossy(&asking.bytes().await).into_owned();
    assert!(heard.contains("not-logged-in"), "{heard}");
    world.end().await;
}
