//! The server between drawn images and what it tells.

use mom_camera::{CameraSettings, Colour, DrawnBlock, Renderer, Scene, View};
use mom_client::Member;

use super::*;
use crate::ModelOptions;

const VIEWS: [View; 3] = [View::X, View::Y, View::Top];

fn at(seconds: f64) -> Time {
    Time::from_micros(1_000_000_000 + (seconds * 1e6) as i64).unwrap()
}

struct Bench {
    server: ModelServer,
    renderers: Vec<Renderer>,
    state: i64,
    out: Vec<Parcel>,
}

fn path(text: &str) -> Path {
    Path::parse(text).unwrap()
}

fn block(name: &str, x: f64, y: f64, z: f64) -> DrawnBlock {
    let kinds = ModelOptions::default().kinds;
    let colour = kinds.iter().find(|kind| kind.name == name).unwrap().colour;
    DrawnBlock {
        name: name.to_owned(),
        x,
        y,
        z,
        colour: Colour(colour),
        ..DrawnBlock::default()
    }
}

impl Bench {
    fn new() -> Bench {
        let lab = ModelOptions::default();
        let options = ServerOptions {
            channel: path(&lab.channel),
            token: path(&lab.token),
            cameras: lab.cameras.iter().map(|camera| path(camera)).collect(),
            kinds: lab.kinds,
        };
        let mut bench = Bench {
            server: ModelServer::new(options, at(0.0)),
            renderers: VIEWS
                .map(|view| Renderer::new(view, CameraSettings::default()).unwrap())
                .to_vec(),
            state: 0,
            out: Vec::new(),
        };
        bench.server.advance(at(0.0), &mut bench.out);
        bench.out.clear();
        bench
    }

    /// All cameras show these blocks; the new messages.
    fn show(&mut self, seconds: f64, blocks: &[DrawnBlock]) -> Vec<Parcel> {
        self.state += 1;
        (0..3)
            .flat_map(|camera| self.show_to(camera, seconds, blocks))
            .collect()
    }

    fn show_to(&mut self, camera: usize, seconds: f64, blocks: &[DrawnBlock]) -> Vec<Parcel> {
        let scene = Scene {
            blocks: blocks.to_vec(),
            ..Scene::default()
        };
        let image = self.renderers[camera].render(&scene);
        let matrix: Vec<Value> = image.matrix.into_iter().map(Value::Double).collect();
        let content = Map::new()
            .with("image", Value::Binary(image.bytes.into()))
            .with("matrix", matrix)
            .with("taken", at(seconds))
            .with("state-seq", self.state);
        let mut parcel = Parcel::new(Family::Message, "image").content(content);
        parcel.sender = Some("camera".into());
        let event = Event::Message(parcel);
        let image = self
            .server
            .handle_camera(camera, &event, at(seconds))
            .expect("an image");
        let look = image.look(&self.server.wanted()).expect("it can be read");
        self.server.handle_look(camera, look, at(seconds), &mut self.out);
        std::mem::take(&mut self.out)
    }

    fn say(&mut self, seconds: f64, from: &str, name: &str, content: Map) -> Vec<Parcel> {
        let mut parcel = Parcel::new(Family::Message, name).content(content);
        (parcel.sender, parcel.id) = (Some(from.into()), Some(7));
        self.server
            .handle_model(&Event::Message(parcel), at(seconds), &mut self.out);
        if self.server.ask_users() {
            let users = [("alice", "alice"), ("alice~2", "alice"), ("bob", "bob")];
            let users = users.map(|(peer, user)| (peer.to_owned(), user.to_owned()));
            self.server
                .handle_users(&BTreeMap::from(users), at(seconds), &mut self.out);
        }
        std::mem::take(&mut self.out)
    }

    fn grab(&mut self, token: &str, owner: &str) {
        let token = path(token);
        let event = Event::Grabbed {
            owner: owner.to_owned(),
            level: 1,
            fence: 3,
            lease: None,
            path: token.clone(),
        };
        self.server.handle_token(&token, &event);
    }

    fn holds(&mut self, seconds: f64, holding: Option<&str>) -> Vec<Parcel> {
        let mut content = Map::new().with("seq", 1);
        if let Some(name) = holding {
            content.set("holding", name);
        }
        let parcel = Parcel::new(Family::Message, "state").content(content);
        self.server
            .handle_robot(&Event::Message(parcel), at(seconds), &mut self.out);
        std::mem::take(&mut self.out)
    }
}

