//! Another user on the same connection is another peer: it inherits nothing, wherever the first one was known.

use mom_hub::{PeerId, Settings, User};
use mom_managers::{Ask, Manager, Question, Registry, Verdict};
use mom_proto::{Map, Verb};

use crate::stage::{Stage, context, lab, level_or_lease, of, user};

/// Asks who made the context about sends, and lets nobody in who is not invited.
#[derive(Debug)]
struct Private;

impl Manager for Private {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let made = question.created;
        match (question.verb, question.given("private")) {
            (Verb::Join, _) if !made && !question.invited => {
                Verdict::deny(mom_proto::Code::DENIED, "private", "for invited peers")
            }
            (Verb::Send, None) if !made => Verdict::defer("private", Ask::Creator, 5_000_000),
            (Verb::Send, Some(given)) if !given.allow => {
                Verdict::deny(mom_proto::Code::DENIED, "private", "no")
            }
            _ => Verdict::allow(),
        }
    }
}

fn private() -> Stage {
    let mut registry = Registry::builtin();
    registry.add_kind("private", |_| Ok(Box::new(Private)));
    Stage::with(lab(Map::new()), registry, Settings::default())
}

const ALICE: PeerId = PeerId(1);

fn becomes(stage: &mut Stage, name: &str) -> Vec<String> {
    let heard = stage.login(ALICE, user(name, 9));
    stage.say(name, "context join /lab");
    heard
}

#[test]
fn a_grant_that_is_being_stored_is_not_the_next_users() {
    let mut stage = Stage::durable(lab(Map::new()));
    stage.enter("alice", 1);
    stage.enter("bob", 1);
    stage.say("alice", "token grab /lab/key");
    let heard = becomes(&mut stage, "mallory");
    assert_eq!(
        of(&heard, &["mallory"])[0],
        "mallory< not-member",
        "the grab is answered"
    );
    assert_eq!(stage.answer(true), [""; 0], "and not granted to who came after");
    let info = stage.say("bob", "token info /lab/key");
    assert_eq!(info, ["bob< ok fence=0"]);
}

#[test]
fn a_grant_that_is_being_stored_ends_with_the_visit() {
    let mut stage = Stage::durable(lab(Map::new()));
    stage.enter("alice", 1);
    stage.enter("bob", 1);
    stage.say("alice", "token grab /lab/key");
    let left = stage.say("alice", "context leave /lab");
    assert_eq!(left, ["alice< not-member", "alice< ok"]);
    stage.say("alice", "context join /lab");
    stage.say("bob", "token grab /lab/key wait=1000");
    assert_eq!(stage.answer(true), [""; 0], "bob's turn has to be stored, too");
    assert_eq!(
        of(&stage.answer(true), &["bob"]),
        ["bob< grabbed owner=bob fence=1", "bob< ok fence=1"]
    );
}

#[test]
fn what_was_lent_does_not_return_to_somebody_else() {
    for leaves in [false, true] {
        let mut stage = Stage::new(lab(level_or_lease(60_000, "lazy")));
        stage.enter("alice", 3);
        stage.enter("bob", 1);
        stage.say("alice", "token grab /lab/key");
        stage.say("alice", "token give /lab/key to=bob for=1000");
        stage.say("bob", "token accept /lab/key");
        if leaves {
            // Who has left is not there to have it back, also if it comes again.
            stage.say("alice", "context leave /lab");
            stage.say("alice", "context join /lab");
        } else {
            becomes(&mut stage, "mallory");
        }
        let heard = stage.at(1000);
        assert_eq!(
            of(&heard, &["bob"]),
            [
                "bob< halt of hub",
                "bob< released owner=bob reason=returned fence=2"
            ],
            "leaves: {leaves}"
        );
        assert_eq!(stage.say("bob", "token info /lab/key"), ["bob< ok fence=2"]);
    }
}

#[test]
fn who_made_a_context_is_a_user_and_not_a_connection() {
    let mut stage = private();
    stage.enter("alice", 1);
    stage.say("alice", "context create /lab/talk kind=channel manager=private");
    stage.say("alice", "context join /lab/talk");
    let made = stage.say("alice", "message say /lab/talk");
    assert_eq!(made, ["alice< say of alice"], "its maker needs nobody's word");
    becomes(&mut stage, "mallory");
    let heard = stage.say("mallory", "context join /lab/talk");
    assert_eq!(heard, ["mallory< denied rule=private"]);
}

