//! Stops of a mirrored robot by what its body does, as its own page shows it: robot, middle and hub are programs of their own.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use mom_client::Client;
use mom_drive::Commander;
use mom_tests::datagrams::Weather;
use mom_tests::programs::{PATIENCE, run, text};
use serde_json::Value;
use tokio::task::{JoinHandle, spawn_blocking};
use tokio::time::timeout;

use crate::simulacrum::{Stage, grab, is, linked, told};

/// What the body looks like now.
fn body(page: SocketAddr) -> Value {
    let mut stream = TcpStream::connect(page).expect("it listens");
    write!(stream, "GET /status.json HTTP/1.1\r\nhost: cubo\r\n\r\n").expect("it reads");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("it answers");
    let (_, body) = answer.split_once("\r\n\r\n").expect("a body");
    serde_json::from_str(body).expect("JSON")
}

/// The body once it is so.
async fn shown(page: SocketAddr, wanted: impl Fn(&Value) -> bool + Send + 'static) -> Value {
    let looked = spawn_blocking(move || {
        let until = Instant::now() + PATIENCE;
        loop {
            let body = body(page);
            if wanted(&body) {
                return body;
            }
            assert!(Instant::now() < until, "it is not so: {body}");
        }
    });
    looked.await.expect("it was looked at")
}

fn number(body: &Value, key: &str) -> f64 {
    body[key].as_f64().expect("a number")
}

/// Looks at the body for so long: it does nothing, and nothing of it moves.
async fn stands(page: SocketAddr, time: Duration) {
    let looked = spawn_blocking(move || {
        let (begin, before) = (Instant::now(), body(page));
        while begin.elapsed() < time {
            let now = body(page);
            let acts = [&now["turns"], &now["sounds"]].contains(&&Value::Bool(true));
            assert!(!acts && now["gesture"].is_null(), "{now}");
            for key in ["x", "y", "heading", "left-arm", "right-arm", "head-tilt", "lips"] {
                let way = number(&now, key) - number(&before, key);
                assert!(way.abs() < 2.0, "{key}: {before} {now}");
            }
        }
    });
    looked.await.expect("it was looked at");
}

fn is_swinging(body: &Value) -> bool {
    number(body, "left-arm") > 30.0
}

fn is_driving(body: &Value) -> bool {
    body["turns"] == true && number(body, "x") > 2520.0
}

/// A robot that alice drives, and what becomes of this script.
async fn drive(alice: &Client, script: &'static str) -> JoinHandle<String> {
    let (channel, _) = linked(alice).await;
    let guard = grab(alice).await;
    let mut robot = Commander::new(channel, guard.fence());
    tokio::spawn(async move {
        let end = robot.carry_out(script).await;
        let _ = guard.release().await;
        match end.is_finished() {
            true => "done".to_owned(),
            false => format!("{end:?}"),
        }
    })
}

