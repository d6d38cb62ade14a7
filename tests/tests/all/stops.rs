//! `mom stop` and `mom unstop`: the real program, broker and arm.

use std::process::{Output, Stdio};
use std::time::Duration;

use mom_client::{After, Client, Event};
use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel, Value};
use mom_tests::faulty::{Fault, FaultyNetwork};
use mom_tests::programs::{self, PATIENCE, Running, text};
use mom_tests::raw::{Raw, at, message};
use mom_tests::service::{Home, Service};
use serde_json::{Value as Json, json};
use tokio::io::{AsyncBufReadExt as _, AsyncWriteExt as _, BufReader, Lines};
use tokio::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command};
use tokio::task::spawn_blocking;
use tokio::time::timeout;

use crate::losses::Lab;

pub(crate) const ARM: &str = "/robot/arm";

/// Runs a command as a user.
async fn mom(lab: &Lab, user: &'static str, arguments: &'static [&'static str]) -> Output {
    let hub = format!("bin://{}", lab.broker.local_addr());
    let run = move || {
        let environment = [("MOM_HUB", &*hub), ("MOM_USER", user), ("MOM_PASSWORD", user)];
        programs::run("mom", arguments, &environment)
    };
    spawn_blocking(run).await.expect("it runs")
}

/// The exit code, and what was printed on standard output.
fn told(output: &Output) -> (Option<i32>, String) {
    (output.status.code(), text(&output.stdout))
}

fn join(terms: Map) -> Parcel {
    let join = Parcel::new(Family::Context, "join");
    join.context(at(ARM)).content(terms)
}

/// A device that hears all and says nothing.
pub(crate) async fn mute(lab: &Lab) -> Raw {
    let mut mute = Raw::login(lab.broker.local_addr(), Form::Binary, "arm").await;
    mute.join(&["/robot"]).await;
    let terms = Map::new().with("device", true);
    let joined = mute.ask(join(terms)).await.expect("it is one");
    assert_eq!(joined.value().get("device"), Some(&true.into()));
    mute
}

#[tokio::test(flavor = "multi_thread")]
async fn every_device_says_that_it_stands_and_that_it_may_move() {
    let lab = Lab::start().await;
    // The second finds it stopped, and hears so all the same.
    for _ in 0..2 {
        let output = mom(&lab, "alice", &["stop", ARM]).await;
        assert_eq!(told(&output), (Some(0), "/robot/arm: arm stands\n".to_owned()));
    }
    let all = mom(&lab, "bob", &["unstop"]).await;
    let free = "/robot/arm: arm may move; was stopped by alice\n";
    assert_eq!(told(&all), (Some(0), free.to_owned()));
    let nothing = mom(&lab, "bob", &["unstop"]).await;
    assert_eq!(nothing.status.code(), Some(1), "{nothing:?}");
    let session = mom(&lab, "carol", &["stop", "--json", "--reason", "smoke", "/robot"]).await;
    let line: Json = serde_json::from_slice(&session.stdout).expect("one line of JSON");
    assert_eq!(
        (session.status.code(), &line["path"], &line["obeyed"]),
        (Some(0), &json!(ARM), &json!(["arm"]))
    );
    let tree = mom(&lab, "alice", &["tree", "/robot"]).await;
    assert!(
        text(&tree.stdout).contains("stopped by carol (smoke)"),
        "{tree:?}"
    );
    lab.end().await;
}

/// A stop that goes out without its content, as it is too large, holds like any other, also where the device has heard of one before.
#[tokio::test(flavor = "multi_thread")]
async fn a_stop_of_many_words_holds() {
    let lab = Lab::start().await;
    mom(&lab, "alice", &["stop", ARM]).await;
    mom(&lab, "alice", &["unstop", ARM]).await;
    let mut bob = Raw::login(lab.broker.local_addr(), Form::Binary, "bob").await;
    bob.join(&["/robot", ARM]).await;
    let large = message("stop", ARM, "fire ".repeat(1_000));
    let id = bob.post(large).await;
    let shortened = bob.next_of(Family::Event, "shortened").await;
    assert_eq!(shortened.reference, Some(id));
    // That it stands free, which it tells a peer that joins, may come first.
    let state = loop {
        let state = bob.next_of(Family::Message, "state").await.value();
        if state.get("stop") != Some(&1.into()) {
            break state;
        }
    };
    assert_eq!(state.get("stopped"), Some(&true.into()), "{state:?}");
    let trace = mom(&lab, "alice", &["trace", "wait 10"]).await;
    assert!(
        text(&trace.stderr).contains("stopped") && !trace.status.success(),
        "{trace:?}"
    );
    // It is lifted as any other.
    let unstop = mom(&lab, "alice", &["unstop", ARM]).await;
    assert_eq!(unstop.status.code(), Some(0), "{unstop:?}");
    lab.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_says_nothing_is_named() {
    let lab = Lab::start_with_several().await;
    let mut mute = mute(&lab).await;
    let output = mom(&lab, "alice", &["stop", ARM]).await;
    let expected = "/robot/arm: arm~2 said nothing within 3s; arm stands\n";
    assert_eq!(told(&output), (Some(1), expected.to_owned()));
    // Its word is what counts, not that it took the message.
    mute.next_of(Family::Message, "stop").await;
    let word = Map::new().with("stopped", true);
    mute.send_parcel(&message("state", ARM, word)).await;
    // A peer that is no longer a device is not waited for.
    mute.ask(join(Map::new())).await.expect("a member");
    let output = mom(&lab, "alice", &["stop", ARM]).await;
    assert_eq!(told(&output), (Some(0), "/robot/arm: arm stands\n".to_owned()));
    lab.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_obeys_and_does_not_stand_is_named() {
    let lab = Lab::start_with_several().await;
    let mut rolling = mute(&lab).await;
    let state = |more: Map| {
        let said = Map::new().with("stopped", true).with("reached", true);
        more.iter()
            .fold(said, |said, (key, value)| said.with(key, value.clone()))
    };
    for (arguments, more, code, line) in [
        (
            &["stop", ARM][..],
            Map::new().with("moving", true),
            1,
            "arm stands; arm~2 obeys, and still moves",
        ),
        (
            &["stop", ARM],
            Map::new().with("moving", true).with("reached", false),
            1,
            "arm stands; arm~2 obeys, and cannot reach what it moves",
        ),
        (
            &["stop", ARM],
            Map::new().with("moving", false).with("rest", "not-measured"),
            0,
            "arm stands; arm~2 stands, by the time in which it stops: it does not measure",
        ),
        (
            &["stop", ARM, "--measured"],
            Map::new().with("moving", false).with("rest", "not-measured"),
            1,
            "arm stands; arm~2 stands, by the time in which it stops: it does not measure",
        ),
    ] {
        let answers = async {
            let stop = rolling.next_of(Family::Message, "stop").await;
            let number = stop.extra.get("stop").cloned().expect("its number");
            let state = state(more).with("stop", number);
            rolling.send_parcel(&message("state", ARM, state)).await;
        };
        let (output, ()) = tokio::join!(mom(&lab, "alice", arguments), answers);
        let (found, words) = told(&output);
        let mut parts: Vec<&str> = words
            .trim_end()
            .trim_start_matches("/robot/arm: ")
            .split("; ")
            .collect();
        let mut expected: Vec<&str> = line.split("; ").collect();
        parts.sort_unstable();
        expected.sort_unstable();
        assert_eq!((found, parts), (Some(code), expected), "{output:?}");
    }
    lab.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_stopped_is_told() {
    let lab = Lab::start().await;
    // Devices look around, and stop nobody.
    let denied = mom(&lab, "camera", &["stop", ARM]).await;
    assert_eq!(denied.status.code(), Some(1), "{denied:?}");
    assert!(text(&denied.stderr).contains("denied"), "{denied:?}");
    let nothing = mom(&lab, "camera", &["stop"]).await;
    assert_eq!(nothing.status.code(), Some(1), "{nothing:?}");
    let words = "there is nothing here that you may stop";
    assert!(text(&nothing.stderr).contains(words), "{nothing:?}");
    let token = mom(&lab, "alice", &["stop", "/robot/token"]).await;
    assert_eq!(token.status.code(), Some(2), "{token:?}");
    let unknown = mom(&lab, "alice", &["stop", "/robot/leg"]).await;
    assert_eq!(unknown.status.code(), Some(1), "{unknown:?}");
    lab.end().await;
}

/// The lab's broker as a process of its own, with an arm that can be killed.
struct Away {
    home: Home,
    broker: Service,
}

impl Away {
    async fn start() -> Away {
        Away::start_with("").await
    }

    async fn start_with(more: &str) -> Away {
        let home = Home::new(more);
        let broker = home.start().await;
        Away { home, broker }
    }

    fn hub(&self) -> String {
        format!("bin://{}", self.broker.address())
    }

    /// The arm's program; returns when it is a member.
    async fn arm(&self) -> Running {
        self.arm_at(self.hub()).await
    }

    async fn arm_at(&self, hub: String) -> Running {
        // From before its start, so that one of before that the hub has not missed yet is not taken for it.
        let mut alice = Raw::login(self.broker.address(), Form::Binary, "alice").await;
        alice.join(&["/robot", ARM]).await;
        let start = move || {
            let args = ["--hub", &hub, "--user", "arm"];
            Running::start("mom-arm", &args, &[("MOM_PASSWORD", "arm")])
        };
        let arm = spawn_blocking(start).await.expect("it starts");
        let came = loop {
            let joined = alice.next_of(Family::Event, "joined").await.value();
            if joined.get("user").and_then(Value::as_str) == Some("arm") {
                break joined.get("peer").cloned();
            }
        };
        loop {
            let members = alice
                .ask_about(Family::Context, "members", ARM)
                .await
                .expect("a list");
            let members = members.get("members").and_then(Value::as_list);
            let is_it = |member: &&Value| {
                let member = member.as_map().expect("a member");
                member.get("peer") == came.as_ref() && member.get("device").is_some()
            };
            if members.expect("members").iter().any(|member| is_it(&member)) {
                return arm;
            }
            // The next event, who joins among them, is a reason to look again.
            alice.next_within(Duration::from_millis(100)).await;
        }
    }

    async fn mom(&self, user: &'static str, arguments: &'static [&'static str]) -> Output {
        let hub = self.hub();
        let run = move || {
            let environment = [("MOM_HUB", &*hub), ("MOM_USER", user), ("MOM_PASSWORD", user)];
            programs::run("mom", arguments, &environment)
        };
        spawn_blocking(run).await.expect("it runs")
    }

    /// Whether the arm takes a command of alice.
    async fn obeys(&self) -> bool {
        let mut alice = Raw::login(self.broker.address(), Form::Binary, "alice").await;
        alice.join(&["/robot", ARM]).await;
        alice
            .ask_about(Family::Token, "grab", "/robot/token")
            .await
            .expect("it is free");
        loop {
            alice.post(message("command", ARM, "wait 1")).await;
            let status = alice.next_of(Family::Message, "status").await.value();
            let error = status.get("error").and_then(|error| error.get("name")).cloned();
            match error.as_ref().and_then(Value::as_str) {
                None => return true,
                Some("stopped") => return false,
                // It has not said yet that it stands for its new owner.
                Some(_) => {}
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_arm_that_was_away_finds_the_stop() {
    let lab = Away::start().await;
    let arm = lab.arm().await;
    drop(arm);
    // Nobody is there who could stand: that is said, and is not a success.
    let output = lab.mom("alice", &["stop", ARM, "--reason", "smoke"]).await;
    let expected = "/robot/arm: no device is there; it will find it stopped\n";
    let told_so = |output: &Output| {
        told(output)
            .1
            .starts_with("/robot/arm: the connection of arm is lost")
    };
    assert!(
        told(&output) == (Some(1), expected.to_owned()) || told_so(&output),
        "{output:?}"
    );
    let _arm = lab.arm().await;
    assert!(!lab.obeys().await, "it finds the stop");
    let free = lab.mom("bob", &["unstop", ARM]).await;
    assert!(
        text(&free.stdout).contains("was stopped by alice (smoke)"),
        "{free:?}"
    );
    assert!(lab.obeys().await);
}

/// Its program does not run while a command reaches it; the hub gives its link up, and tells so.
#[tokio::test(flavor = "multi_thread")]
async fn an_arm_that_stood_still_moves_by_nothing_said_before() {
    let lab = Away::start().await;
    let arm = lab.arm().await;
    let mut alice = Raw::login(lab.broker.address(), Form::Binary, "alice").await;
    alice.join(&["/robot", ARM]).await;
    let grabbed = alice.ask_about(Family::Token, "grab", "/robot/token").await;
    grabbed.expect("it is free");
    let id = |id: u64| Value::from(i64::try_from(id).expect("small"));
    let ends = async |alice: &mut Raw, command: u64, never: Option<u64>| loop {
        let status = alice.next_of(Family::Message, "status").await.value();
        let of = status.get("id").cloned();
        assert!(never.is_none_or(|never| of != Some(id(never))), "{status:?}");
        let state = status.get("state").and_then(Value::as_str);
        if of == Some(id(command)) && matches!(state, Some("finished" | "error")) {
            return state == Some("finished");
        }
    };
    // It says first that it stands for its new owner.
    loop {
        let command = alice.post(message("command", ARM, "wait 1")).await;
        if ends(&mut alice, command, None).await {
            break;
        }
    }
    arm.signal("STOP");
    let late = alice.post(message("command", ARM, "move 250 0 300 0 0")).await;
    alice.next_of(Family::Event, "lost").await;
    arm.signal("CONT");
    alice.next_of(Family::Event, "resumed").await;
    loop {
        let command = alice.post(message("command", ARM, "wait 1")).await;
        if ends(&mut alice, command, Some(late)).await {
            break;
        }
    }
}

/// `mom stop --ready`, and what it says and does.
struct ReadyStop {
    child: Child,
    keys: ChildStdin,
    told: Lines<BufReader<ChildStdout>>,
    remarks: Lines<BufReader<ChildStderr>>,
}

impl ReadyStop {
    async fn start(hub: &str) -> ReadyStop {
        let built = spawn_blocking(|| programs::program("mom"));
        let mut command = Command::new(built.await.expect("it is built"));
        command.args(["stop", ARM, "--ready", "--reason", "smoke"]);
        let environment = [("MOM_HUB", hub), ("MOM_USER", "bob"), ("MOM_PASSWORD", "bob")];
        command.envs(environment).kill_on_drop(true);
        command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut child = command.spawn().expect("it runs");
        ReadyStop {
            keys: child.stdin.take().expect("piped"),
            told: BufReader::new(child.stdout.take().expect("piped")).lines(),
            remarks: BufReader::new(child.stderr.take().expect("piped")).lines(),
            child,
        }
    }

    async fn press(&mut self) {
        self.keys.write_all(b"x").await.expect("it listens");
    }

    /// Waits for remarks with these words, in any order.
    async fn remarks(&mut self, words: &[&str]) {
        let mut left = words.to_vec();
        while !left.is_empty() {
            let line = timeout(PATIENCE, self.remarks.next_line()).await;
            let line = line.expect("in time").expect("it is read");
            let line = line.expect("it goes on");
            left.retain(|words| !line.contains(words));
        }
    }

    async fn tells(&mut self) -> String {
        let line = timeout(PATIENCE, self.told.next_line()).await.expect("in time");
        line.expect("it is read").expect("it goes on")
    }
}

/// The key that was pressed is not lost on a link that is frozen, or gone.
#[tokio::test(flavor = "multi_thread")]
async fn a_key_stops_also_over_a_connection_that_comes_back() {
    let lab = Away::start().await;
    let network = FaultyNetwork::to(lab.broker.address(), |_| Fault::default()).await;
    let _arm = lab.arm().await;
    let mut ready = ReadyStop::start(&format!("bin://{}", network.address)).await;
    ready.remarks(&["ready: any key stops /robot/arm"]).await;
    ready.press().await;
    assert_eq!(ready.tells().await, "/robot/arm: arm stands");
    let free = lab.mom("alice", &["unstop", ARM]).await;
    assert!(
        text(&free.stdout).contains("was stopped by bob (smoke)"),
        "{free:?}"
    );

    network.freeze(true);
    ready.press().await;
    let lost = "the connection is lost: a stop is said as soon as it is back";
    ready
        .remarks(&["it is unknown whether anything has stopped", lost])
        .await;
    network.freeze(false);
    assert_eq!(ready.tells().await, "/robot/arm: arm stands");
    let tree = lab.mom("alice", &["tree", "/robot"]).await;
    assert!(text(&tree.stdout).contains("stopped by bob (smoke)"), "{tree:?}");
    drop(ready.keys);
    let ended = timeout(PATIENCE, ready.child.wait()).await.expect("in time");
    assert!(ended.expect("it ran").success());
}

#[tokio::test(flavor = "multi_thread")]
async fn where_no_device_is_nothing_is_known_to_stand() {
    let lab = Away::start().await;
    let output = lab.mom("alice", &["stop", "/chat"]).await;
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(text(&output.stderr).contains("no device is there"), "{output:?}");
}

/// What one may not stop may move: that is not a success.
#[tokio::test(flavor = "multi_thread")]
async fn what_one_may_not_stop_is_named_and_is_no_success() {
    let mut lab = Away::start().await;
    let rule = "[[managers.lab.rules]]\nname = \"alice does not stop the arm\"\nusers = [\"alice\"]\n\
                where = [\"/robot/arm\"]\ndeny = [\"stop\"]\n\n[[managers.lab.rules]]";
    let config = lab.home.config();
    let config = config.replacen("[[managers.lab.rules]]", rule, 1);
    lab.broker.kill().await;
    lab.home.write_config(&config);
    lab.broker = lab.home.start().await;
    let _arm = lab.arm().await;
    let output = lab.mom("alice", &["stop"]).await;
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let said = text(&output.stdout);
    assert!(said.contains("you may not stop /robot/arm\n"), "{said}");
    assert!(!said.contains("/chat"), "nothing is there that moves: {said}");
}

/// A release halts the arm: who wants its last command carried out waits for that.
#[tokio::test(flavor = "multi_thread")]
async fn a_release_may_wait_until_the_arm_has_carried_out_the_last_command() {
    let lab = Away::start().await;
    let _arm = lab.arm().await;
    let builder = Client::builder(lab.hub()).user("alice").password("alice");
    let alice = builder.connect().await.expect("a user of the lab");
    let arm = alice.channel(ARM).await.expect("anybody may");
    let token = alice.token("/robot/token").await.expect("people may");
    let guard = token.grab().await.expect("it is free");
    let mut events = arm.events();
    for _ in 0..3 {
        arm.send("command", "wait 100").await.expect("it is hers");
    }
    let released = guard.release_after(After::Done, Duration::from_secs(30)).await;
    released.expect("it was hers");
    let mut finished = 0;
    loop {
        match events.next().await.expect("the channel stays") {
            Event::Message(parcel) if parcel.name() == "status" => {
                let status = parcel.value();
                finished += usize::from(status.get("state") == Some(&"finished".into()));
            }
            Event::Released { .. } => break,
            _ => {}
        }
    }
    assert_eq!(finished, 3, "before the token was free");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_arm_that_comes_back_while_it_is_stopped_can_be_let_go() {
    let lab = Away::start().await;
    let network = FaultyNetwork::to(lab.broker.address(), |_| Fault::default()).await;
    let _arm = lab.arm_at(format!("bin://{}", network.address)).await;
    network.sever();
    // It says so as soon as its connection is resumed.
    while lab.mom("bob", &["stop", ARM]).await.status.code() != Some(0) {}
    network.sever();
    while lab.mom("bob", &["stop", ARM]).await.status.code() != Some(0) {}
    let free = lab.mom("bob", &["unstop", ARM]).await;
    assert_eq!(free.status.code(), Some(0), "{free:?}");
    assert!(lab.obeys().await, "it has heard by the stop how it stands");
}

/// It is killed and started again while the hub keeps its lost link, and with it its name.
#[tokio::test(flavor = "multi_thread")]
async fn a_stop_by_name_holds_for_an_arm_that_is_started_again() {
    let lab = Away::start().await;
    let arm = lab.arm().await;
    let stop = lab.mom("bob", &["send", ARM, "stop", "--to", "arm"]).await;
    assert_eq!(stop.status.code(), Some(0), "{stop:?}");
    drop(arm);
    let _arm = lab.arm().await;
    assert!(!lab.obeys().await, "whatever its name is now");
    // That of before is still away.
    let free = lab.mom("bob", &["unstop", ARM]).await;
    assert!(text(&free.stdout).contains("arm~2 may move"), "{free:?}");
    assert!(lab.obeys().await);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_outlives_the_hub_and_the_arm() {
    for keeps in ["", "[store]\npath = \"store\""] {
        let mut lab = Away::start_with(keeps).await;
        let arm = lab.arm().await;
        let stopped = lab.mom("bob", &["stop", ARM]).await;
        assert_eq!(stopped.status.code(), Some(0), "{stopped:?}");
        drop(arm);
        lab.broker.kill().await;
        lab.broker = lab.home.start().await;
        let _arm = lab.arm().await;
        assert!(!lab.obeys().await, "as it was: {keeps:?}");
        let tree = lab.mom("alice", &["tree", "/robot"]).await;
        assert!(text(&tree.stdout).contains("stopped by bob"), "{tree:?}");
        lab.broker.kill().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn where_what_was_kept_is_damaged_all_is_stopped() {
    let mut lab = Away::start().await;
    let stopped = lab.mom("bob", &["stop", ARM]).await;
    assert_eq!(stopped.status.code(), Some(1), "no arm is there: {stopped:?}");
    let unstopped = lab.mom("bob", &["unstop", ARM]).await;
    assert_eq!(unstopped.status.code(), Some(1), "{unstopped:?}");
    lab.broker.kill().await;
    let folder = lab.home.file("state-home").join("mom");
    let files = std::fs::read_dir(folder)
        .expect("a folder")
        .map(|file| file.expect("a file").path());
    let mut kept = files.filter(|file| file.extension().is_some_and(|end| end == "json"));
    let kept = kept.next().expect("what is kept");
    std::fs::write(&kept, "mom-stops-1 00000000\n[]").expect("written");
    lab.broker = lab.home.start().await;
    assert!(lab.home.log().contains("cannot be read"), "it says so");
    let arm = lab.arm().await;
    assert!(!lab.obeys().await, "stopped wins");
    let free = lab.mom("bob", &["unstop", ARM]).await;
    assert_eq!(free.status.code(), Some(0), "{free:?}");
    assert!(lab.obeys().await);
    drop(arm);
    // What nobody has let go since is stopped after the next start, too.
    lab.broker.kill().await;
    lab.broker = lab.home.start().await;
    let tree = lab.mom("alice", &["tree"]).await;
    let tree = text(&tree.stdout);
    assert!(line(&tree, "pan ").contains("stopped by hub"), "{tree}");
    assert!(!line(&tree, "arm ").contains("stopped by hub"), "{tree}");
    // And one that was deleted is not one that never was.
    lab.broker.kill().await;
    std::fs::remove_file(&kept).expect("it was there");
    lab.broker = lab.home.start().await;
    let tree = lab.mom("alice", &["tree", "/robot"]).await;
    let tree = text(&tree.stdout);
    assert!(line(&tree, "arm ").contains("stopped by hub"), "{tree}");
    lab.broker.kill().await;
}

/// The line of a tree about a context.
fn line<'a>(tree: &'a str, name: &str) -> &'a str {
    let line = tree.lines().find(|line| line.contains(name));
    line.unwrap_or_else(|| panic!("{name} in {tree}"))
}
