//! Dialogues with the image server: what it sees and who says what, and what it draws and says.

use std::collections::BTreeMap;

use super::*;
use crate::DrawnPose;

const MS: CameraTime = 1000;

/// The server with a clock and a thread that draws when it is told to.
pub(super) struct Stage {
    pub(super) server: ImageServer,
    pub(super) now: CameraTime,
    pub(super) shot: Option<Shot>,
    pub(super) out: Vec<Parcel>,
}

impl Stage {
    pub(super) fn new(view: View) -> Self {
        let options = ServerOptions {
            view,
            channel: Path::parse("/camera/x").unwrap(),
            token: Path::parse("/robot/token").unwrap(),
            settings: small(),
            period: 100 * MS,
            trail: 3,
        };
        Self {
            server: ImageServer::new(options).unwrap(),
            now: 0,
            shot: None,
            out: Vec::new(),
        }
    }

    /// Does one line of a dialogue, and what the driver does after it; gives what happened.
    pub(super) fn act(&mut self, line: &str) -> Vec<String> {
        let (line, settings) = line.split_once(": ").unwrap_or((line, ""));
        let words: Vec<&str> = line.split(' ').collect();
        match words[..] {
            ["after", ms] => self.now += ms.parse::<CameraTime>().unwrap() * MS,
            ["drawn"] => {
                let picture = self.shot.take().expect("something is being drawn").take();
                self.server.handle_picture(picture, &mut self.out);
            }
            ["failed"] => {
                self.shot = None;
                self.server.handle_failure();
            }
            ["state", seq] => self.server.handle_robot(&state(seq.parse().unwrap())),
            ["status"] => self
                .server
                .handle_robot(&Event::Message(Parcel::new(Family::Message, "status"))),
            ["down"] => self.server.handle_token(&Event::LinkDown),
            ["info", owner, fence] => {
                let mut info = Map::new().with("fence", fence.parse::<i64>().unwrap());
                if owner != "-" {
                    info.set("owner", owner);
                }
                self.server.handle_token_info(&info);
            }
            ["grabbed", owner, fence] => self.server.handle_token(&Event::Grabbed {
                owner: owner.to_owned(),
                level: 1,
                fence: fence.parse().unwrap(),
                lease: None,
                path: Path::parse("/robot/token").unwrap(),
            }),
            ["released", fence] => self.server.handle_token(&Event::Released {
                owner: "somebody".to_owned(),
                reason: "expired".to_owned(),
                by: None,
                fence: fence.parse().unwrap(),
                path: Path::parse("/robot/token").unwrap(),
            }),
            [sender, name, id] => {
                let mut parcel = Parcel::new(Family::Message, name).content(map_of(settings));
                (parcel.sender, parcel.id) = (Some(sender.into()), id.parse().ok());
                self.server.handle_camera(&Event::Message(parcel), &mut self.out);
            }
            _ => panic!("no such line: {line}"),
        }
        if self.server.ask_users() {
            self.server.handle_users(&users(), &mut self.out);
        }
        let wall = Time::from_micros(self.now).unwrap();
        let shot = self.server.advance(self.now, wall, &mut self.out);
        let mut happened: Vec<String> = self.out.drain(..).map(|parcel| line_of(&parcel)).collect();
        if let Some(shot) = shot {
            assert!(self.shot.is_none(), "one at a time");
            happened.push(format!("draws {}", seq_word(shot.state_seq)));
            self.shot = Some(shot);
        }
        happened
    }
}

/// Whose the peers are; alice and the guests have several.
fn users() -> BTreeMap<String, String> {
    let users = [
        ("alice", "alice"),
        ("alice~2", "alice"),
        ("bob", "bob"),
        ("anna", "guest"),
        ("anna~2", "guest"),
    ];
    users
        .map(|(peer, user)| (peer.to_owned(), user.to_owned()))
        .into()
}

fn small() -> CameraSettings {
    CameraSettings {
        width: 64,
        height: 48,
        ..CameraSettings::default()
    }
}

