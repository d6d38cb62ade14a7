//! What a shell offers to complete on `mom`'s command line: contexts of the hub, and statements of a device that nothing has heard of.

use mom_tests::lab;
use mom_tests::programs::{program, text};
use tokio::process::Command;

use crate::mcp::ROBOT;
use crate::mcp_card::Working;

/// What bash is offered for the last of these words.
async fn offered(hub: &str, password: Option<&str>, words: &[&str]) -> Vec<String> {
    let mut mom = Command::new(program("mom"));
    mom.args(["--", "mom"])
        .args(words)
        .env("MOM_COMPLETE", "bash")
        .env("_CLAP_IFS", "\n")
        .env("_CLAP_COMPLETE_INDEX", words.len().to_string())
        .env("MOM_HUB", hub)
        .env("MOM_USER", "alice")
        .env_remove("MOM_PASSWORD");
    if let Some(password) = password {
        mom.env("MOM_PASSWORD", password);
    }
    let output = mom.output().await.expect("it starts");
    assert!(output.status.success(), "{words:?}: {}", text(&output.stderr));
    assert_eq!(text(&output.stderr), "", "a shell has no place for it: {words:?}");
    text(&output.stdout).lines().map(str::to_owned).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_shell_is_offered_contexts_and_the_statements_of_the_device() {
    let broker = lab::start().await;
    let hub = format!("bin://{}", broker.local_addr());
    let crane = Working::start(&hub).await;
    for (words, expected) in [
        (&["grab", "/robot/"] as &[&str], &["/robot/token"] as &[&str]),
        (&["run", "--channel", "/robot/a"], &["/robot/arm"]),
        (&["watch", "/robot"], &["/robot", "/robot/arm", "/robot/token"]),
        (&["card", "/nowhere"], &[]),
        (&["trace", "h"], &["hoist"]),
        (&["trace", "--channel", ROBOT, "hoist 5; u"], &["hoist 5; up"]),
        (&["trace", "--channel", "/robot/token", "h"], &[]),
        (&["unst"], &["unstop"]),
    ] {
        let mut offered = offered(&hub, Some("alice"), words).await;
        offered.sort();
        assert_eq!(offered, expected, "{words:?}");
    }
    // It asks nobody for a password, and says nothing of a hub that is not there or lets nobody in.
    let words = ["grab", "/robot/"];
    assert_eq!(offered(&hub, None, &words).await, [""; 0]);
    assert_eq!(offered(&hub, Some("wrong"), &words).await, [""; 0]);
    assert_eq!(offered("bin://127.0.0.1:1", Some("alice"), &words).await, [""; 0]);
    // The hub is the one on the command line.
    let named = ["--hub", &hub, "grab", "/robot/"];
    assert_eq!(
        offered("bin://127.0.0.1:1", Some("alice"), &named).await,
        ["/robot/token"]
    );
    crane.end().await;
    broker.stop().await;
}
