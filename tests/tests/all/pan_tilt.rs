//! The lab's camera that turns (M62): driven by the owner of its own token only, regardless of the arm's owner.

use std::fs::{self, File};
use std::path::PathBuf;

use mom_client::{Client, Event, Events, Value};
use mom_tests::lab;
use mom_tests::programs::{PATIENCE, Running, run, text};
use tokio::task::spawn_blocking;
use tokio::time::timeout;

/// Longer than any test: to and fro, through most of what the mount can.
const TO_AND_FRO: &str = "look 170 -60\nlook -170 30\n";
const DRIVE_PAN: [&str; 6] = [
    "run",
    "--no-check",
    "--channel",
    "/camera/pan",
    "--token",
    "/camera/pan-token",
];

/// What a command has said when it ended.
struct Said {
    code: Option<i32>,
    out: String,
    words: String,
}

/// `mom lab` as a process, and a folder for scripts and logs.
struct Lab {
    _program: Running,
    hub: String,
    folder: tempfile::TempDir,
}

impl Lab {
    async fn start() -> Lab {
        let (program, hub) = spawn_blocking(Running::lab).await.expect("the lab starts");
        Lab {
            _program: program,
            hub,
            folder: tempfile::tempdir().expect("a folder"),
        }
    }

    async fn join(&self, user: &str) -> Client {
        let client = Client::builder(self.hub.as_str()).user(user).password(user);
        client.connect().await.expect("the lab knows its users")
    }

    /// Runs the command line as a user, to its end.
    async fn mom(&self, user: &str, args: &[&str]) -> Said {
        let (hub, user) = (self.hub.clone(), user.to_owned());
        let args: Vec<String> = args.iter().map(|&arg| arg.to_owned()).collect();
        let ran = spawn_blocking(move || {
            let args: Vec<&str> = args.iter().map(String::as_str).collect();
            let login = [("MOM_HUB", &*hub), ("MOM_USER", &*user), ("MOM_PASSWORD", &*user)];
            run("mom", &args, &login)
        });
        let output = ran.await.expect("it runs");
        Said {
            code: output.status.code(),
            out: text(&output.stdout),
            words: text(&output.stderr),
        }
    }

    fn script(&self, name: &str, text: &str) -> String {
        let path = self.folder.path().join(name);
        fs::write(&path, text).expect("written");
        path.to_str().expect("text").to_owned()
    }

    /// Starts a script of this user beside the test, and waits until its first statement is being carried out; its
    /// standard error goes to a file.
    async fn drive(&self, user: &str, args: &[&str], script: &str) -> (Running, PathBuf) {
        let script = self.script(&format!("{user}.script"), script);
        let log = self.folder.path().join(format!("{user}.log"));
        let file = File::create(&log).expect("a file");
        let (hub, user) = (self.hub.clone(), user.to_owned());
        let args: Vec<String> = args.iter().map(|&arg| arg.to_owned()).collect();
        let started = spawn_blocking(move || {
            let mut args: Vec<&str> = args.iter().map(String::as_str).collect();
            args.push(&script);
            let login = [("MOM_HUB", &*hub), ("MOM_USER", &*user), ("MOM_PASSWORD", &*user)];
            let running = Running::start_with("mom", &args, &login, file.into());
            running.line_with("executing");
            running
        });
        (started.await.expect("it runs"), log)
    }
}

/// The end of a program, and what stands in its log.
async fn ended(running: Running, log: PathBuf) -> (Option<i32>, String) {
    let status = spawn_blocking(move || running.wait()).await.expect("waited for");
    (status.code(), fs::read_to_string(log).expect("its log"))
}

fn angle(content: &Value, key: &str) -> f64 {
    match content.get(key) {
        Some(Value::Double(angle)) => *angle,
        other => panic!("{key} is {other:?} in {content:?}"),
    }
}