/// A state of the robot whose pose is 10 mm × seq to the right, sent at so many seconds.
fn state(seq: i64) -> Event {
    let pose = Map::new().with("x", Value::Double(10.0 * seq as f64));
    let content = Map::new().with("seq", seq).with("pose", pose);
    let mut parcel = Parcel::new(Family::Message, STATE).content(content);
    parcel.timestamp = Time::from_micros(1000 * MS * seq);
    Event::Message(parcel)
}

/// `width=64 format=png` as a map.
fn map_of(settings: &str) -> Map {
    let pairs = settings.split(' ').filter_map(|pair| pair.split_once('='));
    pairs.fold(Map::new(), |map, (key, value)| match value.parse::<i64>() {
        Ok(number) => map.with(key, number),
        Err(_) => map.with(key, value),
    })
}

pub(super) fn matrix_of(content: &Value) -> [f64; 12] {
    let matrix = content.get("matrix").and_then(Value::as_list).expect("a matrix");
    let numbers: Vec<f64> = matrix
        .iter()
        .filter_map(|number| match number {
            Value::Double(number) => Some(*number),
            _ => None,
        })
        .collect();
    numbers.try_into().expect("3 rows of 4")
}

fn names_of(content: &Value) -> Vec<&str> {
    let overlays = content.get("overlays").and_then(Value::as_list).expect("a list");
    let names = overlays
        .iter()
        .map(|overlay| overlay.get("name").and_then(Value::as_str));
    names.map(|name| name.expect("a name")).collect()
}

fn seq_word(seq: Option<i64>) -> String {
    seq.map_or("-".to_owned(), |seq| seq.to_string())
}

fn line_of(parcel: &Parcel) -> String {
    assert_eq!(parcel.context.as_ref().unwrap().as_str(), "/camera/x");
    assert_eq!(parcel.echo, Some(false));
    let content = parcel.value();
    let to: String = parcel
        .address
        .iter()
        .flatten()
        .map(|peer| format!(" to {peer}"))
        .collect();
    let reference = parcel
        .reference
        .map(|id| format!(" ref {id}"))
        .unwrap_or_default();
    let int = |key: &str| content.get(key).and_then(Value::as_int);
    let text = |key: &str| content.get(key).and_then(Value::as_str);
    let detail = match parcel.name() {
        IMAGE => {
            assert_eq!(parcel.priority, Some(IMAGE_PRIORITY), "states go before images");
            let latest = parcel.delivery == Some(Delivery::Latest);
            assert_eq!(latest, parcel.address.is_none());
            let taken = match content.get("taken") {
                Some(Value::Time(time)) => time.micros() / MS,
                other => panic!("taken {other:?}"),
            };
            format!("{} at {taken}", seq_word(int("state-seq")))
        }
        SETTINGS_CHANGED | SETTINGS_IN_USE => format!(
            "{} {}x{} {} {}",
            text("by").unwrap_or("-"),
            int("width").unwrap(),
            int("height").unwrap(),
            int("quality").unwrap(),
            text("format").unwrap()
        ),
        _ => {
            assert!(!text("text").unwrap().is_empty());
            let owner = text("owner")
                .map(|owner| format!(" owner {owner}"))
                .unwrap_or_default();
            format!("{} {}{owner}", text("name").unwrap(), int("code").unwrap())
        }
    };
    format!("{}{to}{reference} {detail}", parcel.name())
}

/// Plays a dialogue: lines with `>` are what must have happened since the line before.
fn check(dialogue: &str) {
    let mut stage = Stage::new(View::X);
    let mut lines = dialogue
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty())
        .peekable();
    while let Some(line) = lines.next() {
        let happened = stage.act(line);
        let mut expected = Vec::new();
        while let Some(heard) = lines.next_if(|line| line.starts_with('>')) {
            expected.push(heard.trim_start_matches("> ").to_owned());
        }
        assert_eq!(happened, expected, "after `{line}` in {dialogue}");
    }
}

#[test]
fn every_new_state_is_followed_by_an_image() {
    check(
        "after 5
         state 1
         > draws 1
         drawn
         > image 1 at 5
         after 100
         state 1
         status
         state 2
         > draws 2
         after 7
         drawn
         > image 2 at 105
         after 100
         state 0
         > draws 0",
    );
}

