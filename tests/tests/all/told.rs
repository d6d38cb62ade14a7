//! What the command line tells: places by the hub's address, wrong addresses, and fences, the same everywhere.

use std::process::Output;

use mom_broker::Broker;
use mom_client::{Client, Event};
use mom_tests::lab;
use mom_tests::programs::{PATIENCE, Running, run, text};
use tokio::task::spawn_blocking;
use tokio::time::timeout;

/// Runs `mom` as carol to its end.
async fn mom(hub: &str, args: &[&str]) -> Output {
    let (hub, args) = (hub.to_owned(), args.join("\n"));
    let run = move || {
        let args: Vec<&str> = args.split('\n').collect();
        let settings = [
            ("MOM_HUB", &*hub),
            ("MOM_USER", "carol"),
            ("MOM_PASSWORD", "carol"),
        ];
        run("mom", &args, &settings)
    };
    spawn_blocking(run).await.expect("it runs")
}

fn check(output: &Output, code: i32, words: &[&str], absent: &[&str]) {
    let said = text(&output.stdout) + &text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{said}");
    for word in words {
        assert!(said.contains(word), "{word:?} is in {said}");
    }
    for word in absent {
        assert!(!said.contains(word), "{word:?} is not in {said}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_path_of_an_address_is_the_place() {
    let broker = lab::start().await;
    let hub = |path: &str| format!("bin://{}{path}", broker.local_addr());
    check(
        &mom(&hub("/robot"), &["tree"]).await,
        0,
        &["arm", "token"],
        &["chat"],
    );
    check(
        &mom(&hub("/robot"), &["tree", "/"]).await,
        0,
        &["robot", "chat"],
        &[],
    );
    check(
        &mom(&hub("/robot/token"), &["token"]).await,
        0,
        &["/robot/token"],
        &[],
    );
    let option = hub("/chat");
    check(
        &mom("bin://nobody:1/robot", &["--hub", &option, "stats", "--json"]).await,
        0,
        &["/chat"],
        &[],
    );
    check(&mom(&option, &["chat"]).await, 0, &["/chat as carol"], &[]);
    let after = mom("bin://nobody:1/chat", &["tree", "--hub", &hub("/robot")]).await;
    check(&after, 0, &["arm", "token"], &["chat"]);
    // Where that makes no sense it is said what it is.
    check(
        &mom(&hub("/robot"), &["chat"]).await,
        2,
        &["/robot is a session"],
        &[],
    );
    check(
        &mom(&option, &["send", "chat", "hello"]).await,
        2,
        &["send PATH NAME", "/chat"],
        &[],
    );
    check(&mom(&hub(""), &["grab"]).await, 2, &["<PATH>"], &[]);
    broker.stop().await;
}

/// A wrong address is told as that, by all programs, and before anything is asked.
#[test]
fn a_wrong_address_is_a_wrong_address() {
    for (hub, why) in [
        ("bin://nohost name:1", "\"nohost name\" is not a host name"),
        ("ftp://lab:7666", "ftp:// is not a scheme of a hub"),
        ("lab:7666", "must begin with bin:// or tcp://"),
        ("bin://lab:", "its port is missing"),
        ("bin://lab:99999", "a port must be a number from 0 to 65535"),
        ("bin://lab:7666/a//b", "its path is invalid"),
    ] {
        for (program, args) in [
            ("mom", &["tree", "--hub", hub][..]),
            ("mom", &["tree", "--json", "--hub", hub]),
            ("mom-arm", &["--hub", hub]),
        ] {
            let settings = [("MOM_USER", "arm"), ("MOM_PASSWORD", "arm")];
            let output = run(program, args, &settings);
            let said = text(&output.stderr).replace("\\\"", "\"");
            assert!(!output.status.success(), "{said}");
            assert!(
                said.contains("wrong address") && said.contains(why),
                "{program}: {said}"
            );
            assert!(
                !said.contains("bad-name") && !said.contains("bad-path"),
                "{program}: {said}"
            );
        }
    }
}

/// The number after `fence ` in a line.
fn fence(line: &str) -> u64 {
    let number = line.split("fence ").nth(1).expect("a fence");
    let end = number.find(|c: char| !c.is_ascii_digit()).unwrap_or(number.len());
    number[..end].parse().expect("a number")
}

/// What alice's program says that it holds, and others say of it.
async fn held(broker: &Broker) -> u64 {
    let hub = format!("bin://{}", broker.local_addr());
    let settings = [
        ("MOM_HUB", &*hub),
        ("MOM_USER", "alice"),
        ("MOM_PASSWORD", "alice"),
    ];
    let witness = Client::builder(&hub)
        .user("carol")
        .password("carol")
        .connect()
        .await;
    let witness = witness.expect("a user of the lab");
    let mut events = witness.token("/robot/token").await.expect("it is there").events();
    let watch = Running::start("mom", &["watch", "/robot/token"], &settings);
    let joined = async { while !matches!(events.next().await, Some(Event::Joined(_)) | None) {} };
    timeout(PATIENCE, joined).await.expect("it watches");
    let grab = Running::start("mom", &["grab", "/robot/token"], &settings);
    let told = fence(&grab.line_with("holding /robot/token"));
    assert_eq!(fence(&watch.line_with("grabbed")), told);
    let shown = mom(&hub, &["token", "/robot/token"]).await;
    assert_eq!(fence(&text(&shown.stdout)), told);
    let shown = mom(&hub, &["token", "--json", "/robot/token"]).await;
    let shown: serde_json::Value = serde_json::from_str(&text(&shown.stdout)).expect("JSON");
    assert_eq!(shown["fence"], told);
    told
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fence_is_one_number_everywhere_and_rises_over_a_restart() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut highest = 0;
    for _ in 0..2 {
        let broker = lab::start_with(|config| config.store.state = Some(folder.path().to_owned())).await;
        let told = held(&broker).await;
        assert!(told > highest, "{told} after {highest}");
        highest = told;
        broker.stop().await;
    }
}