fn names(parcels: &[Parcel]) -> Vec<&str> {
    parcels.iter().map(Parcel::name).collect()
}

fn error_of(parcels: &[Parcel]) -> (String, String) {
    let content = parcels[0].value();
    let word = |key: &str| {
        content
            .get(key)
            .and_then(Value::as_str)
            .unwrap_or_default()
            .to_owned()
    };
    (word("name"), word("text"))
}

fn lab() -> Vec<DrawnBlock> {
    vec![
        block("red", -150.0, 100.0, 20.0),
        block("green", 0.0, -150.0, 20.0),
        block("blue", 150.0, 100.0, 20.0),
    ]
}

#[test]
fn what_is_seen_is_told_to_all_and_then_only_what_differs() {
    let mut bench = Bench::new();
    let told = bench.show(1.0, &lab());
    assert!(names(&told).iter().all(|name| *name == CHANGED) && !told.is_empty());
    // A follower has what the server has.
    let mut follower = Objects::default();
    told.iter().for_each(|parcel| follower.apply(&parcel.value()));
    assert_eq!(follower.len(), 3);
    let red = follower.get("red").unwrap();
    assert!(
        (red.x + 150.0).abs() < 1.5 && (red.y - 100.0).abs() < 1.5 && (red.z - 20.0).abs() < 1.5,
        "{red:?}"
    );
    assert!(
        red.error < 1.0 && red.cameras.len() >= 2 && red.seen == Some(at(1.0)),
        "{red:?}"
    );

    assert_eq!(
        names(&bench.show(1.4, &lab())),
        [] as [&str; 0],
        "nothing new within a second"
    );
    let told = bench.show(2.5, &lab());
    let seen = told.last().unwrap().value();
    let first = seen.get("objects").and_then(Value::as_list).unwrap()[0]
        .as_map()
        .unwrap()
        .clone();
    assert_eq!(first.keys().collect::<Vec<_>>(), ["name", "seen"], "{first:?}");

    let mut moved = lab();
    moved[0].x = 0.0;
    let told = bench.show(2.6, &moved);
    for parcel in &told {
        let content = parcel.value();
        let list = content.get("objects").and_then(Value::as_list).unwrap();
        assert!(
            list.iter()
                .all(|change| change.get("name").and_then(Value::as_str) == Some("red")),
            "{content:?}"
        );
        assert!(
            list.iter().all(|change| change.get("size").is_none()),
            "{content:?}"
        );
    }
    told.iter().for_each(|parcel| follower.apply(&parcel.value()));
    assert!(follower.get("red").unwrap().x.abs() < 1.5, "{follower:?}");
}

#[test]
fn numbers_of_changes_have_no_gaps_and_who_joins_late_has_the_newest() {
    let mut bench = Bench::new();
    let mut told = bench.show(1.0, &lab());
    told.extend(bench.show(3.0, &lab()));
    let seqs: Vec<i64> = told
        .iter()
        .map(|parcel| parcel.value().get("seq").and_then(Value::as_int).unwrap())
        .collect();
    let start = at(0.0).micros() / 1000;
    assert_eq!(
        seqs,
        (start + 1..=start + seqs.len() as i64).collect::<Vec<_>>(),
        "one that starts again goes on behind them"
    );
    let member = Member {
        peer: "bob~2".into(),
        user: "bob".into(),
        level: 1,
        device: false,
    };
    bench
        .server
        .handle_model(&Event::Joined(member), at(3.5), &mut bench.out);
    let [snapshot] = &bench.out[..] else {
        panic!("{:?}", bench.out)
    };
    assert_eq!(snapshot.address.as_deref(), Some(&["bob~2".into()][..]));
    let content = snapshot.value();
    assert_eq!(content.get("seq").and_then(Value::as_int), seqs.last().copied());
    assert_eq!(Objects::of(&content).len(), 3);
    assert_eq!(Objects::of(&content).get("red").unwrap().age, Some(500));
}

