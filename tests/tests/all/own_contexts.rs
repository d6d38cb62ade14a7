//! An arm and cameras at a hub whose configuration has none of their contexts (M36, M37), and an arm that loses its own.

use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

use mom_client::{Client, Event, Events, Map, Value};
use mom_drive::{CommandEnd, Commander, DeviceChannel};
use mom_tests::programs::{PATIENCE, Running, program, project, run, text};
use tokio::time::timeout;

/// A hub with the lab's users and no contexts; its devices may do this.
fn broker(folder: &tempfile::TempDir, devices: &str) -> (Running, String) {
    let users = project().join("config/lab-users.toml");
    let config = format!(
        r#"
        users = "{}"
        root = "all"

        [managers.all]
        kind = "roles"

        [[managers.all.rules]]
        groups = ["device"]
        allow = [{devices}]

        [[managers.all.rules]]
        name = "people may all"
        min-level = 1
        allow = ["*"]

        [managers.robot-token]
        kind = "chain"
        of = ["all", {{ kind = "level-or-lease", lease = 180000 }}]
        "#,
        users.display()
    );
    let file: PathBuf = folder.path().join("broker.toml");
    std::fs::write(&file, config).expect("the folder can be written");
    let (broker, hub) = Running::broker(&file);
    (broker, format!("bin://{hub}"))
}

fn start(program: &str, hub: &str, options: &[&str]) -> Running {
    let user = program.trim_start_matches("mom-");
    Running::start(
        program,
        &[&["--hub", hub], options].concat(),
        &[("MOM_PASSWORD", user)],
    )
}

async fn arrive(hub: &str, name: &str) -> Client {
    let client = Client::builder(hub).user(name).password(name).connect().await;
    client.expect("the lab knows its users")
}

/// Waits for a message of this name.
async fn hear(events: &mut Events, name: &str) {
    let heard = async {
        while !matches!(events.next().await, Some(Event::Message(parcel)) if parcel.name() == name) {}
    };
    timeout(PATIENCE, heard).await.expect("it is said");
}

/// Grabs the robot's token, and has the arm wait for a moment.
async fn drive(client: &Client) -> CommandEnd {
    let channel = DeviceChannel::join(client, "/robot/arm")
        .await
        .expect("it is there");
    let token = client.token("/robot/token").await.expect("it is there");
    let guard = token.grab().await.expect("it is free");
    let mut robot = Commander::new(channel, guard.fence());
    let ended = robot.carry_out("wait 10").await;
    guard.release().await.expect("it is held");
    ended
}

/// Waits until a device obeys in the arm's channel.
async fn until_it_obeys(client: &Client) {
    let obeys = async {
        let is_there = async || {
            let members = client.members("/robot/arm").await.unwrap_or_default();
            members.iter().any(|member| member.device)
        };
        while !is_there().await {
            tokio::task::yield_now().await;
        }
    };
    timeout(PATIENCE, obeys).await.expect("the arm comes");
}

#[tokio::test(flavor = "multi_thread")]
async fn arm_and_cameras_make_their_contexts_where_they_may() {
    let folder = tempfile::tempdir().expect("a folder");
    let (_broker, hub) = broker(&folder, r#""*""#);
    let alice = arrive(&hub, "alice").await;
    let _arm = start("mom-arm", &hub, &["--manager", "robot-token"]);
    until_it_obeys(&alice).await;
    let token = alice.info("/robot/token").await.expect("it is made");
    assert_eq!(token.get("manager"), Some(&Value::from("robot-token")));
    // The channel is guarded: without the token nothing moves.
    assert!(drive(&alice).await.is_finished());

    for view in ["x", "pan"] {
        let _camera = start("mom-camera", &hub, &["--view", view]);
        let path = format!("/camera/{view}");
        let channel = timeout(PATIENCE, async {
            loop {
                if let Ok(channel) = alice.channel(&path).await {
                    return channel;
                }
                tokio::task::yield_now().await;
            }
        });
        let channel = channel.await.expect("it is made");
        let mut events = channel.events();
        timeout(PATIENCE, async {
            while alice.members(&path).await.is_ok_and(|members| members.len() < 2) {
                tokio::task::yield_now().await;
            }
        })
        .await
        .expect("the camera is there");
        channel.message("request").send().await.expect("anybody may ask");
        hear(&mut events, "image").await;
    }
    alice.info("/camera/pan-token").await.expect("it is made");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_arm_and_a_camera_that_may_not_say_what_is_missing_and_who_can_make_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let (_broker, hub) = broker(
        &folder,
        r#""join", "lookup", "list", "info", "members", "send", "device""#,
    );
    for (program, missing) in [("mom-arm", "/robot"), ("mom-camera", "/camera")] {
        let user = program.trim_start_matches("mom-");
        let ended = run(program, &["--hub", &hub], &[("MOM_PASSWORD", user)]);
        assert!(!ended.status.success());
        let said = text(&ended.stderr);
        let words = format!("{missing} is missing; who may create contexts there makes it");
        assert!(said.contains(&words), "{said}");
    }
    // The camera has its own; what is missing is the arm's.
    let carol = arrive(&hub, "carol").await;
    let spec = |kind: &str| Map::new().with("kind", kind);
    carol.create("/camera", spec("session")).await.expect("she may");
    carol.create("/camera/x", spec("channel")).await.expect("she may");
    let ended = run("mom-camera", &["--hub", &hub], &[("MOM_PASSWORD", "camera")]);
    let said = text(&ended.stderr);
    assert!(
        !ended.status.success() && said.contains("the robot makes it when it starts"),
        "{said}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lab_whose_arm_is_put_out_goes_on_and_the_arm_comes_back() {
    let (_lab, hub) = Running::lab();
    let carol = arrive(&hub, "carol").await;
    assert!(drive(&carol).await.is_finished());
    let members = carol.members("/robot/arm").await.expect("she may look");
    let arm = members
        .into_iter()
        .find(|member| member.device)
        .expect("it is there");
    let expelled = carol
        .expel("/robot/arm", &arm.peer, "a test", Some(Duration::from_secs(1)))
        .await;
    expelled.expect("operators may");
    until_it_obeys(&carol).await;
    assert!(drive(&carol).await.is_finished());
}

/// Three seconds without a camera, or an arm that was put out of the hub, are no reason to end everybody's hub.
#[tokio::test(flavor = "multi_thread")]
async fn a_lab_goes_on_without_a_device_that_was_put_out() {
    let mut command = Command::new("sh");
    command
        .args(["-c", "exec \"$0\" \"$@\" 2>&1"])
        .arg(program("mom"))
        .args(["lab", "--listen", "127.0.0.1:0"]);
    let lab = Running::of("mom lab", &mut command);
    let line = lab.line_with("bin://");
    let hub = line.split_whitespace().find(|word| word.starts_with("bin://"));
    let carol = arrive(hub.expect("the hub's address"), "carol").await;
    for (path, peer) in [("/camera", "camera"), ("/", "arm")] {
        let members = carol.members(path).await.expect("she may look");
        let named = members.iter().find(|member| member.peer.starts_with(peer));
        let named = named.unwrap_or_else(|| panic!("{peer} in {members:?}"));
        let for_a_moment = Some(Duration::from_secs(1));
        let expelled = carol.expel(path, &named.peer, "a test", for_a_moment).await;
        expelled.expect("operators may");
        lab.line_with("the lab goes on without it");
    }
    carol.lookup("/robot").await.expect("the hub is there");
}