#[test]
fn the_rate_is_kept_and_the_newest_state_wins() {
    check(
        "state 1
         > draws 1
         state 2
         after 200
         state 3
         drawn
         > image 1 at 0
         > draws 3
         after 30
         drawn
         > image 3 at 200
         state 4
         after 30
         state 5
         after 39
         after 1
         > draws 5
         drawn
         > image 5 at 300
         after 100",
    );
}

#[test]
fn the_next_wake_is_when_the_next_image_is_due() {
    let mut stage = Stage::new(View::X);
    assert_eq!(stage.server.next_wake(), None);
    stage.act("after 5");
    stage.act("state 1");
    stage.act("state 2");
    assert_eq!(stage.server.next_wake(), None, "while it draws");
    stage.act("drawn");
    assert_eq!(stage.server.next_wake(), Some(105 * MS));
}

#[test]
fn anyone_may_ask_for_an_image() {
    check(
        "bob request 4
         > draws -
         carol request 9
         drawn
         > image to bob ref 4 - at 0
         > image to carol ref 9 - at 0
         after 20
         bob request -
         > image to bob - at 20",
    );
    // Those who ask need not wait for the period, and do not take the image of it away from the others.
    check(
        "state 1
         > draws 1
         drawn
         > image 1 at 0
         after 10
         state 2
         bob request 1
         > draws 2
         drawn
         > image to bob ref 1 2 at 10
         after 90
         > image 2 at 100
         after 100",
    );
}

#[test]
fn too_many_requests_are_refused() {
    let mut stage = Stage::new(View::X);
    stage.act("bob request 0");
    for id in 1..=MOST_REQUESTS {
        assert!(stage.act(&format!("bob request {id}")).is_empty());
    }
    assert_eq!(
        stage.act("carol request 5"),
        ["request-refused to carol ref 5 try-later 100"]
    );
    assert_eq!(stage.act("drawn").len(), 1 + MOST_REQUESTS);
}

#[test]
fn only_the_owner_of_the_token_changes_the_settings() {
    check(
        "alice settings 1: width=320
         > settings-refused to alice ref 1 not-owner 204
         info - 4
         grabbed alice 5
         bob settings 2: width=320
         > settings-refused to bob ref 2 not-owner 204 owner alice
         alice settings 3: quality=30 format=png
         > settings-changed ref 3 alice 64x48 30 png
         > draws -
         released 5
         alice settings 4: quality=40
         > settings-refused to alice ref 4 not-owner 204
         info bob 6
         grabbed alice 5
         released 5
         bob settings 5: quality=30
         > settings-changed ref 5 bob 64x48 30 png
         down
         bob settings 6: quality=30
         > settings-refused to bob ref 6 not-owner 204
         info bob 1
         bob settings 7: quality=30
         > settings-changed ref 7 bob 64x48 30 png
         carol settings 8
         > settings-in-use to carol ref 8 - 64x48 30 png",
    );
}

#[test]
fn the_owners_user_changes_them_by_any_of_its_peers() {
    check(
        "grabbed alice 5
         alice~2 settings 1: quality=30
         > settings-changed ref 1 alice~2 64x48 30 jpeg
         > draws -
         alice~2 settings 2: quality=0
         > settings-refused to alice~2 ref 2 bad-content 223
         alice~3 settings 3: quality=40
         > settings-refused to alice~3 ref 3 not-owner 204 owner alice
         grabbed mallory 6
         stranger settings 4: quality=40
         > settings-refused to stranger ref 4 not-owner 204 owner mallory
         grabbed anna 7
         anna settings 5: quality=40
         > settings-changed ref 5 anna 64x48 40 jpeg
         anna~2 settings 6: quality=50
         > settings-refused to anna~2 ref 6 not-owner 204 owner anna",
    );
}

