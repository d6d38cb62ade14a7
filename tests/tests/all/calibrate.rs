//! `mom calibrate` against the real lab (M55): the matrix in use is the measured one, and nobody else's.

use std::time::Duration;

use mom_client::{Channel, Client, Event, Events, Family, Map, Parcel, Value};
use mom_tests::programs::{PATIENCE, Running, project, run, text};
use serde_json::{Value as Json, json};
use tokio::task::spawn_blocking;
use tokio::time::timeout;

/// `mom lab` as a process, on a free port.
struct Lab {
    program: Running,
    hub: String,
}

/// What a command said, and its exit code.
struct Said {
    code: Option<i32>,
    out: String,
    words: String,
}

impl Lab {
    async fn start() -> Lab {
        let started = spawn_blocking(|| {
            let (program, hub) = Running::lab();
            Lab { program, hub }
        });
        started.await.expect("the lab starts")
    }

    async fn join(&self, user: &str) -> Client {
        let client = Client::builder(self.hub.as_str()).user(user).password(user);
        client.connect().await.expect("the lab knows its users")
    }

    /// Runs the command line as bob.
    async fn bob(&self, args: &[&str]) -> Said {
        let hub = self.hub.clone();
        let args: Vec<String> = args.iter().map(|&arg| arg.to_owned()).collect();
        let ran = spawn_blocking(move || {
            let args: Vec<&str> = args.iter().map(String::as_str).collect();
            run("mom", &args, &environment(&hub))
        });
        let output = ran.await.expect("it runs");
        Said {
            code: output.status.code(),
            out: text(&output.stdout),
            words: text(&output.stderr),
        }
    }

    /// What `mom snap` tells of an image of camera x.
    async fn snap(&self, folder: &tempfile::TempDir) -> Json {
        let file = folder.path().join("snap");
        let file = file.to_str().expect("text");
        let said = self.bob(&["snap", "x", "--json", "--output", file]).await;
        serde_json::from_str(&said.out).unwrap_or_else(|error| panic!("{error}: {} {}", said.out, said.words))
    }

    async fn end(self) {
        self.program.signal("INT");
        let ended = spawn_blocking(move || self.program.wait());
        assert_eq!(ended.await.expect("waited for").code(), Some(0));
    }
}

fn environment(hub: &str) -> [(&str, &str); 3] {
    [("MOM_HUB", hub), ("MOM_USER", "bob"), ("MOM_PASSWORD", "bob")]
}

/// The pixel of a point by an image's matrix.
fn pixel(image: &Json, point: [f64; 3]) -> [f64; 2] {
    let numbers: Vec<f64> = image["matrix"]
        .as_array()
        .expect("a matrix")
        .iter()
        .map(|number| number.as_f64().expect("a number"))
        .collect();
    assert_eq!(numbers.len(), 12);
    let row = |i: usize| {
        let row = &numbers[4 * i..4 * i + 4];
        row[0] * point[0] + row[1] * point[1] + row[2] * point[2] + row[3]
    };
    [row(0) / row(2), row(1) / row(2)]
}

/// The root of the mean squared distance of two images' matrices where the marker moves, pixels.
fn apart(a: &Json, b: &Json) -> f64 {
    let steps = || [-1.0, 0.0, 1.0].into_iter();
    let points = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])));
    let squares = points.map(|[x, y, z]| {
        let point = [200.0 * x, 200.0 * y, 250.0 + 150.0 * z];
        let ([a, b], [c, d]) = (pixel(a, point), pixel(b, point));
        (a - c).powi(2) + (b - d).powi(2)
    });
    (squares.sum::<f64>() / 27.0).sqrt()
}

/// The next message of this name.
async fn message(events: &mut Events, name: &str) -> Parcel {
    let wanted = async {
        loop {
            match events.next().await.expect("the client lives") {
                Event::Message(parcel) if parcel.name() == name => return parcel,
                _ => {}
            }
        }
    };
    timeout(PATIENCE, wanted).await.expect("it comes")
}