#[test]
fn an_invitation_is_a_users_and_not_a_connections() {
    let mut stage = private();
    stage.enter("alice", 1);
    stage.enter("bob", 1);
    stage.say("bob", "context create /lab/talk kind=channel manager=private");
    stage.say("bob", "context join /lab/talk");
    stage.say("bob", "context invite /lab/talk peer=alice");
    becomes(&mut stage, "mallory");
    let heard = stage.say("mallory", "context join /lab/talk");
    assert_eq!(heard, ["mallory< denied rule=private"]);
    becomes(&mut stage, "alice");
    let heard = stage.say("alice", "context join /lab/talk");
    assert_eq!(heard, ["alice< denied rule=private"], "it ended with the visit");
}

#[test]
fn a_question_ends_with_who_asked() {
    let mut stage = private();
    stage.enter("alice", 1);
    stage.enter("bob", 1);
    stage.say("bob", "context create /lab/talk kind=channel manager=private");
    stage.say("bob", "context join /lab/talk");
    stage.say("bob", "context invite /lab/talk peer=alice");
    stage.say("alice", "context join /lab/talk");
    let asked = stage.say("alice", "message say /lab/talk");
    assert_eq!(asked, ["bob< consult peer=alice rule=private"]);
    stage.say("alice", "message more /lab/talk");
    let heard = becomes(&mut stage, "mallory");
    let refused: Vec<&String> = heard.iter().filter(|line| line.contains("withdrawn")).collect();
    assert_eq!(refused.len(), 2, "both are answered: {heard:?}");
    let late = stage.say("bob", "manager verdict / consult=1 allow=true");
    assert_eq!(late, ["bob< too-late"]);
}

#[test]
fn one_managers_word_is_not_anothers() {
    // Two managers of one kind have one label: what the one was told must not count for the other.
    let mut registry = Registry::builtin();
    registry.add_kind("maker", |_| Ok(Box::new(Maker)));
    let mut stage = Stage::with(vec![context("/lab", "session")], registry, Settings::default());
    stage.enter("alice", 1);
    stage.enter("bob", 1);
    stage.enter("carol", 1);
    for name in ["alice", "bob", "carol"] {
        stage.say(name, "context join /lab");
    }
    stage.say("bob", "context create /lab/b kind=session manager=maker");
    stage.say("carol", "context create /lab/key kind=token manager=maker");
    let create = "context create /lab/b/arm kind=channel";
    let guard = Map::new()
        .with("token", "/lab/key")
        .with("names", vec!["command".into()]);
    let mut request = stage.request("alice", create);
    if let mom_hub::Input::Request { parcel, .. } = &mut request {
        let content = Map::new().with("kind", "channel").with("guard", guard);
        parcel.content = Some(content.into());
    }
    let first = stage.give(request);
    assert_eq!(first, ["bob< consult peer=alice rule=maker"]);
    let second = stage.say("bob", "manager verdict / consult=1 allow=true");
    assert_eq!(
        of(&second, &["carol"]),
        ["carol< consult peer=alice rule=maker"],
        "bob's word is not carol's: {second:?}"
    );
}

/// Asks who made the context about everything.
#[derive(Debug)]
struct Maker;

impl Manager for Maker {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        match question.given("maker") {
            _ if question.created => Verdict::allow(),
            None => Verdict::defer("maker", Ask::Creator, 5_000_000),
            Some(given) if given.allow => Verdict::allow(),
            Some(_) => Verdict::deny(mom_proto::Code::DENIED, "maker", "no"),
        }
    }
}

/// The same user again on its connection keeps what it has.
#[test]
fn the_same_user_again_keeps_all() {
    let mut stage = Stage::new(lab(Map::new()));
    stage.enter("alice", 1);
    stage.say("alice", "token grab /lab/key");
    stage.login(
        ALICE,
        User {
            level: 2,
            ..user("alice", 1)
        },
    );
    assert_eq!(stage.say("alice", "token renew /lab/key"), ["alice< ok fence=1"]);
}
