//! Tables of questions and answers.

mod chain;
mod lease;
mod registry;
mod roles;

use mom_proto::{Code, ContextKind, Map, Path, Value, Verb};

use crate::{Answer, Manager, Micros, Owner, PeerFacts, Question, Registry, TokenFacts, Verdict};

/// A question with all that can matter.
#[derive(Clone, Copy, Debug)]
struct Ask<'a> {
    user: &'a str,
    level: i32,
    groups: &'a [&'a str],
    verb: Verb,
    path: &'a str,
    message: Option<&'a str>,
    /// Name, level, and whether it is the one that asks.
    owner: Option<(&'a str, i32, bool)>,
    lease_end: Option<Micros>,
    now: Micros,
}

/// Alice at level 1 asks for the token.
const GRAB: Ask<'_> = Ask {
    user: "alice",
    level: 1,
    groups: &[],
    verb: Verb::Grab,
    path: "/robot/token",
    message: None,
    owner: None,
    lease_end: None,
    now: 0,
};

fn ask(manager: &mut dyn Manager, ask: &Ask<'_>) -> Verdict {
    let peer = PeerFacts {
        name: ask.user.into(),
        user: ask.user.into(),
        level: ask.level,
        groups: ask.groups.iter().map(|group| (*group).to_owned()).collect(),
    };
    let owner = ask.owner.map(|(name, level, asks)| Owner { name, level, asks });
    manager.decide(&Question {
        peer: &peer,
        verb: ask.verb,
        context: &Path::parse(ask.path).unwrap(),
        kind: ContextKind::Token,
        message: ask.message,
        size: 0,
        age: None,
        token: Some(TokenFacts {
            owner,
            lease_end: ask.lease_end,
            since: 0,
            waiting: 0,
        }),
        invited: false,
        created: false,
        answers: &[],
        now: ask.now,
        wall: mom_proto::Time::default(),
    })
}

fn build(spec: impl Into<Value>) -> Box<dyn Manager> {
    Registry::builtin().build(&spec.into()).unwrap()
}

fn of(kind: &str) -> Map {
    Map::new().with("kind", kind)
}

/// An answer in short: `allow`, `displace`, or the rule, code and earliest time of a denial.
fn short(verdict: &Verdict) -> String {
    match &verdict.answer {
        Answer::Allow(grant) if grant.displace => "displace".to_owned(),
        Answer::Allow(_) => "allow".to_owned(),
        Answer::Deny(denial) => {
            let earliest = denial
                .earliest
                .map(|time| format!(" at {time}"))
                .unwrap_or_default();
            format!("{}: {}{earliest}", denial.rule, denial.code)
        }
        Answer::Defer(defer) => format!("ask by {}", defer.label),
        Answer::Queue(wait) => format!("queue: {}", wait.denial.rule),
    }
}

#[test]
fn open_allows_and_closed_denies_all_but_giving_up() {
    let (mut open, mut closed) = (build("open"), build("closed"));
    for verb in Verb::ALL {
        let question = Ask { verb, ..GRAB };
        assert_eq!(short(&ask(&mut *open, &question)), "allow", "{verb}");
        let expected = if verb.gives_up() {
            "allow"
        } else {
            "closed: denied"
        };
        assert_eq!(short(&ask(&mut *closed, &question)), expected, "{verb}");
    }
    let denial = ask(&mut *closed, &GRAB).answer;
    let Answer::Deny(denial) = denial else {
        panic!("{denial:?}")
    };
    assert_eq!(denial.code, Code::DENIED);
    assert_eq!(
        denial.text,
        "/robot/token is closed: its configuration allows nobody to grab"
    );
}
