//! Robots that are peers themselves (W22): one follows the other, and one asks for its commands.

use std::time::Duration;

use mom_client::{Client, Code, Event, Events, Time, TokenGuard, Value};
use mom_drive::{Commander, DeviceChannel};
use mom_tests::programs::{PATIENCE, Running, project, run, text};
use tokio::task::spawn_blocking;
use tokio::time::{sleep, timeout};

fn broker(config: &str) -> (Running, String) {
    let (broker, hub) = Running::broker(&project().join("config").join(config));
    (broker, format!("bin://{hub}"))
}

fn rover(hub: &str, user: &str, options: &[&str]) -> Running {
    let options = [options, &["--hub", hub, "--user", user]].concat();
    Running::start("mom-rover", &options, &[("MOM_PASSWORD", user)])
}

/// A hub with a leader and a follower a metre behind it.
fn convoy() -> (Running, String, Running, Running) {
    let (broker, hub) = broker("convoy.toml");
    let leader = rover(
        &hub,
        "rover-a",
        &["--name", "a", "--tell", "/convoy", "--at", "2000,1000,0"],
    );
    let follower = rover(
        &hub,
        "rover-b",
        &["--name", "b", "--in", "/convoy", "--at", "1000,1000,0"],
    );
    (broker, hub, leader, follower)
}

async fn arrive(hub: &str, name: &str) -> Client {
    let client = Client::builder(hub).user(name).password(name).connect().await;
    client.expect("the lab knows its users")
}

/// A robot that is there, its events, and its token.
async fn drive(client: &Client, name: &str) -> (Commander, Events, TokenGuard) {
    let channel = DeviceChannel::join(client, &format!("/rover/{name}/robot"))
        .await
        .expect("they may look");
    let mut events = channel.events();
    told(&mut events, |content| content.get("x").is_some()).await;
    let token = client.token(&format!("/rover/{name}/token")).await;
    let guard = token.expect("they may look").grab().await.expect("it is free");
    (Commander::new(channel, guard.fence()), events, guard)
}

/// The next message of this name that is as wanted.
async fn heard(events: &mut Events, name: &str, wanted: impl Fn(&Value) -> bool) -> (u64, Value) {
    let heard = async {
        loop {
            match events.next().await.expect("the hub lives") {
                Event::Message(parcel) if parcel.name() == name && wanted(&parcel.value()) => {
                    return (parcel.id.unwrap_or(0), parcel.value());
                }
                _ => {}
            }
        }
    };
    timeout(PATIENCE, heard).await.expect("it is said")
}

/// The next state that is as wanted.
async fn told(events: &mut Events, wanted: impl Fn(&Value) -> bool) -> Value {
    heard(events, "state", wanted).await.1
}

fn int(content: &Value, key: &str) -> i64 {
    let value = content.get(key).and_then(Value::as_int);
    value.unwrap_or_else(|| panic!("{key} in {content:?}"))
}

fn is(content: &Value, key: &str) -> bool {
    content.get(key).and_then(Value::as_bool) == Some(true)
}

