//! Dialogues with the arm's server: who says what, and what the channel hears.

use mom_client::{Parcel, Path, Time, Value, from_value};
use mom_device::{DeviceServer, STATE};

use crate::state::ArmState;

mod interlock;
mod reach;
mod stage;
mod zones;

use stage::{STATEMENTS, Stage, check, lab};

/// Some are played for each of several events; none may be left out in silence.
#[test]
fn the_arm_does_what_every_device_does() {
    assert_eq!(
        mom_device_cases::replay(|| mom_device_cases::Stage::bare(lab()), &STATEMENTS),
        52
    );
}

#[test]
fn a_command_goes_through_its_states() {
    check(
        "alice command 7 5: move 0 0 270 0 0; wait 100
         > status alice/7 waiting 0/2
         > status alice/7 executing 1/2
         alice command - 5: home
         > status alice/- waiting 0/1
         after 250
         > status alice/7 executing 2/2
         > state free
         after 1000
         > state free
         > status alice/7 finished 2/2
         > status alice/- executing 1/1
         > state free
         > status alice/- finished 1/1
         > state free at rest",
    );
}

#[test]
fn what_the_arm_cannot_do_is_refused_with_its_code() {
    check(
        "alice command 1 5: mvoe 1 2
         > status alice/1 error 0/0 syntax 5001
         alice command 2 5: move 0 0 900 0 0
         > status alice/2 error 0/0 workspace-boundary 5002
         alice command
         > status alice/- error 0/0 syntax 5001",
    );
}

/// A velocity holds for its time, gives way to the next one, and is refused while a script is carried out.
#[test]
fn a_jog_ends_at_rest_unless_it_is_said_again() {
    check(
        "alice command 1 5: jog 100 0 0 0 0
         > status alice/1 waiting 0/1
         > status alice/1 executing 1/1
         after 150
         alice command 2 5: jog 100 0 0 0 0
         > status alice/2 waiting 0/1
         > status alice/1 finished 1/1
         > status alice/2 executing 1/1
         alice command 3 5: home
         > status alice/3 error 0/0 busy 5106
         after 200
         alice command 4 5: home
         > status alice/4 error 0/0 busy 5106
         after 170
         > state free
         > status alice/2 finished 1/1
         alice command 5 5: home
         > status alice/5 waiting 0/1
         > status alice/5 executing 1/1
         alice command 6 5: jog 10 0 0 0 0
         > status alice/6 error 0/0 busy 5106
         after 1000
         > state free
         > status alice/5 finished 1/1
         > state free at rest
         alice command 7 5: jog 10 0 0 0 0; home
         > status alice/7 error 0/0 syntax 5001
         alice command 8 5: jog 200 0 0 0 0
         > status alice/8 error 0/0 syntax 5001
         alice command 9 5: jog 20 0 0 0 0 2000
         > status alice/9 error 0/0 syntax 5001
         alice command 9 5: jog 150 0 0 0 0 1000
         > status alice/9 waiting 0/1
         > status alice/9 executing 1/1
         bob stop
         > state stopped moving
         > status alice/9 error 1/1 stopped 5102",
    );
}

#[test]
fn the_jaws_move_too_and_a_refusal_names_the_newest_state() {
    let mut stage = Stage::new();
    stage.act("report");
    stage.heard();
    stage.act("alice command 1 5: grip close");
    stage.pass(1000);
    stage.heard();
    let newest = *stage.states.last().unwrap();
    let first = stage.states[0];
    stage.act(&format!("alice command 2 5 on {first}: home"));
    let error = stage.out[0].value().get("error").cloned().unwrap();
    assert_eq!(error.get("state"), Some(&Value::Int(newest as i64)));
    assert_eq!(stage.heard(), ["status alice/2 error 0/0 stale-state 208"]);
}

#[test]
fn a_state_of_an_earlier_start_is_no_state_of_this_one() {
    let mut before = Stage::new();
    before.act("report");
    before.heard();
    let mut stage = Stage::new();
    let (channel, start) = (Path::parse("/robot/arm").unwrap(), Time::from_micros(1_000_000));
    stage.set(|_| DeviceServer::new(lab(), channel, start.unwrap()));
    stage.fence = None;
    stage.act("report");
    stage.heard();
    let old = before.states[0];
    stage.act(&format!("alice command 1 5 on {old}: home"));
    assert_eq!(
        stage.heard(),
        ["state free, fence 5", "status alice/1 error 0/0 stale-state 208"]
    );
}

#[test]
fn states_come_at_20_hz_and_name_the_command_as_its_sender_does() {
    let mut stage = Stage::new();
    stage.act("alice command 1 5: wait 1");
    stage.pass(1);
    stage.out.clear();
    stage.act("bob command 41 5: move 0 0 150 0 0");
    stage.pass(900);
    let states: Vec<Value> = stage
        .out
        .iter()
        .filter(|parcel| parcel.name() == STATE)
        .map(Parcel::value)
        .collect();
    assert_eq!(states.len(), 18);
    for state in &states {
        let executing = state.get("executing").unwrap();
        assert_eq!(executing.get("id"), Some(&Value::Int(41)));
        assert_eq!(executing.get("peer").and_then(Value::as_str), Some("bob"));
        let read: ArmState = from_value(state.clone()).unwrap();
        assert!(read.moving && read.pose.z < 300.0);
    }
}
