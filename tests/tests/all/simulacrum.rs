//! A thin robot that is mirrored over datagrams, as a device of the hub (S1 to S25): robot, middle and hub are programs of their own.

use std::net::SocketAddr;
use std::process::{Command, Output};
use std::time::Duration;

use mom_client::{Client, Event, Events, Map, Value};
use mom_drive::{Commander, DeviceChannel};
use mom_tests::datagrams::{Datagrams, Weather};
use mom_tests::programs::{PATIENCE, Running, program, project, run, text};
use tokio::task::spawn_blocking;
use tokio::time::timeout;

/// Robot, network, middle and hub.
pub(crate) struct Stage {
    pub(crate) hub: String,
    pub(crate) network: Datagrams,
    pub(crate) cubo: Running,
    /// Where the robot shows its body.
    pub(crate) page: SocketAddr,
    pub(crate) middle: Running,
    broker: Running,
    _folder: tempfile::TempDir,
}

impl Stage {
    /// All of them, at work; with a key unless the middle is in the paper's mode.
    pub(crate) async fn new(options: &[&str]) -> Stage {
        let folder = tempfile::tempdir().expect("a folder");
        let key = folder.path().join("cubo.key");
        let key = key.to_str().expect("a path").to_owned();
        let written = run("mom-cubo", &["--write-key", &key], &[]);
        assert!(written.status.success(), "{}", text(&written.stderr));
        let paper = options.contains(&"--paper");
        let keyed = ["--robot-key", key.as_str()];
        let keyed = if paper { &[][..] } else { &keyed[..] };
        // Its log is read as its output is. A machine that is busy with other tests may be silent for longer than 500 ms.
        let mut command = Command::new("sh");
        command
            .args(["-c", "exec \"$0\" \"$@\" 2>&1"])
            .arg(program("mom-cubo"));
        command
            .args([
                "--listen",
                "127.0.0.1:0",
                "--watchdog",
                "2000",
                "--web",
                "127.0.0.1:0",
            ])
            .args(keyed);
        let cubo = Running::of("mom-cubo", &mut command);
        let address = cubo
            .line_with("listens on")
            .rsplit(' ')
            .next()
            .expect("an address")
            .to_owned();
        let page = cubo.line_with("shows itself on");
        let page = page.rsplit('/').nth(1).expect("an address");
        let page = page.parse().expect("an address");
        let network = Datagrams::before(address.parse().expect("an address"), 1);
        let network = network.expect("a network");
        let (broker, hub) = Running::broker(&project().join("config/fleet.toml"));
        let hub = format!("bin://{hub}");
        let robot = format!("/fleet/1={}", network.address());
        let model = project().join("config/cubo.toml");
        let model = model.to_str().expect("a path");
        let known = [
            "--hub",
            &hub,
            "--model",
            model,
            "--robot",
            &robot,
            "--manager",
            "robot-token",
            "--silence",
            "2000",
        ];
        let middle = Running::start(
            "mom-simulacrum",
            &[&known[..], keyed, options].concat(),
            &[("MOM_PASSWORD", "gateway")],
        );
        Stage {
            hub,
            network,
            cubo,
            page,
            middle,
            broker,
            _folder: folder,
        }
    }

    pub(crate) async fn arrive(&self, name: &str) -> Client {
        let client = Client::builder(&self.hub)
            .user(name)
            .password(name)
            .connect()
            .await;
        client.expect("the lab knows its users")
    }
}

/// The events of the robot's channel once it has a session.
pub(crate) async fn linked(client: &Client) -> (DeviceChannel, Events) {
    let there = async {
        loop {
            if let Ok(channel) = DeviceChannel::join(client, "/fleet/1/robot").await {
                return channel;
            }
            tokio::task::yield_now().await;
        }
    };
    let channel = timeout(PATIENCE, there).await.expect("its gateway makes it");
    let mut events = channel.events();
    told(&mut events, |state| {
        is(state, "linked") && state.get("x").is_some()
    })
    .await;
    (channel, events)
}

async fn message(events: &mut Events, name: &str, wanted: impl Fn(&Value) -> bool) -> Value {
    let heard = async {
        loop {
            match events.next().await.expect("the hub lives") {
                Event::Message(parcel) if parcel.name() == name && wanted(&parcel.value()) => {
                    return parcel.value();
                }
                _ => {}
            }
        }
    };
    timeout(PATIENCE, heard)
        .await
        .unwrap_or_else(|_| panic!("{name} is said"))
}