/// Sends a command that goes on.
async fn begin(client: &Client, name: &str, fence: u64, script: &str) {
    let channel = client.channel(&format!("/rover/{name}/robot")).await;
    let channel = channel.expect("they may look");
    let command = channel.message("command").content(script).fence(fence);
    command.send_acknowledged().await.expect("it is theirs");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_follower_arrives_behind_a_leader_that_drives_a_square() {
    let (_broker, hub, _a, _b) = convoy();
    let alice = arrive(&hub, "alice").await;
    let (mut leader, _, _held) = drive(&alice, "a").await;
    let (_, mut follows, guard) = drive(&alice, "b").await;
    begin(&alice, "b", guard.fence(), "follow rover-a 500").await;
    told(&mut follows, |content| content.get("gap").is_some()).await;
    // Nobody but the leader says where it is.
    let convoy = alice.channel("/convoy").await.expect("people may watch");
    let pose = mom_client::Map::new().with("x", 4000).with("y", 4000);
    let refused = convoy.message("pose").content(pose).send_acknowledged().await;
    let refused = refused.expect_err("she is not a robot");
    assert_eq!(refused.code(), Some(&Code::DENIED));
    let words = refused.to_string();
    assert!(words.contains("alice may not send"), "{words}");
    let mom_client::ClientError::Refused(refusal) = &refused else {
        panic!("not refused: {refused:?}");
    };
    let rule = refusal.get("rule").and_then(Value::as_str);
    assert_eq!(rule, Some("convoy/only robots speak in the convoy"));
    let square = "via 3000 1000 3000 2000 2000 2000 2000 1200";
    assert!(leader.carry_out(square).await.is_finished());
    // Its states since it began are still to be heard: it went round, and not across.
    let corner = |content: &Value| int(content, "x") > 2800 && int(content, "y") > 1800;
    told(&mut follows, corner).await;
    let place = |content: &Value| !is(content, "moving") && (int(content, "y") - 1700).abs() < 100;
    let arrived = told(&mut follows, place).await;
    assert!((int(&arrived, "x") - 2000).abs() < 100, "{arrived:?}");
    assert!((450..560).contains(&int(&arrived, "gap")), "{arrived:?}");
    assert!(!is(&arrived, "lost-leader"), "a leader that stands is not lost");
    // Any other command ends it.
    let done = heard(&mut follows, "status", |content| {
        content.get("state").and_then(Value::as_str) == Some("finished")
    });
    let (done, ()) = tokio::join!(done, begin(&alice, "b", guard.fence(), "leds 5"));
    assert_eq!(int(&done.1, "of"), 1);
    let lit = |content: &Value| int(content, "leds") == 5 && content.get("leader").is_none();
    told(&mut follows, lit).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_follower_stands_when_its_leader_falls_silent_and_goes_on_when_it_speaks() {
    let (_broker, hub, a, _b) = convoy();
    let alice = arrive(&hub, "alice").await;
    let (_, _, leads) = drive(&alice, "a").await;
    let (_, mut follows, guard) = drive(&alice, "b").await;
    begin(&alice, "b", guard.fence(), "follow rover-a 300").await;
    begin(&alice, "a", leads.fence(), "motor 100 100 60000").await;
    let follow = |content: &Value| is(content, "moving") && content.get("gap").is_some();
    told(&mut follows, follow).await;
    a.signal("STOP");
    told(&mut follows, |content| is(content, "lost-leader")).await;
    let stood = told(&mut follows, |content| !is(content, "moving")).await;
    assert!(
        is(&stood, "lost-leader"),
        "it stands because it is lost: {stood:?}"
    );
    assert!(stood.get("executing").is_some(), "and waits for it: {stood:?}");
    a.signal("CONT");
    let went_on = told(&mut follows, |content| is(content, "moving")).await;
    assert!(!is(&went_on, "lost-leader"), "{went_on:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_follower_whose_owner_changes_is_halted() {
    let (_broker, hub, _a, _b) = convoy();
    let (alice, carol) = (arrive(&hub, "alice").await, arrive(&hub, "carol").await);
    let (_, mut follows, guard) = drive(&alice, "b").await;
    begin(&alice, "b", guard.fence(), "follow rover-a 300").await;
    told(&mut follows, |content| is(content, "moving")).await;
    let token = carol.token("/rover/b/token").await.expect("she may look");
    let hers = token.grab().await.expect("her level is above that of alice");
    let ended = heard(&mut follows, "status", |content| content.get("error").is_some()).await;
    let error = ended.1.get("error").expect("it is one").clone();
    assert_eq!(error.get("name").and_then(Value::as_str), Some("halted"));
    let fence = i64::try_from(hers.fence()).expect("a fence");
    let stands = |content: &Value| {
        !is(content, "moving") && content.get("fence").and_then(Value::as_int) == Some(fence)
    };
    let stands = told(&mut follows, stands).await;
    assert!(stands.get("leader").is_none(), "{stands:?}");
}

/// Answers requests until a command is taken; how the last one ended.
async fn feed(client: &Client, events: &mut Events, fence: u64, script: &str, within: Duration) -> Value {
    let channel = client.channel("/rover/a/robot").await.expect("they may look");
    loop {
        let (asked, _) = heard(events, "next", |_| true).await;
        let answer = channel.message("command").content(script).fence(fence);
        answer
            .reference(asked)
            .expires(within)
            .send_acknowledged()
            .await
            .expect("it is in time");
        let ended = |content: &Value| {
            matches!(
                content.get("state").and_then(Value::as_str),
                Some("finished" | "error")
            )
        };
        let (_, content) = heard(events, "status", ended).await;
        // At first clocks are still being measured.
        if content
            .get("error")
            .and_then(|error| error.get("name")?.as_str().map(str::to_owned))
            .as_deref()
            != Some("expired")
        {
            return content;
        }
    }
}

/// Has the hub's clock pass this time.
async fn pass(client: &Client, until: Time) {
    while client.clock().now().is_none_or(|(now, _)| now < until) {
        sleep(Duration::from_millis(5)).await; // tidy: it is time that has to pass, and requests would be more than a peer may say
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_asks_takes_nothing_late() {
    let (_broker, hub) = broker("convoy.toml");
    let a = rover(&hub, "rover-a", &["--name", "a", "--pull", "300"]);
    let alice = arrive(&hub, "alice").await;
    let (_, mut events, guard) = drive(&alice, "a").await;
    let fence = guard.fence();
    let done = feed(&alice, &mut events, fence, "leds 1", PATIENCE).await;
    assert_eq!(done.get("state").and_then(Value::as_str), Some("finished"));
    // It falls silent after it has asked, and hears the answer when that is over.
    let channel = alice.channel("/rover/a/robot").await.expect("she may look");
    let life = Duration::from_millis(200);
    let (asked, _) = heard(&mut events, "next", |_| true).await;
    a.signal("STOP");
    let late = channel.message("command").content("leds 2").fence(fence);
    late.reference(asked)
        .expires(life)
        .send_acknowledged()
        .await
        .expect("it is in time");
    let (now, _) = alice.clock().now().expect("it is measured");
    let over = now.micros() + 400_000;
    pass(&alice, Time::from_micros(over).expect("a time")).await;
    a.signal("CONT");
    let (_, refused) = heard(&mut events, "status", |content| content.get("error").is_some()).await;
    let error = refused.get("error").expect("it is one").clone();
    assert_eq!(error.get("name").and_then(Value::as_str), Some("expired"));
    let words = error.get("text").and_then(Value::as_str).unwrap_or_default();
    assert!(words.contains("ms old, and was good for 200 ms"), "{words}");
    // What does not say until when it is good, and what answers an older request, are not taken either.
    for (reference, expires, code) in [(asked, None, "bad-slot"), (asked, Some(PATIENCE), "expired")] {
        heard(&mut events, "next", |_| true).await;
        let command = channel
            .message("command")
            .content("leds 2")
            .fence(fence)
            .reference(reference);
        let command = match expires {
            Some(expires) => command.expires(expires),
            None => command,
        };
        command.send_acknowledged().await.expect("the hub passes it on");
        let (_, refused) = heard(&mut events, "status", |content| content.get("error").is_some()).await;
        let error = refused.get("error").expect("it is one").clone();
        assert_eq!(error.get("name").and_then(Value::as_str), Some(code), "{error:?}");
    }
    // It asks again, and lights what came in time alone.
    let done = feed(&alice, &mut events, fence, "wait 1", PATIENCE).await;
    assert_eq!(done.get("state").and_then(Value::as_str), Some("finished"));
    let bob = arrive(&hub, "bob").await;
    let joined = bob.channel("/rover/a/robot").await.expect("he may look");
    let state = told(&mut joined.events(), |_| true).await;
    assert_eq!(int(&state, "leds"), 1);
}

/// What `mom` does for alice.
async fn typed(hub: &str, words: &[&str]) -> (bool, String) {
    let (hub, words) = (
        hub.to_owned(),
        words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>(),
    );
    let typed = spawn_blocking(move || {
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        let user = [
            ("MOM_HUB", &*hub),
            ("MOM_USER", "alice"),
            ("MOM_PASSWORD", "alice"),
        ];
        let said = run("mom", &words, &user);
        (said.status.success(), text(&said.stdout) + &text(&said.stderr))
    });
    typed.await.expect("it ends")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_is_fed_statement_by_statement() {
    let (_broker, hub) = broker("convoy.toml");
    let _a = rover(&hub, "rover-a", &["--name", "a", "--pull", "300"]);
    let alice = arrive(&hub, "alice").await;
    let (_, _, guard) = drive(&alice, "a").await;
    guard.release().await.expect("it is hers");
    alice.close().await;
    let bob = arrive(&hub, "bob").await;
    let seen = bob.channel("/rover/a/robot").await.expect("he may look");
    let mut events = seen.events();
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("round.txt");
    std::fs::write(&file, "leds 1; motor 200 200 300 # ahead\n\nleds 7\n").expect("it is written");
    let file = file.to_str().expect("a path");
    let (fed, said) = typed(&hub, &["fleet", "feed", file, "--robot", "/rover/a"]).await;
    assert!(fed, "{said}");
    let finished: Vec<&str> = said.lines().filter(|line| line.starts_with("finished")).collect();
    assert_eq!(
        finished,
        [
            "finished  leds 1",
            "finished  motor 200 200 300",
            "finished  leds 7"
        ]
    );
    // One command each, and the robot stands when nobody feeds it.
    told(&mut events, |content| {
        int(content, "leds") == 7 && !is(content, "moving")
    })
    .await;
    std::fs::write(file, "leds 1\nmotor 1 2\n").expect("it is written");
    let (fed, said) = typed(&hub, &["fleet", "feed", file, "--robot", "/rover/a"]).await;
    assert!(
        !fed && said.contains("round.txt:2:10: statement 2: `motor` takes"),
        "{said}"
    );
}

/// The first motion of a new owner waits until the robot rests, and is too old by then; it was not begun.
#[tokio::test(flavor = "multi_thread")]
async fn what_was_too_old_to_begin_is_fed_again() {
    let (_broker, hub) = broker("convoy.toml");
    let _a = rover(&hub, "rover-a", &["--name", "a", "--pull", "300"]);
    let alice = arrive(&hub, "alice").await;
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("round.txt");
    std::fs::write(&file, "motor 50 50 200\n").expect("it is written");
    let file = file.to_str().expect("a path");
    let fed = ["fleet", "feed", file, "--robot", "/rover/a", "--within", "100"];
    // A program that starts slowly finds it at rest.
    for _ in 0..5 {
        let (_, mut events, guard) = drive(&alice, "a").await;
        let done = feed(&alice, &mut events, guard.fence(), "motor 800 800 400", PATIENCE).await;
        assert!(done.get("error").is_none(), "{done:?}");
        guard.release().await.expect("it is hers");
        let (done, said) = typed(&hub, &fed).await;
        assert!(done && said.contains("finished  motor 50 50 200"), "{said}");
        if said.contains("too-old") {
            break;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn one_stands_beside_the_robots_of_a_gateway() {
    let (_broker, hub) = broker("fleet.toml");
    let _rover = rover(
        &hub,
        "gateway",
        &["--path", "/fleet/12", "--manager", "robot-token"],
    );
    let list = || typed(&hub, &["fleet", "list"]);
    let mut listed = list().await;
    while !listed.1.contains("standing") {
        listed = list().await;
    }
    assert!(listed.1.contains("12  standing  battery 100 %"), "{}", listed.1);
    let (sent, said) = typed(&hub, &["fleet", "send", "12", "motor 200 200 200; leds 3"]).await;
    assert!(sent && said.contains("12  finished"), "{said}");
}

/// The program is stopped while a motion goes on, for longer than that was to take: the driver ends it, and what follows in the
/// script is not done late.
#[tokio::test(flavor = "multi_thread")]
async fn a_program_that_stands_still_drives_on_by_nothing() {
    let (_broker, hub) = broker("convoy.toml");
    let a = rover(&hub, "rover-a", &["--name", "a", "--at", "1000,1000,0"]);
    let alice = arrive(&hub, "alice").await;
    let (_, mut events, guard) = drive(&alice, "a").await;
    let script = "motor 500 500 1200; leds 7; motor 500 500 5000";
    begin(&alice, "a", guard.fence(), script).await;
    let moving = told(&mut events, |content| {
        is(content, "moving") && int(content, "x") > 1010
    })
    .await;
    a.signal("STOP");
    let (now, _) = alice.clock().now().expect("it is measured");
    let over = now.micros() + 2_500_000;
    pass(&alice, Time::from_micros(over).expect("a time")).await;
    a.signal("CONT");
    let (_, ended) = heard(&mut events, "status", |content| content.get("error").is_some()).await;
    let error = ended.get("error").expect("it is one").clone();
    // By whatever sees it first: its link to the hub has stood still as well.
    assert_eq!(
        error.get("name").and_then(Value::as_str),
        Some("halted"),
        "{error:?}"
    );
    let stands = told(&mut events, |content| !is(content, "moving")).await;
    // 500 mm/s for the 500 ms that motors run without it, until the wheels stand, and what it drove before the signal came.
    let way = int(&stands, "x") - int(&moving, "x");
    assert!(way < 450, "{way} mm: {stands:?}");
    assert_eq!(int(&stands, "leds"), 0, "{stands:?}");
}
