//! Images of a camera that turns (M62).

use super::tests::{Stage, matrix_of};
use super::*;
use crate::pan::Aim;

fn angle(content: &Value, key: &str) -> f64 {
    match content.get("aim").and_then(|aim| aim.get(key)) {
        Some(Value::Double(angle)) => *angle,
        other => panic!("{key} is {other:?}"),
    }
}

/// While the mount turns there is an image in each period, and one of where it ends; each tells where it was taken.
#[test]
fn a_camera_that_turns_shows_how_it_does() {
    let mut stage = Stage::new(View::Pan);
    let home = Aim::default();
    stage.act("state 0");
    stage.act("drawn");
    stage.act("after 100");
    assert_eq!(stage.server.next_wake(), None, "it stands");
    stage
        .server
        .handle_slew(Some(Slew::new(home, home.plus(&Aim::new(15.0, 0.0)), stage.now)));
    stage.act("after 1");
    let mut pans = Vec::new();
    while let Some(shot) = stage.shot.take() {
        let picture = shot.take();
        stage.server.handle_picture(picture, &mut stage.out);
        let content = stage.out.remove(0).value();
        let aim = Aim::new(angle(&content, "pan"), angle(&content, "tilt"));
        assert_eq!(matrix_of(&content), aim.camera(64.0, (64, 48)).matrix());
        pans.push(aim.pan);
        if let Some(due) = stage.server.next_wake() {
            stage.now = due;
            stage.act("after 0");
        }
    }
    let expected = [0.06, 6.06, 12.06, 15.0];
    let near = |(a, b): (&f64, f64)| (a - b).abs() < 1e-6;
    assert!(pans.len() == 4 && pans.iter().zip(expected).all(near), "{pans:?}");
    assert_eq!(stage.server.next_wake(), None, "it stands again");

    // Who asks gets one of now, whatever the period.
    let there = stage.server.scene.aim;
    stage.server.handle_slew(Some(Slew::new(
        there,
        there.plus(&Aim::new(-15.0, 0.0)),
        stage.now,
    )));
    stage.act("after 10");
    assert_eq!(
        stage.act("bob request 4"),
        ["draws 0"],
        "and not the one that is known"
    );
    // A state of the robot turns nothing.
    stage.act("state 1");
    assert_eq!(stage.server.scene.aim.pan, 14.4);
}
