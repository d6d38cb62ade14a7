//! Workspace tokens (M40): two users of the lab, and two zones that overlap.

use std::fs;

use mom_client::Client;
use mom_tests::programs::{Running, project, run, text};

/// Added to the lab's configuration.
const ZONES: &str = r#"
[managers.boxes]
kind = "zones"
zones = [
  { token = "/zone/left", from = [-300, -300, 0], to = [20, 300, 450] },
  { token = "/zone/right", from = [-20, -300, 0], to = [300, 300, 450] },
]

[managers.workspaces]
kind = "chain"
of = ["lab", "first-come", "boxes"]

[[contexts]]
path = "/zone"
kind = "session"

[[contexts]]
path = "/zone/left"
kind = "token"
manager = "workspaces"

[[contexts]]
path = "/zone/right"
kind = "token"
manager = "workspaces"
"#;

#[tokio::test]
async fn a_zone_that_overlaps_anothers_is_refused_in_words() {
    let folder = tempfile::tempdir().expect("a folder");
    let lab = fs::read_to_string(project().join("config/lab.toml")).expect("it is there");
    let config = folder.path().join("lab.toml");
    fs::write(&config, lab + ZONES).expect("it is written");
    let users = project().join("config/lab-users.toml");
    fs::copy(users, folder.path().join("lab-users.toml")).expect("it is copied");
    let (_broker, address) = Running::broker(&config);
    let hub = format!("bin://{address}");
    let alice = Client::builder(&hub)
        .user("alice")
        .password("alice")
        .connect()
        .await;
    let alice = alice.expect("the lab knows its users");
    let left = alice.token("/zone/left").await.expect("she may look");
    let held = left.grab().await.expect("it is free");
    let bob = [("MOM_HUB", &*hub), ("MOM_USER", "bob"), ("MOM_PASSWORD", "bob")];
    let refused = run("mom", &["grab", "/zone/right"], &bob);
    let said = text(&refused.stderr) + &text(&refused.stdout);
    assert_eq!(refused.status.code(), Some(1), "{said}");
    assert!(
        said.contains("/zone/right overlaps /zone/left, which alice holds"),
        "{said}"
    );
    held.release().await.expect("it is hers");
    let bob = Client::builder(&hub).user("bob").password("bob").connect().await;
    let right = bob.expect("the lab knows its users").token("/zone/right").await;
    let granted = right.expect("he may look").grab().await;
    assert!(granted.is_ok(), "{granted:?}");
}