#[test]
fn whose_a_change_is_is_asked_for_all_that_wait() {
    let mut stage = Stage::new(View::X);
    stage.act("grabbed alice 5");
    let hear = |server: &mut ImageServer, sender: &str| {
        let mut parcel = Parcel::new(Family::Message, SETTINGS).content(map_of("quality=30"));
        parcel.sender = Some(sender.into());
        let mut out = Vec::new();
        server.handle_camera(&Event::Message(parcel), &mut out);
        out.iter().map(line_of).collect::<Vec<String>>()
    };
    let server = &mut stage.server;
    assert!(hear(server, "alice~2").is_empty() && server.ask_users());
    // While the hub is asked, others come.
    for _ in 0..16 {
        assert!(hear(server, "bob").is_empty() && !server.ask_users());
    }
    assert_eq!(hear(server, "bob"), ["settings-refused to bob try-later 100"]);
    let mut out = Vec::new();
    server.handle_users(&users(), &mut out);
    assert_eq!(out.len(), 1);
    assert!(server.ask_users());
    // The hub could not be asked.
    server.handle_users(&BTreeMap::new(), &mut out);
    assert_eq!(out.len(), 17);
    assert!(line_of(&out[16]).starts_with("settings-refused to bob not-owner"));
    assert!(!server.ask_users());
}

#[test]
fn bad_settings_are_refused_and_change_nothing() {
    check(
        "grabbed alice 5
         alice settings 1: width=5000
         > settings-refused to alice ref 1 bad-content 223
         alice settings 2: quality=50 wdth=64
         > settings-refused to alice ref 2 bad-content 223
         alice settings 3: format=gif
         > settings-refused to alice ref 3 bad-content 223
         alice settings 4
         > settings-in-use to alice ref 4 - 64x48 80 jpeg",
    );
}

#[test]
fn a_failure_to_draw_holds_nothing_up() {
    check(
        "state 1
         > draws 1
         state 2
         after 100
         failed
         > draws 2
         drawn
         > image 2 at 100",
    );
}

#[test]
fn an_image_says_how_it_was_taken() {
    for view in View::ALL {
        let mut stage = Stage::new(view);
        (0..6).for_each(|seq| drop(stage.act(&format!("state {seq}"))));
        let shot = stage.shot.take().unwrap();
        assert_eq!(
            shot.scene.trail.len(),
            1,
            "the path of what was seen when it began"
        );
        stage.server.handle_picture(shot.take(), &mut stage.out);
        let content = stage.out.remove(0).value();
        assert_eq!(content.get("view").and_then(Value::as_str), Some(view.name()));
        assert_eq!(
            content.get("media-type").and_then(Value::as_str),
            Some("image/jpeg")
        );
        for (key, number) in [("width", 64), ("height", 48), ("quality", 80), ("state-seq", 0)] {
            assert_eq!(content.get(key).and_then(Value::as_int), Some(number), "{key}");
        }
        let bytes = content.get("image").and_then(Value::as_binary).unwrap();
        assert!(bytes.starts_with(&[0xff, 0xd8]));
        assert_eq!(content.get("pose-time"), Some(&Value::Time(Time::default())));
        assert_eq!(
            content.get("pose").and_then(|pose| pose.get("x")),
            Some(&Value::Double(0.0))
        );
        assert_eq!(names_of(&content), ["pose"]);
        let before = matrix_of(&content);
        assert_eq!(
            before,
            view.camera(&DrawnPose::default(), 64, 48).matrix(),
            "{view}"
        );
        stage.now = 100 * MS;
        let next = stage
            .server
            .advance(stage.now, Time::default(), &mut stage.out)
            .unwrap();
        assert_eq!(next.scene.trail.len(), 3);
        // The picture of a later state has that state's time and, on the gripper, its matrix.
        let pose = DrawnPose {
            x: 50.0,
            ..DrawnPose::default()
        };
        stage.server.handle_picture(next.take(), &mut stage.out);
        let content = stage.out.remove(0).value();
        assert_eq!(
            content.get("pose").and_then(|pose| pose.get("x")),
            Some(&Value::Double(50.0))
        );
        assert_eq!(names_of(&content), ["pose", "path"]);
        let sent = Time::from_micros(5000 * MS).map(Value::Time);
        assert_eq!(content.get("pose-time"), sent.as_ref());
        assert_eq!(matrix_of(&content), view.camera(&pose, 64, 48).matrix(), "{view}");
        assert_eq!(matrix_of(&content) == before, view != View::Wrist, "{view}");
    }
}