#[test]
fn stacks_and_what_is_held() {
    let mut bench = Bench::new();
    let mut blocks = lab();
    blocks[0] = block("red", 150.0, 103.0, 60.0);
    bench.show(1.0, &blocks);
    let objects = bench.server.objects().clone();
    let (red, blue) = (objects.get("red").unwrap(), objects.get("blue").unwrap());
    assert!(
        (red.z - 60.0).abs() < 3.0 && (blue.z - 20.0).abs() < 3.0,
        "{red:?} {blue:?}"
    );
    assert_eq!(objects.under(red), Some(blue));
    assert_eq!(objects.upon(blue), Some(red));
    assert_eq!((objects.level(red), objects.level(blue)), (60.0, 20.0));
    let told = bench.holds(1.1, Some("red"));
    assert_eq!(names(&told), [CHANGED]);
    assert!(bench.server.objects().get("red").unwrap().held);
    assert_eq!(names(&bench.holds(1.2, Some("red"))), [] as [&str; 0]);
    assert_eq!(names(&bench.holds(1.3, None)), [CHANGED]);
}

/// The cameras at rest say nothing, and are asked once a second, each alone.
#[test]
fn quiet_cameras_are_asked() {
    let mut bench = Bench::new();
    bench.server.advance(at(0.5), &mut bench.out);
    assert_eq!(bench.out, [], "they were asked at the start");
    bench.show(1.0, &lab());
    bench.server.advance(at(1.6), &mut bench.out);
    assert!(bench.out.iter().all(|parcel| parcel.name() != REQUEST));
    bench.out.clear();
    bench.server.advance(at(2.1), &mut bench.out);
    let asked: Vec<_> = bench
        .out
        .iter()
        .filter(|parcel| parcel.name() == REQUEST)
        .collect();
    assert_eq!(asked.len(), 3);
    assert!(
        asked
            .iter()
            .all(|parcel| parcel.address.as_deref() == Some(&["camera".into()][..]))
    );
    bench.out.clear();
    bench
        .server
        .handle_model(&Event::LinkDown, at(9.0), &mut bench.out);
    bench.server.advance(at(20.0), &mut bench.out);
    assert_eq!(bench.out, []);
}

#[test]
fn questions() {
    let mut bench = Bench::new();
    bench.show(1.0, &lab());
    let answer = bench.say(1.5, "bob", QUERY, Map::new());
    assert_eq!((answer[0].name(), answer[0].reference), (OBJECTS, Some(7)));
    assert_eq!(answer[0].value().get("by").and_then(Value::as_str), Some("bob"));
    assert_eq!(Objects::of(&answer[0].value()).len(), 3);
    let near = Map::new().with("near", vec![Value::Int(140), Value::Int(90)]);
    let answer = bench.say(1.5, "bob", QUERY, near)[0].value();
    let first = answer.get("objects").and_then(Value::as_list).unwrap()[0].clone();
    assert_eq!(Object::of(&first).unwrap().name, "blue");
    let fresh = Map::new().with("max-age", 2000);
    assert_eq!(
        Objects::of(&bench.say(2.5, "bob", QUERY, fresh.clone())[0].value()).len(),
        3
    );
    assert_eq!(
        Objects::of(&bench.say(9.5, "bob", QUERY, fresh.clone())[0].value()).len(),
        0
    );

    let old = bench.say(9.5, "bob", QUERY, fresh.with("name", "red"));
    assert_eq!(old[0].name(), QUERY_REFUSED);
    let (code, text) = error_of(&old);
    assert_eq!(code, "expired");
    assert!(
        text.contains("no camera has seen red for 8.5 s; nearest to where it was is"),
        "{text}"
    );
    let (code, text) = error_of(&bench.say(1.5, "bob", QUERY, Map::new().with("name", "gren")));
    assert_eq!(code, "bad-content");
    assert!(text.contains("did you mean green (seen 0.5 s ago)"), "{text}");
    for bad in [
        Map::new().with("name", "r".repeat(65)),
        Map::new().with("name", 7),
        Map::new().with("near", "here"),
        Map::new().with("near", vec![Value::Int(1)]),
        Map::new().with("max-age", -1),
    ] {
        assert_eq!(bench.say(1.5, "bob", QUERY, bad)[0].name(), QUERY_REFUSED);
    }
}