/// The next message of this name that `pick` takes.
async fn message(events: &mut Events, name: &str, pick: impl Fn(&Value) -> bool) -> Value {
    let wanted = async {
        loop {
            match events.next().await.expect("the client lives") {
                Event::Message(parcel) if parcel.name() == name => {
                    let content = parcel.value();
                    if pick(&content) {
                        return content;
                    }
                }
                _ => {}
            }
        }
    };
    timeout(PATIENCE, wanted).await.expect("it comes")
}

fn is(content: &Value, key: &str, word: &str) -> bool {
    content.get(key).and_then(Value::as_str) == Some(word)
}

/// All that the camera says until it carries out a command of this peer.
async fn until_it_obeys(events: &mut Events, peer: &str) -> Vec<(String, Value)> {
    let mut heard = Vec::new();
    let all = async {
        loop {
            if let Event::Message(parcel) = events.next().await.expect("the client lives")
                && matches!(parcel.name(), "state" | "status")
            {
                let content = parcel.value();
                let begins = is(&content, "peer", peer) && is(&content, "state", "executing");
                heard.push((parcel.name().to_owned(), content));
                if begins {
                    return;
                }
            }
        }
    };
    timeout(PATIENCE, all).await.expect("it obeys");
    heard
}

#[tokio::test(flavor = "multi_thread")]
async fn arm_and_camera_have_owners_of_their_own() {
    let lab = Lab::start().await;
    let watcher = lab.join("bob").await;
    let camera = watcher.channel("/camera/pan").await.expect("people may");
    let mut events = camera.events();
    let (arm, _) = lab.drive("alice", &["run"], "wait 60000\n").await;
    let (turning, log) = lab.drive("bob", &DRIVE_PAN, &TO_AND_FRO.repeat(9)).await;

    // Neither can do what is the other's, by whichever way.
    let said = lab.mom("alice", &["aim", "0", "0"]).await;
    assert_eq!((said.code, said.out.as_str()), (Some(1), ""));
    assert!(
        said.words.contains("/camera/pan-token is held by bob"),
        "{}",
        said.words
    );
    let said = lab
        .mom("alice", &["send", "/camera/pan", "command", "home"])
        .await;
    assert_eq!(said.code, Some(1), "{}{}", said.out, said.words);
    let said = lab.mom("bob", &["run", &lab.script("home", "home")]).await;
    assert!(
        said.words.contains("/robot/token is held by alice"),
        "{}",
        said.words
    );
    let said = lab.mom("alice", &["camera", "pan", "--quality", "50"]).await;
    let reason = "only the owner of /camera/pan-token changes the settings, and that is bob";
    assert!(said.words.contains(reason), "{}", said.words);
    let is_moving = |state: &Value| state.get("moving") == Some(&Value::Bool(true));
    let moving = message(&mut events, "state", is_moving).await;

    // Carol takes it: the camera stands before anything of hers begins.
    while events.try_next().is_some() {}
    let said = lab.mom("carol", &["aim", "0", "-20"]).await;
    assert_eq!(said.code, Some(0), "{}", said.words);
    let heard = until_it_obeys(&mut events, "carol").await;
    let halted = heard.iter().any(|(_, content)| {
        let error = content.get("error");
        is(content, "peer", "bob~2") && error.is_some_and(|error| is(error, "name", "halted"))
    });
    assert!(halted, "bob's command ends: {heard:#?}");
    let states = heard.iter().filter(|(name, _)| name == "state");
    let standing: Vec<&Value> = states
        .map(|(_, state)| state)
        .skip_while(|state| state.get("moving") != Some(&Value::Bool(false)))
        .collect();
    let first = standing.first().expect("it stands");
    for state in &standing {
        assert_eq!(state.get("moving"), Some(&Value::Bool(false)), "{heard:#?}");
        assert_eq!(state.get("pan"), first.get("pan"), "{heard:#?}");
        assert_eq!(state.get("tilt"), first.get("tilt"), "{heard:#?}");
    }
    let fence = |state: &Value| state.get("fence").and_then(Value::as_int);
    assert!(
        standing.last().and_then(|state| fence(state)) > fence(&moving),
        "it stands for her: {heard:#?}"
    );
    let (code, words) = ended(turning, log).await;
    assert_eq!(code, Some(1));
    assert!(words.contains("lost /camera/pan-token: carol"), "{words}");
    let token = watcher.token("/robot/token").await.expect("people may");
    let owner = token.status().await.expect("told").owner;
    assert_eq!(owner.as_deref(), Some("alice"), "the arm is not concerned");
    arm.signal("INT");
}