/// What `sender` says in a `calibration` message, and the answer's name, addressee and content.
fn calibrate(stage: &mut Stage, sender: &str, content: Map) -> (String, Option<String>, Value) {
    let mut parcel = Parcel::new(Family::Message, CALIBRATION).content(content);
    (parcel.sender, parcel.id) = (Some(sender.into()), Some(7));
    parcel.timestamp = Time::from_micros(5);
    stage
        .server
        .handle_camera(&Event::Message(parcel), &mut stage.out);
    let answer = stage.out.pop().expect("an answer");
    assert_eq!((answer.reference, stage.out.len()), (Some(7), 0));
    let to = answer
        .address
        .iter()
        .flatten()
        .next()
        .map(|peer| peer.to_string());
    (answer.name().to_owned(), to, answer.value())
}

/// The view's own matrix at 640×480, moved to the right by so many pixels.
fn moved_by(pixels: f64) -> Map {
    let mut matrix = View::X.camera(&DrawnPose::default(), 640, 480).matrix();
    for column in 0..4 {
        matrix[column] += pixels * matrix[8 + column];
    }
    let numbers: Vec<Value> = matrix.into_iter().map(Value::Double).collect();
    Map::new()
        .with("matrix", numbers)
        .with("width", 640)
        .with("height", 480)
        .with("rms", Value::Double(0.25))
        .with("poses", 19)
}

#[test]
fn a_measured_matrix_takes_the_place_of_the_views() {
    let mut stage = Stage::new(View::X);
    stage.act("info alice 4");
    let picture = |stage: &mut Stage| {
        let shot = stage.shot.take().expect("something is being drawn");
        let picture = shot.take();
        let content = picture.content.clone();
        stage.server.handle_picture(picture, &mut stage.out);
        stage.out.clear();
        Value::from(content.expect("it is drawn"))
    };
    stage.act("state 1");
    let before = picture(&mut stage);
    assert_eq!(before.get("calibrated"), None);

    let (name, to, content) = calibrate(&mut stage, "bob", moved_by(10.0));
    assert_eq!((name.as_str(), to.as_deref()), (CALIBRATION_REFUSED, Some("bob")));
    assert_eq!(content.get("name").and_then(Value::as_str), Some("not-owner"));
    let text = content.get("text").and_then(Value::as_str);
    let reason = "only the owner of /robot/token tells the camera its matrix, and that is alice";
    assert_eq!(text, Some(reason));
    let (name, to, content) = calibrate(&mut stage, "alice", moved_by(1000.0));
    assert_eq!(
        (name.as_str(), to.as_deref()),
        (CALIBRATION_REFUSED, Some("alice"))
    );
    assert_eq!(content.get("name").and_then(Value::as_str), Some("bad-content"));
    assert_eq!(stage.server.calibration(), None);

    let (name, to, content) = calibrate(&mut stage, "alice", moved_by(10.0));
    assert_eq!((name.as_str(), to), (CALIBRATION_CHANGED, None));
    assert_eq!(content.get("by").and_then(Value::as_str), Some("alice"));
    assert_eq!(
        stage.act("after 100"),
        ["draws 1"],
        "all are shown the new matrix"
    );
    let after = picture(&mut stage);
    let told = after.get("calibrated").expect("it is measured");
    assert_eq!(told.get("rms"), Some(&Value::Double(0.25)));
    assert_eq!(told.get("poses").and_then(Value::as_int), Some(19));
    assert_eq!(told.get("by").and_then(Value::as_str), Some("alice"));
    assert_eq!(told.get("time").and_then(Value::as_time), Time::from_micros(5));
    // The images are a tenth as wide as those in which it was measured.
    let ([before, after], depth) = ([before, after].map(|content| matrix_of(&content)), 8);
    for column in 0..4 {
        assert!((after[column] - before[column] - after[depth + column]).abs() < 1e-9);
        assert_eq!(after[depth + column], before[depth + column]);
    }

    let mut wrist = Stage::new(View::Wrist);
    wrist.act("info alice 4");
    let (name, _, content) = calibrate(&mut wrist, "alice", moved_by(0.0));
    assert_eq!(name, CALIBRATION_REFUSED);
    let text = content.get("text").and_then(Value::as_str).expect("a reason");
    assert!(text.contains("moves with the arm"), "{text}");
}
