//! Tables of questions and answers.

mod chain;
mod guide;
mod lease;
mod moderated;
mod queue;
mod quota;
mod registry;
mod roles;
mod schedule;
mod self_managed;
mod unknown;
mod zones;

use mom_proto::{Code, ContextKind, Map, Micros, Path, Time, Value, Verb};

use crate::{
    Answer, Bucket, GivenAnswer, Manager, NoTokens, Owner, PeerFacts, Question, Rate, Registry, Scope,
    Standing, TokenFacts, Verdict,
};

/// A question with all that can matter.
#[derive(Clone, Copy, Debug)]
struct Ask<'a> {
    user: &'a str,
    level: i32,
    groups: &'a [&'a str],
    verb: Verb,
    path: &'a str,
    message: Option<&'a str>,
    size: usize,
    /// Name, which is also the user's, level, and whether it is the one that asks.
    owner: Option<(&'a str, i32, bool)>,
    owner_groups: &'a [&'a str],
    lease_end: Option<Micros>,
    since: Micros,
    waiting: usize,
    invited: bool,
    created: bool,
    answers: &'a [GivenAnswer],
    age: Option<(i64, u64)>,
    now: Micros,
    /// As text; empty = the epoch.
    wall: &'a str,
}

/// Alice at level 1 asks for the token.
const GRAB: Ask<'_> = Ask {
    user: "alice",
    level: 1,
    groups: &[],
    verb: Verb::Grab,
    path: "/robot/token",
    message: None,
    size: 0,
    owner: None,
    owner_groups: &[],
    lease_end: None,
    since: 0,
    waiting: 0,
    invited: false,
    created: false,
    answers: &[],
    age: None,
    now: 0,
    wall: "",
};

fn ask(manager: &mut dyn Manager, ask: &Ask<'_>) -> Verdict {
    let strings = |words: &[&str]| -> Vec<String> { words.iter().map(|word| (*word).to_owned()).collect() };
    let peer = PeerFacts {
        name: ask.user.into(),
        user: ask.user.into(),
        level: ask.level,
        groups: strings(ask.groups).into(),
    };
    let owner_groups = strings(ask.owner_groups);
    let owner = ask.owner.map(|(name, level, asks)| Owner {
        name,
        user: name,
        groups: &owner_groups,
        level,
        asks,
    });
    let wall: Time = match ask.wall {
        "" => Time::default(),
        text => text.parse().unwrap(),
    };
    manager.decide(&Question {
        peer: &peer,
        verb: ask.verb,
        context: &Path::parse(ask.path).unwrap(),
        kind: ContextKind::Token,
        message: ask.message,
        size: ask.size,
        age: ask.age,
        token: Some(TokenFacts {
            owner,
            lease_end: ask.lease_end,
            since: ask.since,
            waiting: ask.waiting,
        }),
        others: &NoTokens,
        invited: ask.invited,
        created: ask.created,
        answers: ask.answers,
        repeated: !ask.answers.is_empty(),
        now: ask.now,
        wall,
    })
}

/// Checks one manager against questions and the short form of their answers.
fn check(spec: impl Into<Value>, table: &[(&str, Ask<'_>, &str)]) {
    let mut manager = build(spec);
    for (why, question, expected) in table {
        assert_eq!(short(&ask(&mut *manager, question)), *expected, "{why}");
    }
}

fn words(words: &[&str]) -> Vec<Value> {
    words.iter().map(|word| Value::from(*word)).collect()
}

/// The text of a denial, also of one for those who do not wait.
fn text(verdict: &Verdict) -> &str {
    match &verdict.answer {
        Answer::Deny(denial) => &denial.text,
        Answer::Queue(wait) => &wait.denial.text,
        other => panic!("{other:?}"),
    }
}

fn build(spec: impl Into<Value>) -> Box<dyn Manager> {
    Registry::builtin().build(&spec.into()).unwrap()
}

fn of(kind: &str) -> Map {
    Map::new().with("kind", kind)
}

/// An answer in short: `allow`, `displace`, or the rule, code and earliest time of a denial.
fn short(verdict: &Verdict) -> String {
    let time = |word: &str, time: Option<Micros>| {
        let time = time.map(|time| format!(" {word} {time}"));
        time.unwrap_or_default()
    };
    match &verdict.answer {
        Answer::Allow(grant) => {
            let word = if grant.displace { "displace" } else { "allow" };
            format!("{word}{}", time("until", grant.until))
        }
        Answer::Deny(denial) => format!("{}: {}{}", denial.rule, denial.code, time("at", denial.earliest)),
        Answer::Defer(defer) => format!("ask by {}", defer.label),
        Answer::Queue(wait) => format!(
            "queue: {}: {}{}{}",
            wait.denial.rule,
            wait.denial.code,
            time("at", wait.denial.earliest),
            time("expected", wait.expected)
        ),
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

#[test]
fn what_is_added_to_a_verdict_fits_its_answer() {
    let denied = || Verdict::deny(Code::HELD, "rule", "text").stands(Scope::AnyName);
    let waits = denied().earliest(Some(1)).or_wait(Some(2));
    assert_eq!(short(&waits), "queue: rule: held at 1 expected 2");
    assert_eq!(waits.standing, Standing::Once, "a place in line is for this once");
    // What is not a part of an answer changes nothing.
    assert_eq!(denied().until(Some(1)), denied());
    assert_eq!(Verdict::allow().earliest(Some(1)), Verdict::allow());
    assert_eq!(Verdict::allow().or_wait(Some(1)), Verdict::allow());
    let rate = Rate {
        parcels: Bucket::UNLIMITED,
        bytes: Bucket {
            per_second: 1,
            burst: 1,
        },
    };
    assert_eq!(Verdict::allow().at_rate(rate), Verdict::allow());
    let limited = Verdict::allow_always().at_rate(rate);
    assert_eq!(limited.standing.rate(), Some(rate));
    assert_eq!(limited.standing.without_rate(), Verdict::allow_always().standing);
}
