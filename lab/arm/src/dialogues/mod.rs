//! Dialogues with the arm's server: who says what, and what the channel hears.

use mom_client::{Parcel, Path, Time, Value, from_value};
use mom_device::{DeviceServer, STATE};

use crate::state::ArmState;

mod interlock;
mod reach;
mod stage;
mod stops;
mod zones;

use stage::{Stage, check, lab};

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

#[test]
fn only_the_fence_of_the_owner_is_obeyed() {
    check(
        "gate bob 6
         alice command 1 5: home
         > status alice/1 error 0/0 older-fence 205
         alice command 2 -: home
         > status alice/2 error 0/0 older-fence 205
         bob command 1 6: wait 10
         > state free at rest, fence 6
         > status bob/1 waiting 0/1
         > status bob/1 executing 1/1
         gate - 6
         bob command 2 6: home
         > status bob/2 error 0/0 older-fence 205",
    );
}

#[test]
fn ids_are_unique_per_sender_and_fence_only() {
    check(
        "alice command 1 5: wait 100
         > status alice/1 waiting 0/1
         > status alice/1 executing 1/1
         bob command 1 5: wait 100
         > status bob/1 waiting 0/1
         alice command 1 5: home
         > status alice/1 error 0/0 duplicate-id 5104
         after 100
         > state free
         > status alice/1 finished 1/1
         > status bob/1 executing 1/1
         alice command 1 5: wait 100
         > status alice/1 waiting 0/1
         alice command - 5: wait 1
         > status alice/- waiting 0/1
         alice command - 5: wait 1
         > status alice/- waiting 0/1",
    );
}

/// Everything that ends two commands of fence 5, and whether the arm is stopped after it. The next owner's command begins when the arm
/// rests.
#[test]
fn commands_end_when_control_is_lost() {
    for (line, stopped) in [
        ("hub halt", false),
        ("released 5", false),
        ("grabbed 6", false),
        ("down", false),
        ("bob stop", true),
        ("lagged", true),
    ] {
        let refused = "error 0/0 stopped 5102";
        let (word, code, next) = match stopped {
            true => ("stopped", "stopped 5102", refused),
            // It has not heard on the new connection whether it is stopped.
            false if line == "down" => ("free", "halted 5101", refused),
            false => (
                "free",
                "halted 5101",
                "waiting 0/1\nafter 300\n> state free moving\n> state free at rest\n> status bob/3 executing 1/1",
            ),
        };
        let fence = if line == "grabbed 6" { ", fence 6" } else { "" };
        check(&format!(
            "alice command 1 5: wait 100
             > status alice/1 waiting 0/1
             > status alice/1 executing 1/1
             alice command 2 5: home
             > status alice/2 waiting 0/1
             {line}
             > state {word} moving{fence}
             > status alice/1 error 1/1 {code}
             > status alice/2 error 0/1 {code}
             bob command 3 7: wait 9
             > state {word} moving, fence 7
             > status bob/3 {next}"
        ));
    }
}

#[test]
fn what_takes_no_control_away_ends_nothing() {
    for line in [
        "released 4",
        "grabbed 5",
        "bob halt",
        "bob unstop\n> state free",
        "bob chat",
    ] {
        check(&format!(
            "alice command 1 5: wait 100
             > status alice/1 waiting 0/1
             > status alice/1 executing 1/1
             {line}
             after 100
             > state free
             > status alice/1 finished 1/1"
        ));
    }
}

#[test]
fn a_newer_fence_ends_what_an_older_one_began() {
    check(
        "alice command 1 5: wait 100
         > status alice/1 waiting 0/1
         > status alice/1 executing 1/1
         bob command 1 6: wait 100
         > state free moving, fence 6
         > status alice/1 error 1/1 halted 5101
         > status bob/1 waiting 0/1
         released 5
         grabbed 6
         after 299
         > state free moving
         after 1
         > state free at rest
         > status bob/1 executing 1/1",
    );
}

#[test]
fn a_stop_latches_until_it_is_released() {
    check(
        "bob stop
         > state stopped at rest
         carol stop
         > state stopped at rest
         released 5
         alice command 1 5: home
         > status alice/1 error 0/0 stopped 5102
         rejoined
         > state stopped at rest
         carol unstop
         > state free at rest
         alice command 2 5: wait 1
         > status alice/2 waiting 0/1
         > status alice/2 executing 1/1",
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
fn what_was_meant_for_an_earlier_state_is_refused() {
    check(
        "report
         > state free at rest
         report
         > state free at rest
         alice command 1 5 on before: move 0 0 270 0 0
         > status alice/1 waiting 0/1
         > status alice/1 executing 1/1
         alice command 2 5 on newest: home
         > status alice/2 error 0/0 stale-state 208
         alice command 3 5: wait 10
         > status alice/3 waiting 0/1
         after 1000
         > state free
         > status alice/1 finished 1/1
         > status alice/3 executing 1/1
         > state free
         > status alice/3 finished 1/1
         > state free at rest
         alice command 4 5 on before: wait 10
         > status alice/4 waiting 0/1
         > status alice/4 executing 1/1
         after 10
         > state free
         > status alice/4 finished 1/1
         alice command 5 5: home
         > status alice/5 waiting 0/1
         > status alice/5 executing 1/1
         after 1000
         > state free
         > status alice/5 finished 1/1
         > state free at rest
         alice command 6 5 on before: home
         > status alice/6 waiting 0/1
         > status alice/6 executing 1/1
         > state free
         > status alice/6 finished 1/1
         alice command 7 5 on next: home
         > status alice/7 error 0/0 stale-state 208
         alice command 8 5 on red: home
         > status alice/8 error 0/0 bad-slot 220
         alice command 9 5 on newest: wait 10
         > status alice/9 waiting 0/1
         > status alice/9 executing 1/1",
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
    stage.command("alice", "2", "5", "home", Some(Value::Int(first as i64)));
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
    stage.server = DeviceServer::new(lab(), channel, start.unwrap());
    stage.fence = None;
    stage.act("report");
    stage.heard();
    let old = Value::Int(before.states[0] as i64);
    stage.command("alice", "1", "5", "home", Some(old));
    assert_eq!(
        stage.heard(),
        ["state free, fence 5", "status alice/1 error 0/0 stale-state 208"]
    );
}

#[test]
fn who_joins_is_told_the_state() {
    check(
        "joined bob
         > state to bob free at rest
         count
         > state free at rest
         down
         rejoined
         > state free at rest",
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

/// Within what time it stands is declared to who joins, and not again with each state.
#[test]
fn who_joins_is_told_how_soon_it_stands() {
    let mut stage = Stage::new();
    let within = |parcel: &Parcel| parcel.value().get("stops-within").and_then(Value::as_int);
    stage.act("joined bob");
    assert_eq!(
        stage
            .out
            .drain(..)
            .map(|state| within(&state))
            .collect::<Vec<_>>(),
        [Some(1000)]
    );
    stage.act("alice command 1 5: move 0 0 150 0 0");
    stage.pass(500);
    assert!(stage.out.iter().all(|parcel| within(parcel).is_none()));
}
