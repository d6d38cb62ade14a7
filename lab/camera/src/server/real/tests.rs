//! A real camera's server: what it is given, and what it says.

use bytes::Bytes;
use mom_client::{Event, Family, Path, Value};

use super::*;
use crate::server::{IMAGE, REQUEST, SETTINGS, SETTINGS_CHANGED, SETTINGS_IN_USE, SETTINGS_REFUSED};
use crate::source::Rendition;
use crate::{CameraSettings, Format, Renderer, Scene, View};

const AGAIN: Duration = Duration::from_secs(4);

/// A file of this size.
fn file(width: u32, height: u32, format: Format) -> Bytes {
    let settings = CameraSettings {
        width,
        height,
        format,
        ..CameraSettings::default()
    };
    let renderer = Renderer::new(View::Top, settings).unwrap();
    renderer.render(&Scene::default()).bytes.into()
}

fn frame(bytes: &Bytes) -> Sight {
    Sight::Frame(Arc::new(Frame::read(bytes.clone()).unwrap()))
}

fn failed(error: SourceError) -> Sight {
    Sight::Failed { error, again: AGAIN }
}

/// The server with its driver, which takes each shot at once.
struct Stage {
    server: ImageServer,
    now: i64,
}

impl Stage {
    fn new() -> Stage {
        let options = ServerOptions {
            view: View::X,
            channel: Path::parse("/camera/bench").unwrap(),
            token: Path::parse("/robot/token").unwrap(),
            settings: CameraSettings::default(),
            period: 100_000,
            trail: 3,
        };
        let source = Source {
            url: "http://ann:secret@cam/video".parse().unwrap(),
            rendition: Rendition::default(),
        };
        let mut server = ImageServer::real(options, &source).unwrap();
        server.handle_token_info(&Map::new().with("owner", "alice").with("fence", 1));
        Stage { server, now: 0 }
    }

    fn wall(&self) -> Time {
        Time::from_micros(self.now).unwrap()
    }

    /// What is said after so many ms.
    fn after(&mut self, millis: i64) -> Vec<Parcel> {
        self.now += millis * 1000;
        let mut out = Vec::new();
        while let Some(shot) = self.server.advance(self.now, self.wall(), &mut out) {
            self.server.handle_picture(shot.take(), &mut out);
        }
        assert!(
            self.server.next_wake().is_none_or(|wake| wake > self.now),
            "it would wake at once again"
        );
        out
    }

    fn see(&mut self, sight: Sight) -> Vec<Parcel> {
        let mut out = Vec::new();
        self.server.handle_sight(sight, self.wall(), &mut out);
        out.extend(self.after(0));
        out
    }

    fn hear(&mut self, sender: &str, name: &str, content: Map) -> Vec<Parcel> {
        let mut parcel = Parcel::new(Family::Message, name).content(content);
        (parcel.sender, parcel.id) = (Some(sender.into()), Some(7));
        let mut out = Vec::new();
        self.server.handle_camera(&Event::Message(parcel), &mut out);
        if self.server.ask_users() {
            self.server
                .handle_users(&std::collections::BTreeMap::new(), &mut out);
        }
        out.extend(self.after(0));
        out
    }

    fn state(&mut self, seq: i64, x: f64) {
        let content = Map::new()
            .with("seq", seq)
            .with("pose", Map::new().with("x", Value::Double(x)));
        let mut parcel = Parcel::new(Family::Message, "state").content(content);
        parcel.timestamp = Time::from_micros(seq);
        self.server.handle_robot(&Event::Message(parcel));
        assert_eq!(
            names(&self.after(0)),
            [""; 0],
            "an older frame does not show the new state"
        );
    }
}

fn names(parcels: &[Parcel]) -> Vec<&str> {
    parcels.iter().map(Parcel::name).collect()
}

fn number(content: &Value, key: &str) -> Option<i64> {
    content.get(key).and_then(Value::as_int)
}

fn bytes(content: &Value) -> Bytes {
    content
        .get("image")
        .and_then(Value::as_binary)
        .expect("an image")
        .clone()
}