/// What `mom` says as carol, and whether it succeeded.
async fn carol(stage: &Stage, words: &[&'static str]) -> (bool, String) {
    let (hub, words) = (stage.hub.clone(), words.to_vec());
    let ran = spawn_blocking(move || {
        let all = [&["--hub", hub.as_str(), "--user", "carol"], &words[..]].concat();
        run("mom", &all, &[("MOM_PASSWORD", "carol")])
    });
    let ran = ran.await.expect("it ran");
    (ran.status.success(), text(&ran.stdout) + &text(&ran.stderr))
}

/// At full swing and at full speed: when `mom stop` says that it stands, its body does, and nothing of it moves afterwards.
#[tokio::test(flavor = "multi_thread")]
async fn a_stop_ends_gesture_and_wheels_by_the_robots_own_page() {
    let stage = Stage::new(&[]).await;
    let alice = stage.arrive("alice").await;
    for (script, wanted) in [
        ("do gesture 2; do gesture 3", is_swinging as fn(&Value) -> bool),
        ("motor 800 800 6000; do gesture 2", is_driving),
        ("set joints 80 0 30; wait 6000", is_swinging),
    ] {
        let end = drive(&alice, script).await;
        shown(stage.page, wanted).await;
        let (stopped, said) = carol(&stage, &["stop", "/fleet/1/robot"]).await;
        assert!(stopped && said.contains("stands"), "{script}: {said}");
        stands(stage.page, Duration::from_millis(1500)).await;
        let end = end.await.expect("it ended");
        assert!(end.contains("stopped"), "{script}: {end}");
        let (free, said) = carol(&stage, &["unstop", "/fleet/1/robot"]).await;
        assert!(free, "{said}");
    }
}

/// A call that a slow network still has when the robot has confirmed the stop does not begin.
#[tokio::test(flavor = "multi_thread")]
async fn a_call_that_is_under_way_does_not_begin_after_a_stop() {
    let stage = Stage::new(&[]).await;
    let alice = stage.arrive("alice").await;
    let (_, mut events) = linked(&alice).await;
    stage.network.set(Weather {
        delay: Duration::from_millis(900),
        ..Weather::default()
    });
    let end = drive(&alice, "do gesture 2").await;
    told(&mut events, |state| is(state, "moving")).await;
    stage.network.set(Weather {
        loss: 0.2,
        doubled: 0.2,
        jitter: Duration::from_millis(30),
        ..Weather::default()
    });
    let (_, said) = carol(&stage, &["stop", "/fleet/1/robot"]).await;
    assert!(said.contains("stands"), "{said}");
    stands(stage.page, Duration::from_secs(2)).await;
    let end = end.await.expect("it ended");
    assert!(end.contains("stopped"), "{end}");
}

/// The middle's program stands still: the robot stands by its watchdog, and when the program goes on nothing begins.
#[tokio::test(flavor = "multi_thread")]
async fn of_a_middle_that_stood_still_nothing_goes_on() {
    let stage = Stage::new(&[]).await;
    let alice = stage.arrive("alice").await;
    let end = drive(&alice, "motor 400 400 4000; do gesture 2").await;
    shown(stage.page, is_driving).await;
    stage.middle.signal("STOP");
    shown(stage.page, |body| body["turns"] == false).await;
    // Longer than the statement would have gone on.
    stands_later(stage.page).await;
    stage.middle.signal("CONT");
    stands(stage.page, Duration::from_secs(2)).await;
    let end = end.await.expect("it ended");
    assert_ne!(end, "done");
}

/// Once its wheels have rolled out it stands.
async fn stands_later(page: SocketAddr) {
    let begin = Instant::now();
    shown(page, move |_| begin.elapsed() > Duration::from_secs(1)).await;
    stands(page, Duration::from_secs(4)).await;
}

/// The robot's program stands still: its body rests by itself at the watchdog's time, and not when the program goes on.
#[tokio::test(flavor = "multi_thread")]
async fn a_robot_whose_program_stood_still_has_not_moved_on() {
    let stage = Stage::new(&[]).await;
    let alice = stage.arrive("alice").await;
    let (_, mut events) = linked(&alice).await;
    let end = drive(&alice, "motor 300 300 60000; do gesture 2").await;
    let before = shown(stage.page, is_driving).await;
    stage.cubo.signal("STOP");
    told(&mut events, |state| !is(state, "linked")).await;
    let more = timeout(Duration::from_secs(6), told(&mut events, |_| false));
    assert!(more.await.is_err());
    stage.cubo.signal("CONT");
    let after = shown(stage.page, |body| body["turns"] == false).await;
    // 150 mm/s for 2 s, and what it drove before it was looked at and before it was stopped.
    let way = number(&after, "x") - number(&before, "x");
    assert!((100.0..600.0).contains(&way), "{way} mm: {before} {after}");
    stands(stage.page, Duration::from_secs(2)).await;
    assert!(end.await.expect("it ended").contains("is lost"));
}

/// One robot is what fails: whose channel is deleted stands until that is back, and the others drive on.
#[tokio::test(flavor = "multi_thread")]
async fn a_deleted_channel_of_one_mirrored_robot_leaves_the_others() {
    // Nobody is there where the second one should be.
    let stage = Stage::new(&["--robot", "/fleet/2=127.0.0.1:1"]).await;
    let alice = stage.arrive("alice").await;
    let _end = drive(&alice, "motor 100 -100 60000").await;
    shown(stage.page, |body| body["turns"] == true).await;
    let back = async |robot: &'static str| {
        let (deleted, said) = carol(&stage, &["delete", robot]).await;
        assert!(deleted, "{said}");
        let begin = Instant::now();
        while alice.channel(robot).await.is_err() {
            assert!(begin.elapsed() < PATIENCE, "it never comes back");
            tokio::task::yield_now().await;
        }
    };
    back("/fleet/2/robot").await;
    assert_eq!(body(stage.page)["turns"], true, "the other one goes on");
    back("/fleet/1/robot").await;
    shown(stage.page, |body| body["turns"] == false).await;
    let begin = Instant::now();
    let send = ["fleet", "send", "1", "motor 100 -100 300"];
    while !carol(&stage, &send).await.0 {
        assert!(begin.elapsed() < PATIENCE, "it obeys again");
    }
}