pub(crate) async fn told(events: &mut Events, wanted: impl Fn(&Value) -> bool) -> Value {
    message(events, "state", wanted).await
}

pub(crate) fn is(content: &Value, key: &str) -> bool {
    content.get(key).and_then(Value::as_bool) == Some(true)
}

/// The first number of a list.
fn first(content: &Value, key: &str) -> Option<f64> {
    match content.get(key)? {
        Value::List(values) => match values.first()? {
            Value::Double(value) => Some(*value),
            Value::Int(value) => Some(*value as f64),
            _ => None,
        },
        _ => None,
    }
}

pub(crate) async fn grab(client: &Client) -> mom_client::TokenGuard {
    let token = client.token("/fleet/1/token").await.expect("they may look");
    token.grab().await.expect("it is had")
}

/// S3, S7: what is wanted stands beside what the robot has confirmed, late joiners get all of it, and then what changes.
#[tokio::test(flavor = "multi_thread")]
async fn the_mirror_tells_what_is_wanted_and_what_is_confirmed() {
    let stage = Stage::new(&[]).await;
    let alice = stage.arrive("alice").await;
    let (channel, _) = linked(&alice).await;
    let guard = grab(&alice).await;
    let mut robot = Commander::new(channel, guard.fence());
    let end = robot.carry_out("set joints 30 -20 10; do gesture 3").await;
    assert!(end.is_finished(), "{end:?}");
    // Who joins later.
    let bob = stage.arrive("bob").await;
    let mirror = bob.channel("/fleet/1/simulacrum").await.expect("he may look");
    let mut events = mirror.events();
    let joints = message(&mut events, "joints", |joints| {
        first(joints, "value") == Some(30.0)
    })
    .await;
    assert_eq!(first(&joints, "wanted"), Some(30.0));
    assert!(is(&joints, "active") && is(&joints, "activated"));
    // The body follows (S25), and its monitor says so.
    message(&mut events, "posture", |posture| {
        first(posture, "value").is_some_and(|left| left > 25.0)
    })
    .await;
    let packet = message(&mut events, "packet", |packet| packet.get("error").is_some()).await;
    let error = packet.get("error").and_then(Value::as_int).expect("µs");
    assert!(error < 500_000, "the clock is known to {error} µs");
    // What a command that is done has left set rests too, when nobody owns it any more.
    guard.release().await.expect("it was had");
    message(&mut events, "joints", |joints| {
        first(joints, "value") == Some(0.0)
    })
    .await;
}

/// S4: who may drive has code made of a model by the robot's middle, as the console's modeller does; a guest does not.
#[tokio::test(flavor = "multi_thread")]
async fn code_is_made_for_who_asks_in_the_mirror() {
    let stage = Stage::new(&[]).await;
    let alice = stage.arrive("alice").await;
    linked(&alice).await;
    let mirror = alice.channel("/fleet/1/simulacrum").await.expect("she may look");
    let mut events = mirror.events();
    let ask = Map::new().with("language", "c");
    mirror.send("generate", ask.clone()).await.expect("it leaves");
    let made = message(&mut events, "generated", |_| true).await;
    let word = |key: &str| {
        made.get(key)
            .and_then(Value::as_str)
            .unwrap_or_default()
            .to_owned()
    };
    assert_eq!(word("name"), "cubo.h", "{made:?}");
    assert!(word("text").contains("#define CUBO_SAMPLE_RATE_SPEAKER 48900"));
    let wrong = ask.with("model", "name = \"cart\"\nid = seven\n");
    mirror.send("generate", wrong).await.expect("it leaves");
    let refused = message(&mut events, "generated", |_| true).await;
    let why = refused.get("error").and_then(Value::as_str).unwrap_or_default();
    assert!(why.starts_with("line 2, column "), "{why}");
}

