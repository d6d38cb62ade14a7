//! The robot and the camera as programs that prove who they are by a key, on a real broker.

use std::path::{Path, PathBuf};

use mom_broker::Config;
use mom_client::{Client, Event};
use mom_tests::lab;
use mom_tests::login::DeviceKey;
use mom_tests::programs::{PATIENCE, Running, run, text};
use tempfile::TempDir;
use tokio::time::timeout;

/// Both devices have keys and no passwords.
fn keys_only(config: &mut Config) {
    for (name, number) in [("arm", 1), ("camera", 2)] {
        let user = config.users.iter_mut().find(|user| user.name == name);
        let user = user.expect("a device of the lab");
        user.password = None;
        user.keys = vec![DeviceKey::number(number).public()];
    }
}

fn key_file(folder: &TempDir, number: u8) -> PathBuf {
    let file = folder.path().join(format!("{number}.key"));
    std::fs::write(&file, DeviceKey::number(number).pem()).expect("a file");
    file
}

fn start(program: &'static str, hub: String, key: PathBuf) -> tokio::task::JoinHandle<Running> {
    tokio::task::spawn_blocking(move || Running::start(program, &["--hub", &hub, "--key", utf8(&key)], &[]))
}

fn utf8(path: &Path) -> &str {
    path.to_str().expect("a path of text")
}

#[tokio::test(flavor = "multi_thread")]
async fn devices_log_in_with_their_keys() {
    let folder = tempfile::tempdir().expect("a folder");
    let broker = lab::start_with(keys_only).await;
    let carol = Client::builder(format!("bin://{}", broker.local_addr()));
    let carol = carol.user("carol").password("carol").connect().await;
    let carol = carol.expect("a user of the lab");
    for (program, scheme, number, channel) in [
        ("mom-arm", "bin", 1, "/robot/arm"),
        ("mom-camera", "tcp", 2, "/camera/x"),
    ] {
        let mut events = carol.channel(channel).await.expect("carol may join").events();
        let hub = format!("{scheme}://{}", broker.local_addr());
        let device = start(program, hub, key_file(&folder, number)).await;
        let device = device.expect("it starts");
        let joined = async {
            loop {
                match events.next().await {
                    Some(Event::Joined(member)) if member.user != "carol" => break member.user,
                    Some(_) => {}
                    None => panic!("carol's link ended"),
                }
            }
        };
        let user = timeout(PATIENCE, joined).await.expect("the device comes");
        assert_eq!(format!("mom-{user}"), program);
        device.signal("TERM");
        let status = tokio::task::spawn_blocking(move || device.wait()).await;
        assert_eq!(status.expect("waited for").code(), Some(0));
    }
    broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_key_is_refused_in_words() {
    let folder = tempfile::tempdir().expect("a folder");
    let broker = lab::start_with(keys_only).await;
    let hub = format!("bin://{}", broker.local_addr());
    let (wrong, none) = (key_file(&folder, 7), folder.path().join("none.key"));
    let cases = tokio::task::spawn_blocking(move || {
        for program in ["mom-arm", "mom-camera", "mom-model"] {
            for (key, words) in [(&wrong, "cannot log in at"), (&none, "none.key: cannot be read")] {
                let output = run(program, &["--hub", &hub, "--key", utf8(key)], &[]);
                let said = text(&output.stderr);
                assert_eq!(output.status.code(), Some(1), "{program}: {said}");
                assert!(said.contains(words), "{program}: {said}");
            }
            let both = ["--key", utf8(&wrong), "--password-file", "secret"];
            assert_eq!(run(program, &both, &[]).status.code(), Some(2), "{program}");
        }
    });
    cases.await.expect("all are refused");
    broker.stop().await;
}