#[tokio::test(flavor = "multi_thread")]
async fn the_measured_matrix_is_the_one_in_use() {
    let lab = Lab::start().await;
    let folder = tempfile::tempdir().expect("a folder");
    let nominal = lab.snap(&folder).await;
    assert_eq!(nominal.get("calibrated"), None);

    let file = folder.path().join("residuals.svg");
    let drawn = file.to_str().expect("text");
    let said = lab
        .bob(&["calibrate", "x", "--poses", "8", "--json", "-o", drawn])
        .await;
    assert_eq!(said.code, Some(0), "{}", said.words);
    let lines: Vec<Json> = said
        .out
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    let (end, poses) = lines.split_last().expect("lines");
    assert_eq!(poses.len(), 8);
    assert_eq!(
        (
            &poses[6]["pose"],
            &poses[6]["of"],
            poses[6]["marker"].as_array().map(Vec::len)
        ),
        (&json!(7), &json!(8), Some(2))
    );
    assert_eq!((&end["used"], &end["camera"]), (&json!(8), &json!("/camera/x")));
    assert!(end["rms"].as_f64().expect("a number") < 0.2, "{end}");
    let svg = std::fs::read_to_string(&file).expect("it is drawn");
    assert_eq!(svg.matches("<circle").count(), 8, "{svg}");

    let measured = lab.snap(&folder).await;
    let calibrated = &measured["calibrated"];
    assert_eq!(
        (&calibrated["poses"], &calibrated["by"]),
        (&json!(8), &json!("bob"))
    );
    assert!(
        calibrated["time"].is_string() && calibrated["rms"] == end["rms"],
        "{calibrated}"
    );
    assert!(
        apart(&measured, end) < 1e-9,
        "not scaled, as the size is the same"
    );
    let off = apart(&nominal, &measured);
    assert!(off < 1.0, "{off} pixels from the view's own");
    assert!(off > 1e-6, "it is measured, and no copy");

    // All is as it was: the arm at home, the camera's settings, the token.
    assert_eq!(
        measured["pose"],
        json!({"x": 0.0, "y": 0.0, "z": 300.0, "spin": 0.0, "tilt": 0.0})
    );
    let settings = lab.bob(&["camera", "x", "--size", "320x240"]).await;
    assert_eq!(settings.out.trim_end(), "/camera/x  320x240, quality 80, jpeg");
    // At another size the matrix is scaled as the image is.
    let (small, point) = (lab.snap(&folder).await, [100.0, -50.0, 200.0]);
    let ([u, v], [x, y]) = (pixel(&small, point), pixel(&measured, point));
    assert!(
        (2.0 * u - x).abs() < 1e-6 && (2.0 * v - y).abs() < 1e-6,
        "{u} {v} of {x} {y}"
    );
    lab.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn nobody_but_the_owner_of_the_token_calibrates() {
    let lab = Lab::start().await;
    let carol = lab.join("carol").await;
    let token = carol.token("/robot/token").await.expect("operators may");

    // The wrist's camera is refused before anything moves or is grabbed.
    let fence = token.status().await.expect("told").fence;
    let said = lab.bob(&["calibrate", "wrist"]).await;
    assert_eq!((said.code, said.out.as_str()), (Some(1), ""));
    assert!(said.words.contains("moves with the arm"), "{}", said.words);
    assert_eq!(
        token.status().await.expect("told").fence,
        fence,
        "nobody grabbed it"
    );

    // Another peer owns the token: neither the command nor the message itself does anything.
    let guard = token.grab().await.expect("it is free");
    let said = lab.bob(&["calibrate", "x"]).await;
    assert_eq!((said.code, said.out.as_str()), (Some(1), ""));
    assert!(said.words.contains("carol"), "{}", said.words);
    let bob = lab.join("bob").await;
    let camera = bob.channel("/camera/x").await.expect("people may");
    let mut events = camera.events();
    let asked = camera
        .message("calibration")
        .content(Value::from("any"))
        .send()
        .await;
    asked.expect("sent");
    let refused = message(&mut events, "calibration-refused").await.value();
    assert_eq!(refused.get("name").and_then(Value::as_str), Some("not-owner"));
    assert_eq!(refused.get("owner").and_then(Value::as_str), Some("carol"));
    // Only the camera says what the matrix is.
    let mut forged = Parcel::new(Family::Message, "calibration-changed").context(camera.path().clone());
    forged.receipt = Some(true);
    assert!(bob.request(forged).await.is_err(), "the hub refuses it");
    guard.release().await.expect("it is hers");
    lab.end().await;
}

/// A person asks, lends the token, and follows: what the console does.
#[tokio::test(flavor = "multi_thread")]
async fn an_agent_calibrates_for_whoever_lends_it_the_token() {
    let lab = Lab::start().await;
    let bob = lab.join("bob").await;
    let (alice, folder) = (lab.join("alice").await, tempfile::tempdir().expect("a folder"));
    let channel = bob.channel("/calibrate").await.expect("people may");
    let others = alice.channel("/calibrate").await.expect("people may");
    let (mut events, mut seen_by_alice) = (channel.events(), others.events());
    let word = |parcel: &Parcel, key: &str| {
        let value = parcel.value();
        value
            .get(key)
            .and_then(Value::as_str)
            .unwrap_or_default()
            .to_owned()
    };
    let ask = async |by: &Channel, camera: &str| {
        let content = Map::new().with("camera", camera).with("poses", 8);
        let asked = by.message("calibrate").content(Value::from(content)).no_echo();
        asked.send().await.expect("sent");
    };

    // One that moves with the arm has no one matrix, which is said before anything is lent.
    ask(&channel, "wrist").await;
    let refused = message(&mut events, "calibrate-refused").await;
    assert!(
        word(&refused, "text").contains("moves with the arm"),
        "{refused:?}"
    );

    ask(&channel, "x").await;
    let accepted = message(&mut events, "progress").await;
    assert_eq!(word(&accepted, "state"), "accepted");
    // It has one task at a time.
    ask(&others, "top").await;
    let refused = message(&mut seen_by_alice, "calibrate-refused").await;
    assert!(word(&refused, "text").contains("bob"), "{refused:?}");
    let token = bob.token("/robot/token").await.expect("people may");
    let guard = token.grab().await.expect("it is free");
    let agent = word(&accepted, "agent");
    let given = guard.give(agent.as_str()).time(Duration::from_secs(120));
    let given = given.await.expect("the agent is there");
    let mut poses = 0;
    let last = loop {
        let told = message(&mut events, "progress").await;
        match word(&told, "state").as_str() {
            "working" => poses += 1,
            _ => break told,
        }
    };
    assert_eq!((word(&last, "state").as_str(), poses), ("done", 8), "{last:?}");
    let back = timeout(PATIENCE, given.returned()).await;
    back.expect("the token returns").expect("to bob");
    let calibrated = &lab.snap(&folder).await["calibrated"];
    assert_eq!(calibrated["by"], json!("calibrate"), "{calibrated}");

    // Who does not lend it, or wants no more, ends the task.
    ask(&channel, "y").await;
    let accepted = message(&mut events, "progress").await;
    assert_eq!(word(&accepted, "state"), "accepted");
    channel.message("cancel").no_echo().send().await.expect("sent");
    let last = message(&mut events, "progress").await;
    assert_eq!(word(&last, "state"), "cancelled", "{last:?}");
    lab.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_loses_the_token_tells_the_camera_nothing() {
    let lab = Lab::start().await;
    let carol = lab.join("carol").await;
    let token = carol.token("/robot/token").await.expect("operators may");
    let folder = tempfile::tempdir().expect("a folder");
    let start = |hub: String| {
        spawn_blocking(move || {
            let program = Running::start("mom", &["calibrate", "x"], &environment(&hub));
            program.line_with("[ 1/20] pose");
            program
        })
    };

    // At Ctrl-C all is given back.
    let program = start(lab.hub.clone()).await.expect("it runs");
    let set = lab.bob(&["camera", "x"]).await;
    assert_eq!(set.out.trim_end(), "/camera/x  640x480, quality 80, png");
    program.signal("INT");
    let ended = spawn_blocking(move || program.wait()).await.expect("waited for");
    assert_eq!(ended.code(), Some(1));
    assert_eq!(token.status().await.expect("told").owner, None, "it is released");
    let set = lab.bob(&["camera", "x"]).await;
    assert_eq!(set.out.trim_end(), "/camera/x  640x480, quality 80, jpeg");

    // Carol has the higher level and takes it at once.
    let program = start(lab.hub.clone()).await.expect("it runs");
    let guard = token.grab().await.expect("hers is the higher level");
    let ended = spawn_blocking(move || program.wait());
    let ended = timeout(Duration::from_secs(20), ended).await.expect("at once");
    assert_eq!(ended.expect("waited for").code(), Some(1));
    assert_eq!(lab.snap(&folder).await.get("calibrated"), None);
    guard.release().await.expect("it is hers");
    lab.end().await;
}

/// A camera as a program of its own, at a broker of its own; it ends and is started again.
#[tokio::test(flavor = "multi_thread")]
async fn a_camera_with_a_file_keeps_its_matrix_over_restarts() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("x.json").to_str().expect("text").to_owned();
    let started = spawn_blocking(|| {
        let (broker, address) = Running::broker(&project().join("config/lab.toml"));
        (format!("bin://{address}"), broker)
    });
    let (hub, broker) = started.await.expect("it starts");
    let camera = || {
        let (hub, file) = (hub.clone(), file.clone());
        spawn_blocking(move || {
            let args = ["--hub", &hub, "--calibration", &file];
            Running::start("mom-camera", &args, &[("MOM_PASSWORD", "camera")])
        })
    };
    let bob = Client::builder(hub.as_str()).user("bob").password("bob");
    let bob = bob.connect().await.expect("the lab knows its users");
    let channel = bob.channel("/camera/x").await.expect("people may");
    let mut events = channel.events();
    let program = camera().await.expect("it runs");
    let first = first_image(&channel, &mut events).await;
    assert_eq!(first.get("calibrated"), None);

    let guard = bob.token("/robot/token").await.expect("people may").grab().await;
    let guard = guard.expect("it is free");
    let content = Map::new()
        .with("matrix", first.get("matrix").cloned().expect("a matrix"))
        .with("width", 640)
        .with("height", 480)
        .with("rms", Value::Double(0.5))
        .with("poses", 9);
    channel.send("calibration", content).await.expect("sent");
    message(&mut events, "calibration-changed").await;
    guard.release().await.expect("it is his");
    program.signal("TERM");
    let ended = spawn_blocking(move || program.wait()).await.expect("waited for");
    assert_eq!(ended.code(), Some(0));

    let program = camera().await.expect("it runs");
    let again = first_image(&channel, &mut events).await;
    let kept = again.get("calibrated").expect("it is kept");
    assert_eq!(kept.get("by").and_then(Value::as_str), Some("bob"));
    assert_eq!(kept.get("poses").and_then(Value::as_int), Some(9));
    drop((program, broker));
}

/// The image that a camera sends when it is asked, as soon as it is there.
async fn first_image(channel: &Channel, events: &mut Events) -> Value {
    let wanted = async {
        loop {
            channel
                .message("request")
                .no_echo()
                .send()
                .await
                .expect("people may");
            if let Ok(parcel) = timeout(Duration::from_millis(200), message(events, "image")).await {
                return parcel.value();
            }
        }
    };
    timeout(PATIENCE, wanted).await.expect("a camera is there")
}