/// One arbitration over all protocols: who does not own the token moves nothing, and a change of owner has the robot rest first.
#[tokio::test(flavor = "multi_thread")]
async fn only_the_owner_drives_and_who_takes_over_finds_it_at_rest() {
    let stage = Stage::new(&[]).await;
    let alice = stage.arrive("alice").await;
    let (channel, _) = linked(&alice).await;
    let carol = stage.arrive("carol").await;
    let (hers, mut events) = linked(&carol).await;
    let mut stranger = Commander::new(hers, 0);
    let refused = stranger.carry_out("motor 300 300 1000").await;
    let why = format!("{refused:?}");
    assert!(refused.name() == "not-owner", "{why}");
    let guard = grab(&alice).await;
    let mut robot = Commander::new(channel, guard.fence());
    let driving = tokio::spawn(async move { robot.carry_out("motor 100 -100 60000").await });
    told(&mut events, |state| is(state, "moving")).await;
    let mirror = carol.channel("/fleet/1/simulacrum").await.expect("she may look");
    let mut elements = mirror.events();
    message(&mut elements, "left-wheel", |wheel| {
        first(wheel, "value") == Some(50.0)
    })
    .await;
    // Carol's level is above alice's.
    let hers = grab(&carol).await;
    message(&mut elements, "left-wheel", |wheel| {
        first(wheel, "value") == Some(0.0)
    })
    .await;
    let end = driving.await.expect("it ended");
    assert!(!end.is_finished(), "{end:?}");
    hers.release().await.expect("it was had");
}

/// A cut network: the robot rests by its watchdog, its command ends as `link`, and what was under way is not executed when it is back.
#[tokio::test(flavor = "multi_thread")]
async fn a_cut_network_has_it_rest_and_nothing_is_executed_twice() {
    let stage = Stage::new(&[]).await;
    let alice = stage.arrive("alice").await;
    let (channel, mut events) = linked(&alice).await;
    stage.cubo.line_with("a session began");
    let guard = grab(&alice).await;
    let mut robot = Commander::new(channel, guard.fence());
    let driving = tokio::spawn(async move {
        let end = robot.carry_out("motor 100 -100 60000").await;
        (robot, end)
    });
    told(&mut events, |state| is(state, "moving")).await;
    stage.network.set(Weather {
        cut: true,
        ..Weather::default()
    });
    stage.cubo.line_with("the robot rests");
    let (mut robot, end) = driving.await.expect("it ended");
    let why = format!("{end:?}");
    assert!(why.contains("is lost"), "{why}");
    told(&mut events, |state| !is(state, "linked")).await;
    stage.network.set(Weather::default());
    stage.cubo.line_with("a session began");
    told(&mut events, |state| is(state, "linked") && !is(state, "moving")).await;
    let end = robot.carry_out("do gesture 1").await;
    assert!(end.is_finished(), "{end:?}");
    guard.release().await.expect("it was had");
}

/// S18 to S24: over a network that loses, doubles and reorders, commands are executed, and the robot arrives.
#[tokio::test(flavor = "multi_thread")]
async fn it_drives_through_a_bad_network() {
    let stage = Stage::new(&["--period", "10"]).await;
    stage.network.set(Weather {
        loss: 0.1,
        doubled: 0.1,
        delay: Duration::from_millis(5),
        jitter: Duration::from_millis(20),
        ..Weather::default()
    });
    let alice = stage.arrive("alice").await;
    let (channel, mut events) = linked(&alice).await;
    let guard = grab(&alice).await;
    let mut robot = Commander::new(channel, guard.fence());
    let end = robot
        .carry_out("goto 2800 2500; do gesture 2; do gesture 2")
        .await;
    assert!(end.is_finished(), "{end:?}");
    told(&mut events, |state| {
        let x = state.get("x").and_then(Value::as_int);
        !is(state, "moving") && x.is_some_and(|x| (2700..=2900).contains(&x))
    })
    .await;
    guard.release().await.expect("it was had");
}

/// S10: where much is lost the middle sends less often, and as before where that does not help.
#[tokio::test(flavor = "multi_thread")]
async fn the_middle_chooses_the_period() {
    let stage = Stage::new(&["--period", "20-40"]).await;
    let alice = stage.arrive("alice").await;
    let (_, mut events) = linked(&alice).await;
    let period = |ms: i64| move |state: &Value| state.get("period").and_then(Value::as_int) == Some(ms);
    told(&mut events, period(20)).await;
    stage.network.set(Weather {
        loss: 0.2,
        ..Weather::default()
    });
    told(&mut events, period(40)).await;
    told(&mut events, period(20)).await;
}

/// What alice is told who sends this to robot 1, with a file.
fn send(hub: &str, script: &str, file: &str) -> Output {
    let words = [
        "--hub", hub, "--user", "alice", "fleet", "send", "1", script, "--attach", file,
    ];
    run("mom", &words, &[("MOM_PASSWORD", "alice")])
}