#[test]
fn a_frame_goes_out_as_it_came_with_the_state_of_its_time() {
    let mut stage = Stage::new();
    let first = file(320, 180, Format::Png);
    let content = stage.see(frame(&first)).remove(0).value();
    assert_eq!(bytes(&content), first);
    assert_eq!(
        (number(&content, "width"), number(&content, "height")),
        (Some(320), Some(180))
    );
    assert_eq!(
        content.get("media-type").and_then(Value::as_str),
        Some("image/png")
    );
    assert_eq!(content.get("view").and_then(Value::as_str), Some("bench"));
    for absent in ["matrix", "quality", "pose", "pose-time", "state-seq", "overlays"] {
        assert_eq!(content.get(absent), None, "{absent}");
    }

    stage.state(3, 40.0);
    assert_eq!(names(&stage.after(200)), [""; 0]);
    let taken = stage.wall();
    let second = file(64, 48, Format::Jpeg);
    let content = stage.see(frame(&second)).remove(0).value();
    stage.state(4, 50.0);
    assert_eq!(bytes(&content), second);
    assert_eq!(number(&content, "state-seq"), Some(3));
    assert_eq!(
        content.get("pose").and_then(|pose| pose.get("x")),
        Some(&Value::Double(40.0))
    );
    assert_eq!(
        content
            .get("overlays")
            .and_then(Value::as_list)
            .map(|list| list.len()),
        Some(1)
    );
    // Asked for later, it is still of its own time.
    stage.now += 50_000;
    let asked = stage.hear("bob", REQUEST, Map::new());
    assert_eq!(names(&asked), [IMAGE]);
    let content = asked[0].value();
    assert_eq!(content.get("taken"), Some(&Value::Time(taken)));
    assert_eq!(number(&content, "state-seq"), Some(3));
}

#[test]
fn frames_replace_each_other_until_the_period_is_over() {
    let mut stage = Stage::new();
    let files = [64, 80, 96, 112].map(|width| file(width, 48, Format::Jpeg));
    assert_eq!(names(&stage.see(frame(&files[0]))), [IMAGE]);
    assert_eq!(names(&stage.see(frame(&files[1]))), [""; 0]);
    stage.now += 60_000;
    assert_eq!(names(&stage.see(frame(&files[2]))), [""; 0]);
    assert_eq!(stage.server.next_wake(), Some(100_000));
    let out = stage.after(40);
    assert_eq!(bytes(&out[0].value()), files[2]);
    assert_eq!(out.len(), 1);
}

#[test]
fn what_is_wrong_is_said_once_and_to_whoever_asks() {
    let mut stage = Stage::new();
    assert_eq!(
        names(&stage.hear("bob", REQUEST, Map::new())),
        [""; 0],
        "it is not known yet"
    );
    let missing = SourceError::Status(http::StatusCode::NOT_FOUND);
    let out = stage.see(failed(missing.clone()));
    assert_eq!(names(&out), [CAMERA_ERROR, REQUEST_REFUSED]);
    for parcel in &out {
        let content = parcel.value();
        let text = content.get("text").and_then(Value::as_str).unwrap();
        assert_eq!(
            text,
            "http://cam/video: the answer is 404 Not Found; trying again in 4 s"
        );
        assert_eq!(
            (
                content.get("name").and_then(Value::as_str),
                number(&content, "code")
            ),
            (Some("try-later"), Some(100))
        );
        assert_eq!(number(&content, "retry-after"), Some(4000));
    }
    assert_eq!((out[0].address.is_none(), out[1].reference), (true, Some(7)));
    assert_eq!(names(&stage.see(failed(missing.clone()))), [""; 0]);
    assert_eq!(names(&stage.hear("bob", REQUEST, Map::new())), [REQUEST_REFUSED]);
    assert_eq!(
        names(&stage.see(failed(SourceError::Ended))),
        [CAMERA_ERROR],
        "another reason"
    );
    assert_eq!(names(&stage.after(1000)), [""; 0]);
    let good = file(64, 48, Format::Jpeg);
    assert_eq!(names(&stage.see(frame(&good))), [CAMERA_RECOVERED, IMAGE]);
    assert_eq!(names(&stage.hear("bob", REQUEST, Map::new())), [IMAGE]);
    assert_eq!(names(&stage.see(failed(missing))), [CAMERA_ERROR]);
    assert_eq!(
        names(&stage.hear("bob", REQUEST, Map::new())),
        [REQUEST_REFUSED],
        "no old image"
    );
}

#[test]
fn a_wanted_form_is_made_of_each_frame() {
    let mut stage = Stage::new();
    assert_eq!(names(&stage.hear("bob", SETTINGS, Map::new())), [SETTINGS_IN_USE]);
    let wide = file(640, 320, Format::Png);
    stage.see(frame(&wide));
    let told = stage.hear("bob", SETTINGS, Map::new()).remove(0).value();
    assert_eq!(
        (number(&told, "width"), number(&told, "quality")),
        (Some(640), None)
    );
    stage.now += 100_000;
    let small = Map::new()
        .with("width", 200)
        .with("height", 200)
        .with("format", "jpeg");
    let out = stage.hear("alice", SETTINGS, small);
    assert_eq!(names(&out), [SETTINGS_CHANGED, IMAGE]);
    let content = out[1].value();
    // The shape stays.
    assert_eq!(
        (number(&content, "width"), number(&content, "height")),
        (Some(200), Some(100))
    );
    assert_eq!(number(&content, "quality"), Some(80));
    let told = Frame::read(bytes(&content)).unwrap();
    assert_eq!((told.width, told.height, told.format), (200, 100, Format::Jpeg));
    for bad in [Map::new().with("overlay", true), Map::new().with("width", 5)] {
        assert_eq!(names(&stage.hear("alice", SETTINGS, bad)), [SETTINGS_REFUSED]);
    }
    assert_eq!(
        names(&stage.hear("bob", SETTINGS, Map::new().with("width", 64))),
        [SETTINGS_REFUSED]
    );
}

