//! What the images of a robot say that moves while its states are late (M34).

use mom_client::{Content, Value};

use super::*;
use crate::Source;
use crate::source::{Frame, Sight};

const MS: i64 = 1000;
/// From the robot to the camera, ms.
const DELAY: i64 = 300;

fn at(ms: i64) -> Time {
    Time::from_micros(ms * MS).unwrap()
}

fn options() -> ServerOptions {
    ServerOptions {
        view: View::Top,
        channel: Path::parse("/camera/top").unwrap(),
        token: Path::parse("/robot/token").unwrap(),
        settings: CameraSettings {
            width: 200,
            height: 150,
            ..CameraSettings::default()
        },
        period: 0,
        trail: 3,
    }
}

/// The state of this time, ms, of a robot that goes 150 mm a second to the right; it reached the hub `DELAY` later.
fn state(time: i64, moving: bool) -> Event {
    let x = Value::Double(0.15 * time as f64);
    let content = Map::new().with("seq", time).with("moving", moving);
    let mut parcel =
        Parcel::new(Family::Message, STATE).content(content.with("pose", Map::new().with("x", x)));
    (parcel.timestamp, parcel.received, parcel.age) =
        (Some(at(time)), Some(at(time + DELAY)), Some(DELAY * MS));
    Event::Message(parcel)
}

fn shown(server: &mut ImageServer, now: i64) -> Map {
    let mut out = Vec::new();
    if let Some(shot) = server.advance(now * MS, at(now), &mut out) {
        server.handle_picture(shot.take(), &mut out);
    }
    assert_eq!(out.len(), 1);
    match out.remove(0).content {
        Some(Content::Value(Value::Map(map))) => map,
        other => panic!("{other:?}"),
    }
}

/// Name, x of the tip and time in ms of the poses beside an image.
fn poses(content: &Map) -> Vec<(String, f64, i64)> {
    let overlays = content
        .get("overlays")
        .and_then(Value::as_list)
        .expect("overlays");
    let marks = overlays.iter().filter_map(|overlay| {
        let name = overlay.get("name").and_then(Value::as_str)?;
        let time = overlay.get("time").and_then(Value::as_time)?;
        let points = overlay.get("points").and_then(Value::as_list)?;
        match points[1].as_list()?[0] {
            Value::Double(x) => Some((name.to_owned(), x, time.micros() / MS)),
            _ => None,
        }
    });
    marks.collect()
}

fn mark(name: &str, x: f64, time: i64) -> (String, f64, i64) {
    (name.to_owned(), x, time)
}

#[test]
fn measured_and_predicted_pose_go_beside_each_image() {
    let mut server = ImageServer::new(options()).unwrap();
    server.handle_robot(&state(0, true));
    shown(&mut server, 300);
    server.handle_robot(&state(50, true));
    let content = shown(&mut server, 350);
    // 45 mm behind, and where it is.
    let now = vec![mark("pose", 7.5, 50), mark("predicted", 52.5, 350)];
    assert_eq!(poses(&content), now);
    assert_eq!(content.get("taken"), Some(&Value::Time(at(350))));
    // Asked for later, it has gone on, though no new state has come.
    let mut request = Parcel::new(Family::Message, REQUEST);
    request.sender = Some("bob".into());
    server.handle_camera(&Event::Message(request), &mut Vec::new());
    let later = vec![mark("pose", 7.5, 50), mark("predicted", 58.5, 390)];
    assert_eq!(poses(&shown(&mut server, 390)), later);
    // It says that it stands: no overshoot.
    server.handle_robot(&state(100, false));
    assert_eq!(poses(&shown(&mut server, 400)), [mark("pose", 15.0, 100)]);
}

#[test]
fn nothing_is_predicted_while_the_controller_is_not_there() {
    let mut server = ImageServer::new(options()).unwrap();
    server.handle_robot(&state(0, true));
    server.handle_robot(&state(50, true));
    let Event::Message(mut down) = state(100, true) else {
        panic!("a state is a message");
    };
    let content = down.value();
    let content = Map::new()
        .with("seq", 100)
        .with("moving", true)
        .with("linked", false)
        .with("pose", content.get("pose").cloned().unwrap());
    down.content = Some(content.into());
    server.handle_robot(&Event::Message(down));
    assert_eq!(poses(&shown(&mut server, 400)), [mark("pose", 15.0, 100)]);
}

#[test]
fn a_real_image_has_the_prediction_of_its_own_time() {
    let source = Source {
        url: "http://cam/".parse().unwrap(),
        rendition: crate::Rendition::default(),
    };
    let mut server = ImageServer::real(options(), &source).unwrap();
    server.handle_robot(&state(0, true));
    server.handle_robot(&state(50, true));
    let image = Renderer::new(View::Top, options().settings)
        .unwrap()
        .render(&Scene::default());
    let frame = Frame::read(image.bytes.into()).unwrap();
    server.handle_sight(Sight::Frame(Arc::new(frame)), at(350), &mut Vec::new());
    let now = vec![mark("pose", 7.5, 50), mark("predicted", 52.5, 350)];
    assert_eq!(poses(&shown(&mut server, 390)), now);
}

#[test]
fn the_predicted_pose_is_drawn_in_another_colour() {
    let settings = CameraSettings {
        overlay: true,
        format: crate::Format::Png,
        ..CameraSettings::default()
    };
    let renderer = Renderer::new(View::Y, settings).unwrap();
    let mut scene = Scene::default();
    let measured = renderer.render(&scene).bytes;
    let pink = |bytes: &[u8]| {
        let pixels = image::load_from_memory(bytes).unwrap().into_rgb8();
        pixels
            .pixels()
            .filter(|pixel| pixel.0[0] > 180 && pixel.0[1] < 90 && (90..150).contains(&pixel.0[2]))
            .count()
    };
    assert_eq!(pink(&measured), 0);
    scene.predicted = Some(crate::DrawnPose {
        x: 45.0,
        ..scene.pose
    });
    assert!(pink(&renderer.render(&scene).bytes) > 20);
}
