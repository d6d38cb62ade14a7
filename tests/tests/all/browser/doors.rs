//! A page of the tests' own, written from docs/PROTOCOL.md alone.

use mom_broker::Broker;
use mom_proto::codec::Form;
use mom_proto::{Family, Map};
use mom_tests::audit::AuditLog;
use mom_tests::lab;
use mom_tests::raw::{Raw, message};
use tokio::task::JoinHandle;

use super::site::{Site, body};

const PAGE: &str = include_str!("../../../pages/doors.html");
const DOORS: [&str; 3] = ["websocket-json", "websocket-binary", "tunnel"];

/// A hub that knows pages of this site, and where they log in.
pub(super) async fn hub(known: &Site, audit: &AuditLog) -> Broker {
    lab::start_with(|config| {
        config.web.origins = vec![known.origin()];
        config.login.guests = true;
        // Guests too.
        lab::rule_chat(config, Map::new().with("allow", lab::words(&["*"])));
        config.audit.path = Some(audit.path());
    })
    .await
}

/// Answers everybody who says hello in the chat.
pub(super) async fn answering(hub: &Broker) -> JoinHandle<()> {
    let mut carol = Raw::login(hub.local_addr(), Form::Binary, "carol").await;
    carol.join(&["/chat"]).await;
    tokio::spawn(async move {
        while let Some(heard) = carol.next().await {
            let own = heard.sender.as_deref() == Some("carol");
            if heard.is(Family::Message, "chat") && !own {
                let said = heard.value();
                let said = said.as_str().expect("text");
                carol
                    .post(message("chat", "/chat", format!("heard {said}")))
                    .await;
            }
        }
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_page_is_a_peer_through_each_door() {
    let (site, audit) = (Site::start(PAGE).await, AuditLog::new());
    let hub = hub(&site, &audit).await;
    let carol = answering(&hub).await;
    let page = site.visit(hub.local_addr()).await;
    for (door, user) in DOORS.into_iter().zip(["alice", "guest", "bob"]) {
        let shown = format!("<li id=\"{door}\" class=\"ok\">{door}: {user} was heard by carol</li>");
        assert!(page.contains(&shown), "{door} in {}", body(&page));
    }
    carol.abort();
    hub.stop().await;
    let lines = audit.lines();
    for user in ["alice", "guest", "bob"] {
        assert_eq!(lines.count(&[("what", "login"), ("user", user)]), 1, "{user}");
    }
}

/// Threat 18, by a browser's own rules: the page hears nothing but that it failed, and nobody has logged in.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_18_a_page_of_another_origin_comes_through_no_door() {
    let (site, other, audit) = (Site::start(PAGE).await, Site::start(PAGE).await, AuditLog::new());
    let hub = hub(&site, &audit).await;
    let page = other.visit(hub.local_addr()).await;
    for (door, why) in DOORS
        .into_iter()
        .zip(["no WebSocket: 1006", "no WebSocket: 1006", "Failed to fetch"])
    {
        let shown = format!("<li id=\"{door}\" class=\"failed\">{door}: {why}</li>");
        assert!(page.contains(&shown), "{door} in {}", body(&page));
    }
    hub.stop().await;
    assert_eq!(audit.lines().count(&[("what", "login")]), 0);
}
