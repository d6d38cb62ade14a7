//! Commands that hold in one place only, and an arm that cannot be reached.

use super::stage::Stage;
use crate::controller::{LinkFault, Simulated};
use crate::machine::ArmMachine;
use crate::zones::Zones;

/// While the link to the controller is down the arm does not say that it stands: neither to a new owner nor to who has stopped it (M53).
#[test]
fn an_arm_out_of_reach_does_not_say_that_it_stands() {
    let fault = LinkFault {
        after: 1_000_000,
        lasting: 2_000_000,
    };
    let controller = Simulated::new(0, []).failing(fault);
    let mut stage = Stage::with(
        ArmMachine::new(Box::new(controller)),
        Zones::default(),
        |server| server,
    );
    stage.act("alice command 1 5: move 300 0 300 0 0");
    stage.heard();
    stage.act("after 1500");
    let heard = stage.heard();
    assert!(
        heard
            .iter()
            .any(|line| line.starts_with("status alice/1 error 1/1 link")),
        "{heard:?}"
    );
    let stands = |line: &String| line.starts_with("state") && !line.contains("moving");
    assert!(
        !heard.iter().any(stands),
        "nobody knows whether it stands: {heard:?}"
    );
    stage.act("alice command 2 5: home");
    assert_eq!(stage.heard(), ["status alice/2 error 0/0 link 5003"]);
    stage.act("carol stop");
    stage.act("grabbed 6");
    assert_eq!(
        stage.heard(),
        ["state stopped moving", "state stopped moving, fence 6"]
    );
    stage.act("after 1099");
    assert_eq!(stage.heard(), Vec::<String>::new());
    stage.act("after 350");
    assert_eq!(stage.heard(), ["state stopped moving", "state stopped at rest"]);
    stage.act("carol unstop");
    stage.act("bob command 3 6: wait 5");
    stage.act("after 100");
    let heard = stage.heard();
    assert!(
        heard.iter().any(|line| line.starts_with("status bob/3 finished")),
        "{heard:?}"
    );
}

/// "A bit to the left" is wrong once the arm has moved (M35).
#[test]
fn a_relative_command_names_the_state_that_it_is_based_on() {
    let mut stage = Stage::new();
    for (line, want) in [
        (
            "alice command 1 5: by 10 0 0 0 0",
            "status alice/1 error 0/0 no-state 5108",
        ),
        (
            "alice command 2 5 on newest: by 10 0 0 0 0; by 0 0 10 0 0",
            "status alice/2 waiting 0/2",
        ),
        ("after 1000", "status alice/2 executing 2/2"),
        (
            "alice command 3 5 on first: by 10 0 0 0 0",
            "status alice/3 error 0/0 stale-state",
        ),
        // From a place that it names itself it may go on from there.
        (
            "alice command 4 5: home; by 0 0 -10 0 0",
            "status alice/4 waiting 0/2",
        ),
        (
            "alice command 5 5: by 0 0 400 0 0",
            "status alice/5 error 0/0 no-state",
        ),
    ] {
        stage.act(line);
        let heard = stage.heard();
        assert!(
            heard.first().is_some_and(|first| first.starts_with(want)),
            "{line}: {heard:?}"
        );
    }
    stage.act("after 2000");
    stage.heard();
    stage.act("alice command 6 5 on newest: by 0 0 400 0 0");
    let heard = stage.heard();
    assert!(
        heard
            .last()
            .is_some_and(|last| last.contains("workspace-boundary")),
        "{heard:?}"
    );
}