#[test]
fn owners_write_and_others_are_told_who_may() {
    let mut bench = Bench::new();
    bench.show(1.0, &lab());
    let red = |x: f64| {
        Map::new()
            .with("name", "red")
            .with("x", Value::Double(x))
            .with("y", 0)
    };
    bench.grab("/robot/token", "alice");
    bench
        .server
        .handle_token_info(&path("/model/red"), &Map::new().with("fence", 0));
    let refused = bench.say(2.0, "bob", WRITE, red(10.0));
    assert_eq!(
        (refused.len(), refused[0].name(), refused[0].reference),
        (1, WRITE_REFUSED, Some(7))
    );
    let (code, text) = error_of(&refused);
    assert_eq!(code, "not-owner");
    assert!(
        text.contains("/robot/token is alice's, /model/red is free"),
        "{text}"
    );

    let written = bench.say(2.0, "alice", WRITE, red(10.0));
    assert_eq!(names(&written), [OBJECTS, CHANGED]);
    let known = bench.server.objects().get("red").unwrap().clone();
    assert_eq!(
        (known.x, known.written_by.as_deref(), known.seen),
        (10.0, Some("alice"), None)
    );
    let written = bench.say(2.0, "alice~2", WRITE, red(10.0));
    assert_eq!(names(&written), [OBJECTS, CHANGED], "it is alice's other program");
    let known = bench.server.objects().get("red").unwrap();
    assert_eq!(known.written_by.as_deref(), Some("alice~2"));
    // An image that was taken before says nothing about it, and a later one does.
    bench.state += 1;
    bench.show_to(0, 1.9, &lab());
    assert_eq!(bench.server.objects().get("red").unwrap().x, 10.0);
    bench.show(2.5, &lab());
    let known = bench.server.objects().get("red").unwrap();
    assert!(
        (known.x + 150.0).abs() < 1.5 && known.written_by.is_none(),
        "{known:?}"
    );

    // The owner of one object's own token writes that one.
    bench.grab("/model/red", "bob");
    assert_eq!(bench.say(3.0, "bob", WRITE, red(20.0))[0].name(), OBJECTS);
    let green = Map::new().with("name", "green").with("x", 1);
    assert_eq!(bench.say(3.0, "bob", WRITE, green)[0].name(), WRITE_REFUSED);
    // What the jaws hold, nobody moves by writing.
    bench.holds(3.1, Some("red"));
    assert_eq!(error_of(&bench.say(3.2, "alice", WRITE, red(30.0))).0, "held");
    let remove = |name: &str| Map::new().with("name", name).with("remove", true);
    assert_eq!(error_of(&bench.say(3.2, "alice", WRITE, remove("red"))).0, "held");
    let gone = bench.say(3.3, "alice", WRITE, remove("blue"));
    assert_eq!(names(&gone), [OBJECTS, CHANGED]);
    assert_eq!(
        gone[1].value().get("gone"),
        Some(&vec![Value::from("blue")].into())
    );
}

#[test]
fn nonsense_is_not_written() {
    let mut bench = Bench::new();
    bench.grab("/robot/token", "alice");
    let new = || Map::new().with("name", "cup").with("x", 5).with("y", 6);
    for (content, words) in [
        (new().with("name", ""), "name must be 1 to 40"),
        (new().with("name", "a/b"), "name must be 1 to 40"),
        (new().with("x", "far"), "x must be a number"),
        (new().with("z", 1e9 as i64), "z must be a number"),
        (new().with("size", 0), "size must be a number"),
        (new().with("colour", "red"), "colour is"),
        (new().with("remove", 1), "remove is true or false"),
        (new().with("wheels", 4), "no \"wheels\""),
        (
            new().with("name", "red").with("size", 50),
            "red is looked for as a block of 40 mm",
        ),
        (
            new()
                .with("name", "red")
                .with("colour", vec![Value::Int(1), Value::Int(2), Value::Int(3)]),
            "of the colour [200, 40, 40]",
        ),
        (Map::new().with("name", "cup").with("x", 1), "needs x and y"),
        (
            Map::new().with("name", "cup").with("remove", true),
            "no object \"cup\"",
        ),
    ] {
        let (code, text) = error_of(&bench.say(1.0, "alice", WRITE, content));
        assert_eq!(code, "bad-content", "{text}");
        assert!(text.contains(words), "{words:?} in {text:?}");
    }
    assert!(bench.server.objects().is_empty());
    for i in 0..64 {
        let content = new().with("name", format!("cup-{i}"));
        assert_eq!(bench.say(1.0, "alice", WRITE, content)[0].name(), OBJECTS);
    }
    assert_eq!(error_of(&bench.say(1.0, "alice", WRITE, new())).0, "full");
}

