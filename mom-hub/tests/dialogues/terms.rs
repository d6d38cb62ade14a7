//! A manager may say until when a token is granted: however a peer comes to own it, it ends then.

use mom_hub::Settings;
use mom_managers::{Answer, Denial, Grant, Manager, Question, Registry, Verdict, Wait};
use mom_proto::{Code, Map, Verb};

use crate::stage::{MS, Stage, lab, of};

/// Grants a token for five seconds; others may wait.
#[derive(Debug)]
struct FiveSeconds;

impl Manager for FiveSeconds {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let owner = question.token.and_then(|token| token.owner);
        let answer = match question.verb {
            Verb::Grab if owner.is_some_and(|owner| !owner.asks) => Answer::Queue(Wait {
                denial: Denial {
                    code: Code::HELD,
                    text: "it is taken".to_owned(),
                    rule: "five seconds".to_owned(),
                    earliest: None,
                },
                expected: None,
            }),
            Verb::Grab | Verb::Accept => Answer::Allow(Grant {
                until: Some(question.now + 5000 * MS),
                ..Grant::default()
            }),
            _ => Answer::Allow(Grant::default()),
        };
        Verdict {
            answer,
            ..Verdict::allow()
        }
    }
}

fn stage() -> Stage {
    let mut registry = Registry::builtin();
    registry.add_kind("five-seconds", |_| Ok(Box::new(FiveSeconds)));
    let contexts = lab(Map::new().with("manager", "five-seconds"));
    let mut stage = Stage::with(contexts, registry, Settings::default());
    for name in ["alice", "bob"] {
        stage.enter(name, 1);
    }
    stage.say("alice", "token grab /lab/key");
    stage
}

/// The token is lost at this ms, and not before.
fn ends_at(stage: &mut Stage, ms: u64, owner: &str) {
    assert_eq!(stage.at(ms - 1), [""; 0]);
    let heard = of(&stage.at(ms), &[owner]);
    assert!(
        heard
            .iter()
            .any(|line| line.starts_with(&format!("{owner}< released owner={owner}"))),
        "{heard:?}"
    );
}

#[test]
fn a_grab_ends_when_the_manager_says() {
    ends_at(&mut stage(), 5000, "alice");
}

#[test]
fn a_grab_that_has_waited_ends_when_the_manager_says() {
    let mut stage = stage();
    stage.say("bob", "token grab /lab/key wait=unlimited");
    stage.at(1000);
    let heard = stage.say("alice", "token release /lab/key");
    assert!(
        heard.contains(&"bob< ok fence=2".to_owned()),
        "it is answered: {heard:?}"
    );
    ends_at(&mut stage, 6000, "bob");
}

#[test]
fn what_is_handed_over_ends_when_the_manager_says() {
    let mut given = stage();
    given.say("alice", "token give /lab/key to=bob");
    given.at(1000);
    let heard = given.say("bob", "token accept /lab/key");
    assert!(heard.contains(&"bob< ok fence=2".to_owned()), "{heard:?}");
    ends_at(&mut given, 6000, "bob");

    let mut asked = stage();
    asked.say("bob", "token request /lab/key");
    asked.at(1000);
    let heard = asked.say("alice", "token accept /lab/key peer=bob");
    for line in ["alice< ok", "bob< ok fence=2"] {
        assert!(
            heard.iter().any(|heard| heard.starts_with(line)),
            "{line}: {heard:?}"
        );
    }
    ends_at(&mut asked, 6000, "bob");
}

#[test]
fn what_returns_ends_when_it_would_have_ended() {
    let mut stage = stage();
    stage.say("alice", "token give /lab/key to=bob for=1000");
    stage.say("bob", "token accept /lab/key");
    let heard = of(&stage.at(1000), &["alice"]);
    assert!(
        heard
            .iter()
            .any(|line| line.starts_with("alice< grabbed owner=alice")),
        "{heard:?}"
    );
    ends_at(&mut stage, 5000, "alice");
}