/// A peer that restores settings names what the frames are already: they go out as they came all the same.
#[test]
fn to_want_what_a_frame_is_already_changes_nothing() {
    let mut stage = Stage::new();
    let first = file(320, 180, Format::Jpeg);
    stage.see(frame(&first));
    for wanted in [
        Map::new().with("format", "jpeg").with("overlay", false),
        Map::new().with("width", 640).with("height", 480),
    ] {
        stage.now += 100_000;
        let out = stage.hear("alice", SETTINGS, wanted);
        assert_eq!(names(&out), [SETTINGS_CHANGED, IMAGE]);
        assert_eq!(number(&out[0].value(), "quality"), None);
        let content = out[1].value();
        assert_eq!(
            (bytes(&content), number(&content, "quality")),
            (first.clone(), None)
        );
    }
    stage.now += 100_000;
    let out = stage.hear("alice", SETTINGS, Map::new().with("quality", 30));
    assert_eq!(number(&out[0].value(), "quality"), Some(30));
    assert_ne!(bytes(&out[1].value()), first);
}

#[test]
fn a_picture_that_is_finished_after_a_failure_is_not_sent() {
    let mut stage = Stage::new();
    let mut out = Vec::new();
    let mut request = Parcel::new(Family::Message, REQUEST);
    (request.sender, request.id) = (Some("bob".into()), Some(7));
    stage.server.handle_camera(&Event::Message(request), &mut out);
    let good = file(64, 48, Format::Jpeg);
    stage.server.handle_sight(frame(&good), stage.wall(), &mut out);
    let shot = stage.server.advance(stage.now, stage.wall(), &mut out);
    assert_eq!(names(&stage.see(failed(SourceError::Ended))), [CAMERA_ERROR]);
    let picture = shot.expect("it is being taken").take();
    stage.server.handle_picture(picture, &mut out);
    assert_eq!(names(&out), [REQUEST_REFUSED]);
    let text = out[0].value();
    let text = text.get("text").and_then(Value::as_str).unwrap();
    assert!(text.contains("the stream has ended"), "{text}");
    stage.now += 100_000;
    assert_eq!(names(&stage.see(frame(&good))), [CAMERA_RECOVERED, IMAGE]);
}

#[test]
fn a_frame_that_cannot_be_decoded_is_an_error_until_one_can() {
    let mut stage = Stage::new();
    let whole = file(640, 480, Format::Png);
    let half = whole.slice(..whole.len() / 2);
    assert_eq!(
        names(&stage.see(frame(&half))),
        [IMAGE],
        "nothing is decoded as long as nobody wants it"
    );
    stage.now += 100_000;
    let changed = stage.hear("alice", SETTINGS, Map::new().with("width", 64));
    assert_eq!(names(&changed), [SETTINGS_CHANGED, CAMERA_ERROR]);
    assert_eq!(names(&stage.hear("bob", REQUEST, Map::new())), [REQUEST_REFUSED]);
    stage.now += 100_000;
    assert_eq!(names(&stage.see(frame(&half))), [""; 0], "known");
    stage.now += 100_000;
    assert_eq!(names(&stage.see(frame(&whole))), [CAMERA_RECOVERED, IMAGE]);
}

#[test]
fn frames_that_are_none_are_refused_before_they_are_decoded() {
    let good = file(64, 48, Format::Png);
    // A PNG whose head says 60000x60000: width and height, and the checksum of the chunk.
    let mut bomb = good.to_vec();
    bomb[16..24].copy_from_slice(&[0, 0, 0xea, 0x60, 0, 0, 0xea, 0x60]);
    let sum = crc(&bomb[12..29]);
    bomb[29..33].copy_from_slice(&sum.to_be_bytes());
    let large = Bytes::from(vec![0xff; 8 << 20]);
    for (bytes, words) in [
        (Bytes::from(bomb), "a picture of 60000x60000 pixels came"),
        (
            Bytes::from_static(b"<html>no camera</html>"),
            "22 bytes came that are neither JPEG nor PNG",
        ),
        (Bytes::new(), "0 bytes came"),
        (good.slice(..20), "a broken picture came"),
        (large, "a picture larger than"),
    ] {
        let error = Frame::read(bytes).unwrap_err().to_string();
        assert!(error.starts_with(words), "{error}");
    }
}

/// The checksum of a PNG's chunk.
fn crc(bytes: &[u8]) -> u32 {
    let shift = |sum: u32| (sum >> 1) ^ (0xedb8_8320 & 0_u32.wrapping_sub(sum & 1));
    !bytes.iter().fold(u32::MAX, |sum, byte| {
        (0..8).fold(sum ^ u32::from(*byte), |sum, _| shift(sum))
    })
}