/// One camera is enough for what lies on the table, once it is clear that there is no other.
#[test]
fn a_camera_that_is_alone_takes_blocks_for_lying_on_the_table() {
    let mut bench = Bench::new();
    bench.show_to(2, 1.0, &lab());
    assert!(bench.server.objects().is_empty());
    bench.show_to(2, 5.0, &lab());
    let blue = bench.server.objects().get("blue").unwrap();
    assert!((blue.x - 150.0).abs() < 1.5 && blue.error >= 2.0, "{blue:?}");
}

/// What it saw of a tower together with others, it does not take for lying on the table.
#[test]
fn a_camera_that_is_alone_keeps_the_heights_that_it_still_sees() {
    let mut bench = Bench::new();
    let mut blocks = lab();
    blocks[0] = block("red", 150.0, 100.0, 60.0);
    bench.show(1.0, &blocks);
    bench.show_to(2, 8.0, &blocks);
    let red = bench.server.objects().get("red").unwrap();
    assert!((red.z - 60.0).abs() < 3.0 && red.seen == Some(at(8.0)), "{red:?}");
    blocks[0] = block("red", -100.0, 50.0, 20.0);
    bench.show_to(2, 9.0, &blocks);
    let red = bench.server.objects().get("red").unwrap();
    assert!(
        (red.x + 100.0).abs() < 1.5 && (red.z - 20.0).abs() < 0.5,
        "{red:?}"
    );
}

/// A block may move without the robot, whose state is then the same.
#[test]
fn images_from_far_apart_are_not_fused() {
    let mut bench = Bench::new();
    bench.show_to(0, 1.0, &lab());
    bench.show_to(1, 4.5, &lab());
    assert!(bench.server.objects().is_empty());
    bench.show_to(0, 5.0, &lab());
    assert!(!bench.server.objects().is_empty());
}

#[test]
fn an_image_from_the_future_is_not_looked_at() {
    let mut bench = Bench::new();
    let image = bench.renderers[0].render(&Scene::default());
    let matrix: Vec<Value> = image.matrix.into_iter().map(Value::Double).collect();
    let content = Map::new()
        .with("image", Value::Binary(image.bytes.into()))
        .with("matrix", matrix)
        .with("taken", at(5.0));
    let event = Event::Message(Parcel::new(Family::Message, "image").content(content));
    assert!(bench.server.handle_camera(0, &event, at(3.9)).is_none());
    assert!(bench.server.handle_camera(0, &event, at(4.1)).is_some());
}

/// The hub is asked once for all that wait, and what it does not tell gives no right.
#[test]
fn whose_a_write_is_is_asked_for_all_that_wait() {
    let mut bench = Bench::new();
    bench.grab("/robot/token", "alice");
    let hear = |server: &mut ModelServer, sender: &str| {
        let cup = Map::new().with("name", "cup").with("x", 1).with("y", 2);
        let mut parcel = Parcel::new(Family::Message, WRITE).content(cup);
        parcel.sender = Some(sender.into());
        let mut out = Vec::new();
        server.handle_model(&Event::Message(parcel), at(1.0), &mut out);
        out
    };
    let server = &mut bench.server;
    assert!(hear(server, "alice~2").is_empty() && server.ask_users());
    for _ in 0..16 {
        assert!(hear(server, "bob").is_empty() && !server.ask_users());
    }
    assert_eq!(error_of(&hear(server, "bob")).0, "try-later");
    let mut out = Vec::new();
    server.handle_users(&BTreeMap::new(), at(1.0), &mut out);
    assert_eq!(error_of(&out).0, "not-owner");
    assert!(server.ask_users());
    let guests = ["alice", "bob"].map(|peer| (peer.to_owned(), "guest".to_owned()));
    out.clear();
    server.handle_users(&BTreeMap::from(guests), at(1.0), &mut out);
    assert_eq!((out.len(), error_of(&out).0.as_str()), (16, "not-owner"));
    assert!(server.objects().is_empty() && !server.ask_users());
}