/// Row by row, the last row of a camera's matrix is where it looks.
fn looks(content: &Value) -> (f64, f64) {
    let matrix = content.get("matrix").and_then(Value::as_list).expect("a matrix");
    let number = |place: usize| match matrix[place] {
        Value::Double(number) => number,
        ref other => panic!("{other:?} in a matrix"),
    };
    let (x, y, z) = (number(8), number(9), number(10));
    // From the corner, the middle of the table is at 135° from the x axis.
    let pan = (135.0 - y.atan2(x).to_degrees() + 540.0).rem_euclid(360.0) - 180.0;
    (pan, z.asin().to_degrees())
}

#[tokio::test(flavor = "multi_thread")]
async fn images_tell_how_it_turns() {
    let lab = Lab::start().await;
    let bob = lab.join("bob").await;
    let mut events = bob.channel("/camera/pan").await.expect("people may").events();
    let said = lab.mom("alice", &["aim", "90", "-40"]).await;
    assert_eq!(said.code, Some(0), "{}", said.words);
    let mut pans = Vec::new();
    loop {
        let image = message(&mut events, "image", |_| true).await;
        let aim = image.get("aim").expect("where it looks");
        let (pan, tilt) = (angle(aim, "pan"), angle(aim, "tilt"));
        let seen = looks(&image);
        assert!(
            (seen.0 - pan).abs() < 1e-6 && (seen.1 - tilt).abs() < 1e-6,
            "{seen:?} where it says {pan} {tilt}"
        );
        pans.push(pan);
        if pan == 90.0 {
            break;
        }
    }
    // How many images there are on the way is a matter of the machine's speed.
    assert!(pans.is_sorted(), "{pans:?}");

    // By so much from where it is; the newest image is of there.
    let said = lab.mom("alice", &["aim", "--by", "-100", "15.5"]).await;
    assert_eq!(said.code, Some(0), "{}", said.words);
    let file = lab.folder.path().join("pan.jpg");
    let file = file.to_str().expect("text");
    let snap = lab.mom("alice", &["snap", "pan", "--json", "-o", file]).await;
    let snap: serde_json::Value = serde_json::from_str(&snap.out).expect("JSON");
    assert_eq!(snap["aim"], serde_json::json!({"pan": -10.0, "tilt": -24.5}));

    // A relative command that names no state is refused, as the arm's.
    let said = lab.mom("alice", &["aim", "--by", "200", "0"]).await;
    assert!(
        said.out.contains("pan is 190°") && said.out.contains("[joint-limit 5005]"),
        "{}",
        said.out
    );
    let token = bob.token("/camera/pan-token").await.expect("people may");
    let guard = token.grab().await.expect("it is free");
    let sent = bob.channel("/camera/pan").await.expect("people may");
    sent.send("command", "turn 1 0").await.expect("he owns it");
    let status = message(&mut events, "status", |status| is(status, "peer", "bob")).await;
    let error = status.get("error").expect("why not");
    assert!(is(error, "name", "no-state"), "{error:?}");
    guard.release().await.expect("it is his");

    // No one matrix is right for it.
    let said = lab.mom("alice", &["calibrate", "pan"]).await;
    assert_eq!(said.code, Some(1));
    assert!(said.words.contains("turns by command"), "{}", said.words);
    // Its settings are a matter of its own token.
    let said = lab.mom("alice", &["camera", "pan", "--size", "320x240"]).await;
    assert_eq!(
        said.out.trim_end(),
        "/camera/pan  320x240, quality 80, jpeg",
        "{}",
        said.words
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_halts_it_and_so_does_the_loss_of_its_owner() {
    let lab = Lab::start().await;
    let carol = lab.join("carol").await;
    let mut events = carol.channel("/camera/pan").await.expect("people may").events();
    let (turning, log) = lab.drive("bob", &DRIVE_PAN, &TO_AND_FRO.repeat(9)).await;
    let said = lab.mom("alice", &["stop", "/camera/pan"]).await;
    assert_eq!(
        said.out.trim_end(),
        "/camera/pan: camera-pan stands",
        "{}",
        said.words
    );
    let (code, words) = ended(turning, log).await;
    assert_eq!(code, Some(1));
    assert!(
        words.contains("let it go with: mom unstop /camera/pan"),
        "{words}"
    );
    let said = lab.mom("alice", &["aim", "--home"]).await;
    assert!(said.out.contains("[stopped 5102]"), "{}{}", said.out, said.words);
    assert!(said.words.contains("the camera is stopped"), "{}", said.words);
    let said = lab.mom("alice", &["unstop", "/camera/pan"]).await;
    assert_eq!(
        said.out.trim_end(),
        "/camera/pan: camera-pan may move; was stopped by alice",
        "{}",
        said.words
    );

    // A program that dies loses its token, and the camera stands.
    let (turning, _) = lab.drive("bob", &DRIVE_PAN, &TO_AND_FRO.repeat(9)).await;
    while events.try_next().is_some() {}
    turning.signal("KILL");
    let status = message(&mut events, "status", |status| is(status, "state", "error")).await;
    let error = status.get("error").expect("why");
    assert!(is(error, "name", "halted"), "{error:?}");
    let said = lab.mom("alice", &["aim", "--home"]).await;
    assert_eq!(said.code, Some(0), "{}{}", said.out, said.words);
}

/// The camera as a program of its own says how it ends.
#[tokio::test(flavor = "multi_thread")]
async fn a_program_that_ends_halts_first_and_says_so() {
    let broker = lab::start().await;
    let hub = format!("bin://{}", broker.local_addr());
    let alice = Client::builder(&hub).user("alice").password("alice");
    let alice = alice.connect().await.expect("the lab knows its users");
    let channel = alice.channel("/camera/pan").await.expect("people may");
    let mut events = channel.events();
    let address = hub.clone();
    let program = spawn_blocking(move || {
        let args = [
            "--hub", &*address, "--view", "pan", "--width", "64", "--height", "48",
        ];
        Running::start("mom-camera", &args, &[("MOM_PASSWORD", "camera")])
    });
    let program = program.await.expect("it starts");
    let ready = message(&mut events, "state", |_| true).await;
    assert_eq!((angle(&ready, "pan"), angle(&ready, "tilt")), (0.0, -20.0));
    let token = alice.token("/camera/pan-token").await.expect("people may");
    let _guard = token.grab().await.expect("it is free");
    channel
        .send("command", "look 170 0; look -170 0")
        .await
        .expect("hers");
    let moving = message(&mut events, "state", |state| {
        state.get("moving") == Some(&Value::Bool(true))
    });
    moving.await;
    program.signal("INT");
    let status = message(&mut events, "status", |status| is(status, "state", "error")).await;
    let error = status.get("error").expect("why");
    assert!(
        is(error, "text", "the camera was halted: its program ends"),
        "{error:?}"
    );
    let ended = spawn_blocking(move || program.wait()).await.expect("waited for");
    assert_eq!(ended.code(), Some(0));

    // A real camera has no mount of ours.
    let refused = spawn_blocking(move || {
        let url = "http://127.0.0.1:9/x.mjpg";
        let args = ["--hub", &*hub, "--view", "pan", "--url", url];
        run("mom-camera", &args, &[("MOM_PASSWORD", "camera")])
    });
    let refused = refused.await.expect("it ends");
    assert_eq!(refused.status.code(), Some(1));
    let words = text(&refused.stderr);
    assert!(words.contains("its mount is simulated"), "{words}");
}
