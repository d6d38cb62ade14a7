//! Two programs that would obey the same commands: real arms, one channel.

use std::path::Path;
use std::process::Stdio;

use mom_client::Client;
use mom_tests::programs::{PATIENCE, Running, program, project, run, text};
use tokio::time::{Instant, sleep};

/// An arm with this state directory.
fn arm(hub: &str, state: &Path) -> Running {
    let state = state.to_string_lossy();
    Running::start(
        "mom-arm",
        &["--hub", hub],
        &[("MOM_PASSWORD", "arm"), ("XDG_STATE_HOME", &state)],
    )
}

/// The devices of the arm's channel.
async fn devices(client: &Client) -> Vec<String> {
    let members = client.members("/robot/arm").await.expect("carol may ask");
    let devices = members.into_iter().filter(|member| member.device);
    devices.map(|member| member.peer).collect()
}

/// Waits for the one device that is there, another than this.
async fn next_after(client: &Client, before: &str) -> String {
    let until = Instant::now() + PATIENCE;
    loop {
        let now = devices(client).await;
        if let [one] = &now[..]
            && one != before
        {
            return one.clone();
        }
        assert!(Instant::now() < until, "{now:?} are there");
        sleep(std::time::Duration::from_millis(20)).await; // tidy: no event says who is a device
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_arm_is_refused_and_a_second_start_takes_the_firsts_place() {
    let (_broker, address) = Running::broker(&project().join("config/lab.toml"));
    let hub = format!("bin://{address}");
    let carol = Client::builder(&hub)
        .user("carol")
        .password("carol")
        .connect()
        .await;
    let carol = carol.expect("the lab knows her");
    carol.channel("/robot/arm").await.expect("she may look");
    let (own, other) = (
        tempfile::tempdir().expect("a folder"),
        tempfile::tempdir().expect("a folder"),
    );
    let first = arm(&hub, own.path());
    let arms = next_after(&carol, "").await;

    // Another machine with the same key.
    let state = other.path().to_string_lossy();
    let second = run(
        "mom-arm",
        &["--hub", &hub],
        &[("MOM_PASSWORD", "arm"), ("XDG_STATE_HOME", &state)],
    );
    assert!(!second.status.success());
    let said = text(&second.stderr);
    assert!(said.contains("arm is already the device in /robot/arm"), "{said}");
    assert_eq!(devices(&carol).await, [arms.as_str()]);

    // The same program, started once more while the first runs.
    let again = arm(&hub, own.path());
    assert!(!first.wait().success(), "it says that it was put out");
    let agains = next_after(&carol, &arms).await;

    // One that stands still so long that its link is lost occupies nothing, and does not come back.
    again.signal("STOP");
    let third = loop {
        let mut command = std::process::Command::new(program("mom-arm"));
        command
            .args(["--hub", &hub])
            .env("MOM_PASSWORD", "arm")
            .env("XDG_STATE_HOME", other.path())
            .stderr(Stdio::null());
        let third = Running::of("mom-arm", &mut command);
        // Its link is not lost yet as long as this one is refused.
        let until = Instant::now() + std::time::Duration::from_secs(1);
        let mut is_in = false;
        while Instant::now() < until && !is_in {
            is_in = !devices(&carol).await.contains(&agains);
            sleep(std::time::Duration::from_millis(20)).await; // tidy: no event says who is a device
        }
        if is_in {
            break third;
        }
        third.wait();
    };
    again.signal("CONT");
    assert!(!again.wait().success());
    assert_eq!(devices(&carol).await.len(), 1);
    drop(third);
}
