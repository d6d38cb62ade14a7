//! Stops have numbers, and a gap is one.

use mom_client::Value;

use super::stage::Stage;

#[test]
fn it_is_freed_by_the_number_of_its_newest_stop_only() {
    let mut stage = Stage::new();
    for (line, state) in [
        ("bob stop 7", "stopped"),
        ("alice stop 8", "stopped"),
        ("bob unstop 7", "stopped"),
        ("alice unstop 8", "free"),
        // One that was lifted before it came holds nobody.
        ("bob stop 6", "free"),
        ("told 9 stopped", "stopped"),
        ("told 9", "free"),
    ] {
        stage.act(line);
        let heard = stage.heard();
        assert!(heard.iter().any(|line| line.contains(state)), "{line}: {heard:?}");
    }
}

#[test]
fn a_gap_is_a_stop_of_which_it_tells_the_hub() {
    let mut stage = Stage::new();
    stage.server.set_name("robot".to_owned());
    for line in ["lagged", "rejoined"] {
        stage.act(line);
        let stop = stage.out.iter().find(|parcel| parcel.name() == "stop");
        let address = stop.and_then(|stop| stop.address.clone());
        assert_eq!(address, Some(vec!["robot".into()]), "{line}");
        stage.out.clear();
    }
    // The hub gives it a number; from then on it is a stop like any other.
    stage.act("robot stop 3");
    stage.out.clear();
    stage.act("rejoined");
    assert!(stage.out.iter().all(|parcel| parcel.name() != "stop"));
    stage.act("bob unstop 3");
    let state = stage.out.last().expect("a state").value();
    assert_eq!(state.get("stopped"), Some(&Value::Bool(false)));
    assert_eq!(state.get("stop"), Some(&Value::Int(3)));
}

#[test]
fn one_that_is_put_out_of_its_channel_halts_and_ends_what_it_was_told() {
    let mut stage = Stage::new();
    stage.server.set_name("robot".to_owned());
    stage.act("alice command 1 5: move 300 0 300 0 0; home");
    stage.pass(500);
    stage.out.clear();
    // Another one does not concern this one.
    stage.act("expelled bob");
    assert!(stage.out.is_empty() && stage.server.state().moving);
    stage.act("expelled robot");
    let ended = stage.heard();
    assert!(
        ended
            .iter()
            .any(|line| line.contains("error") && line.contains("halted")),
        "{ended:?}"
    );
    stage.pass(2_000);
    let stands = stage.server.state();
    assert!(!stands.moving && stands.rest.is_some(), "{stands:?}");
}

#[test]
fn a_stopped_arm_says_when_it_rests() {
    let mut stage = Stage::new();
    let rests = |stage: &mut Stage| {
        let states = stage.out.drain(..).filter(|parcel| parcel.name() == "state");
        let last = states.last().map(|parcel| parcel.value());
        last.map(|state| (state.get("reached").cloned(), state.get("rest").cloned()))
    };
    stage.act("alice command 1 5: move 300 0 300 0 0");
    stage.pass(500);
    stage.act("bob stop 7");
    assert_eq!(rests(&mut stage), Some((Some(true.into()), None)));
    stage.pass(299);
    assert_eq!(rests(&mut stage), Some((Some(true.into()), None)));
    stage.pass(51);
    assert_eq!(
        rests(&mut stage),
        Some((Some(true.into()), Some("measured".into())))
    );
    // It rests on, and says so at once.
    stage.act("alice stop 8");
    assert_eq!(
        rests(&mut stage),
        Some((Some(true.into()), Some("measured".into())))
    );
    stage.pass(1_000);
    assert_eq!(rests(&mut stage), None, "there is nothing new to tell");
}
