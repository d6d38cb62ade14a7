//! Dialogues with the mount's server: who says what, and what the channel hears.

use mom_client::Value;
use mom_device_cases::{Stage, Statements, check, replay};

use super::Mount;

/// What it is told where a dialogue of every device has a word in braces.
const STATEMENTS: Statements = Statements {
    go: "look 100 -20",
    back: "home",
    wrong: "lok 1 2",
    beyond: Some(("look 200 0", "joint-limit 5005")),
    relative: Some("turn 6 0"),
    velocity: None,
};

fn stage() -> Stage<Mount> {
    Stage::new(Mount::default())
}

/// Where it looks, by its state.
fn aim(stage: &mut Stage<Mount>) -> [f64; 2] {
    let position = stage.server().state().position;
    ["pan", "tilt"].map(|key| match position.get(key) {
        Some(Value::Double(angle)) => *angle,
        other => panic!("{key} is {other:?}"),
    })
}

/// Some are played for each of several events; none may be left out in silence.
#[test]
fn the_mount_does_what_every_device_does() {
    assert_eq!(replay(|| Stage::bare(Mount::default()), &STATEMENTS), 45);
}

#[test]
fn it_looks_where_it_was_told() {
    let mut stage = stage();
    check(
        &mut stage,
        "half a second for 30 degrees",
        "alice command 7 5: look 30 -20; wait 100
         > status alice/7 waiting 0/2
         > status alice/7 executing 1/2
         after 499
         after 1
         > status alice/7 executing 2/2
         > state free",
    );
    assert_eq!(aim(&mut stage), [30.0, -20.0]);
    stage.act("bob stop");
    stage.act("bob unstop");
    stage.act("alice command 8 5: home");
    stage.act("after 250");
    stage.act("released 5");
    assert_eq!(aim(&mut stage), [15.0, -20.0], "it stands at once");
}

#[test]
fn what_it_cannot_do_is_refused_with_its_code() {
    check(
        &mut stage(),
        "numbers and the next turn",
        "alice command 3 5: look nan 0
         > status alice/3 error 0/0 syntax 5001
         alice command 4 5: turn 1 0
         > status alice/4 error 0/0 no-state 5108
         alice command 5 5: look 170 0; turn 60 0
         > status alice/5 error 0/0 joint-limit 5005",
    );
}

#[test]
fn an_error_tells_the_nearest_aim_beside_its_words() {
    let mut stage = stage();
    stage.act("alice command 2 5: home; look 0 -90");
    let error = stage.out[0].value().get("error").cloned().unwrap();
    let text = "statement 2: tilt is -90°, but the mount turns from -60 to 30°; the nearest that it reaches is 0 -60";
    assert_eq!(error.get("text").and_then(Value::as_str), Some(text));
    assert_eq!(error.get("statement"), Some(&Value::Int(2)));
    let reachable = error.get("reachable").and_then(|aim| aim.get("tilt"));
    assert_eq!(reachable, Some(&Value::Double(-60.0)));
}

#[test]
fn a_queue_that_is_full_says_to_try_again() {
    let mut stage = stage();
    stage.act("fill 65");
    stage.act("alice command 66 5: home");
    let error = stage.out[0].value().get("error").cloned().unwrap();
    assert_eq!(error.get("retry"), Some(&Value::Bool(true)));
}
