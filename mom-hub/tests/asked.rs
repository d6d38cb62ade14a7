//! Requests about which somebody has to be asked: nobody is asked in vain, nor twice.

mod stage;

use stage::{Stage, context, of};

/// A channel that alice has made and answers for; bob is in it.
fn managed_by_alice() -> Stage {
    let mut stage = Stage::new(vec![context("/lab", "session").with("presence", "none")]);
    for name in ["alice", "bob"] {
        stage.enter(name, 1);
    }
    stage.say(
        "alice",
        "context create /lab/own kind=channel manager=self presence=none",
    );
    stage.say("alice", "context join /lab/own");
    stage.say("bob", "context join /lab/own");
    stage.say("alice", "manager verdict / consult=1 allow=true");
    stage
}

#[test]
fn what_stands_holds_for_the_messages_that_waited_behind_too() {
    let mut stage = managed_by_alice();
    for _ in 0..3 {
        stage.say("bob", "message say /lab/own");
    }
    let heard = stage.say("alice", "manager verdict / consult=2 allow=true stands=true");
    let asked = heard.iter().filter(|line| line.contains("consult")).count();
    assert_eq!(asked, 0, "asked once for all: {heard:?}");
    assert_eq!(of(&heard, &["bob"]), ["bob< say of bob"; 3], "{heard:?}");
    assert_eq!(
        of(&stage.say("bob", "message say /lab/own"), &["bob"]),
        ["bob< say of bob"]
    );
}

#[test]
fn what_does_not_stand_is_asked_for_each_message() {
    let mut stage = managed_by_alice();
    stage.say("bob", "message say /lab/own");
    stage.say("bob", "message say /lab/own");
    let heard = stage.say("alice", "manager verdict / consult=2 allow=true");
    assert_eq!(of(&heard, &["bob"]), ["bob< say of bob"], "{heard:?}");
    assert!(
        heard.iter().any(|line| line.starts_with("alice< consult")),
        "{heard:?}"
    );
}