/// S13, S25: a sound comes with its command, is played beside a gesture over a bad network, and the robot's microphone hears it. Nobody
/// else's sound is played.
#[tokio::test(flavor = "multi_thread")]
async fn a_sound_is_played_over_a_bad_network_and_heard() {
    let stage = Stage::new(&[]).await;
    let alice = stage.arrive("alice").await;
    linked(&alice).await;
    stage.network.set(Weather {
        loss: 0.02,
        doubled: 0.05,
        delay: Duration::from_millis(5),
        jitter: Duration::from_millis(20),
        ..Weather::default()
    });
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("hello.wav");
    // It is given the rate of the robot's loudspeaker.
    let wav = mom_sound::Clip::tone(440.0, 1.0, 44_100)
        .to_wav()
        .expect("a file");
    std::fs::write(&file, wav).expect("it is written");
    let mirror = alice.channel("/fleet/1/simulacrum").await.expect("she may look");
    let mut elements = mirror.events();
    let hub = stage.hub.clone();
    let sending = spawn_blocking(move || {
        let attached = file.to_str().expect("a path").to_owned();
        [
            "play speaker hello on; do gesture 2; wait 1200",
            "play speaker nobody",
            "play lcd hello",
            "show lcd hello",
        ]
        .map(|script| send(&hub, script, &attached))
    });
    // 30 dB is its room.
    message(&mut elements, "surroundings", |content| {
        match content.get("value") {
            Some(Value::List(values)) => matches!(values.get(2), Some(Value::Double(level)) if *level > 60.0),
            _ => false,
        }
    })
    .await;
    let [played, missing, silent, shown] = sending.await.expect("they ran");
    assert!(
        played.status.success(),
        "{}{}",
        text(&played.stdout),
        text(&played.stderr)
    );
    let line = stage.cubo.line_with("a sound was played");
    assert!(line.contains("blocks=") && !line.contains("blocks=0"), "{line}");
    for (output, words) in [
        (&missing, "`nobody` did not come with the script, but hello"),
        (&silent, "`lcd` plays no sound by its model"),
    ] {
        let said = text(&output.stdout) + &text(&output.stderr);
        assert!(!output.status.success() && said.contains(words), "{said}");
    }
    assert!(
        shown.status.success(),
        "{}{}",
        text(&shown.stdout),
        text(&shown.stderr)
    );
}

/// The verbs of fleets and devices know it as any other robot.
#[tokio::test(flavor = "multi_thread")]
async fn a_thin_robot_is_one_of_the_fleet() {
    let stage = Stage::new(&[]).await;
    let alice = stage.arrive("alice").await;
    let (_, mut events) = linked(&alice).await;
    let hub = stage.hub.clone();
    let (sent, refused, listed) = spawn_blocking(move || {
        let mom = |args: &[&str]| {
            let known = ["--hub", hub.as_str(), "--user", "alice"];
            run("mom", &[&known[..], args].concat(), &[("MOM_PASSWORD", "alice")])
        };
        (
            mom(&["fleet", "send", "1", "motor 200 200 300"]),
            mom(&["fleet", "send", "1", "set left-wheel 100"]),
            mom(&["fleet", "list"]),
        )
    })
    .await
    .expect("they ran");
    assert!(sent.status.success(), "{}", text(&sent.stderr));
    assert!(
        text(&listed.stdout).contains("    1  "),
        "{}",
        text(&listed.stdout)
    );
    let words = text(&refused.stdout) + &text(&refused.stderr);
    assert!(
        !refused.status.success() && words.contains("is a speed"),
        "{words}"
    );
    told(&mut events, |state| !is(state, "moving")).await;
}

/// The hub is lost: the robot rests, and the middle ends when it is told to, whatever it had to say.
#[tokio::test(flavor = "multi_thread")]
async fn a_lost_hub_has_it_rest_and_the_middle_still_ends() {
    let Stage {
        hub,
        network: _network,
        cubo,
        page: _,
        middle,
        broker,
        _folder,
    } = Stage::new(&[]).await;
    let alice = Client::builder(&hub)
        .user("alice")
        .password("alice")
        .connect()
        .await;
    let alice = alice.expect("the lab knows her");
    let (channel, mut events) = linked(&alice).await;
    let guard = grab(&alice).await;
    let mut robot = Commander::new(channel, guard.fence());
    tokio::spawn(async move { robot.carry_out("motor 100 -100 60000").await });
    told(&mut events, |state| is(state, "moving")).await;
    broker.signal("KILL");
    middle.signal("TERM");
    let ended = spawn_blocking(|| middle.wait()).await.expect("it ends");
    assert!(ended.success(), "{ended}");
    spawn_blocking(move || cubo.line_with("the robot rests"))
        .await
        .expect("it does");
}
