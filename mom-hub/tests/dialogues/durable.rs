//! What is stored of tokens, and what a start makes of it (threat 30, the hub's part).

use mom_hub::{Holder, PeerId, Record, Settings};
use mom_managers::{Ask, Manager, Question, Registry, Verdict};
use mom_proto::{Map, Path, Verb};

use crate::stage::{EPOCH, Stage, lab, level_or_lease, of, user};

fn record(owner: Option<&str>, before: Option<&str>, lease: Option<u64>, fence: u64) -> Record {
    let holder = |name: &str| Holder {
        user: name.to_owned(),
        name: name.to_owned(),
    };
    Record {
        path: Path::parse("/lab/key").expect("a path"),
        fence,
        owner: owner.map(holder),
        before: before.map(holder),
        lease: lease.map(|ms| ms * 1000),
    }
}

/// A hub that is started with this record, and who comes.
fn started(record: Record, lease: i64) -> Stage {
    let settings = Settings {
        epoch: EPOCH + 1,
        durable: true,
        records: vec![record],
        ..Settings::default()
    };
    let contexts = lab(level_or_lease(lease, "lazy"));
    let mut stage = Stage::with(contexts, Registry::builtin(), settings);
    for name in ["alice", "bob"] {
        stage.enter(name, 1);
    }
    stage
}

#[test]
fn only_who_owned_it_has_it_before_its_lease_could_have_ended() {
    let fence = EPOCH << 20 | 7;
    let cases = [
        // The record; until when bob has to wait, ms; whether alice has to.
        (record(Some("alice"), None, Some(5000), fence), 5000, false),
        (record(Some("alice"), None, None, fence), 30_000, false),
        (
            record(Some("alice"), Some("carol"), Some(5000), fence),
            5000,
            true,
        ),
        (record(None, None, Some(0), fence), 0, false),
        // A longer lease of today may have been given already before it was in the record.
        (record(Some("alice"), None, Some(1000), fence), 2000, false),
    ];
    for (record, until, both) in cases {
        let start = || started(record.clone(), 2000);
        let mut stage = start();
        if until > 0 {
            stage.now = until * 1000 - 1;
            assert_eq!(
                stage.say("bob", "token grab /lab/key"),
                ["bob< held rule=restart"],
                "{record:?}"
            );
        }
        stage.at(until);
        stage.say("bob", "token grab /lab/key");
        let granted = stage.answer(true).contains(&"bob< ok fence=1".to_owned());
        assert!(granted, "{record:?}");
        let mut stage = start();
        let heard = stage.say("alice", "token grab /lab/key");
        assert_eq!(heard == ["alice< held rule=restart"], both, "{record:?}");
    }
}

#[test]
fn who_waits_for_a_token_that_is_kept_has_it_when_it_is_free() {
    let mut stage = started(record(Some("alice"), None, Some(5000), 1), 2000);
    stage.say("bob", "token grab /lab/key wait=unlimited");
    stage.at(5000);
    assert_eq!(of(&stage.answer(true), &["bob"])[1], "bob< ok fence=1");
}

#[test]
fn no_fence_comes_twice_even_if_the_clock_was_set_back() {
    // The record covers a block of numbers, which may reach into the epoch after its own.
    let last = (EPOCH << 20) + (1 << 20) - 1;
    let mut stage = started(record(None, None, Some(0), last), 2000);
    stage.say("bob", "token grab /lab/key");
    let (stored, _) = stage.stored.last().expect("a record");
    assert!(stored.fence >= last + (1 << 19), "{stored:?}");
    stage.answer(true);
}

#[test]
fn who_waited_comes_before_who_came_while_it_was_stored() {
    for ok in [true, false] {
        let mut stage = Stage::durable(lab(level_or_lease(60_000, "lazy")));
        for name in ["alice", "bob", "carol", "dave"] {
            stage.enter(name, 1);
        }
        stage.say("alice", "token grab /lab/key");
        stage.answer(true);
        stage.say("bob", "token grab /lab/key wait=unlimited");
        stage.say("carol", "token grab /lab/key wait=unlimited");
        stage.say("alice", "token release /lab/key");
        // Bob's turn is being stored, and Dave does not see that there is a queue.
        stage.say("dave", "token grab /lab/key");
        let heard = stage.answer(ok);
        if ok {
            assert!(heard.contains(&"bob< ok fence=2".to_owned()), "{heard:?}");
            assert!(
                heard.contains(&"dave< held rule=level-or-lease".to_owned()),
                "{heard:?}"
            );
        } else {
            assert_eq!(heard, ["bob< storage-failed"]);
            let next = stage.answer(true);
            assert!(next.contains(&"carol< ok fence=2".to_owned()), "{next:?}");
            assert!(
                next.contains(&"dave< held rule=level-or-lease".to_owned()),
                "{next:?}"
            );
        }
    }
}

#[test]
fn a_grant_that_failed_is_taken_out_of_the_record() {
    let mut stage = Stage::durable(lab(Map::new()));
    stage.enter("alice", 1);
    stage.say("alice", "token grab /lab/key");
    assert_eq!(stage.answer(false), ["alice< storage-failed"]);
    // The record may be durable all the same: nobody waits for its correction, but it is on its way.
    let (last, ticket) = stage.stored.last().expect("a record");
    assert_eq!((last.owner.as_ref(), *ticket), (None, None));
}

#[test]
fn the_longer_of_two_leases_is_kept() {
    let mut stage = Stage::durable(lab(level_or_lease(60_000, "lazy")));
    stage.enter("alice", 1);
    stage.enter("bob", 5);
    stage.say("alice", "token grab /lab/key");
    stage.answer(true);
    // Alice was promised a minute, whatever the configuration says since.
    stage.configure(lab(level_or_lease(1000, "lazy")), Vec::new());
    let mut failing = |ok: bool| {
        stage.say("bob", "token grab /lab/key");
        let (record, _) = stage.stored.last().expect("a record").clone();
        assert_eq!(record.lease, Some(60_000_000), "{record:?}");
        stage.answer(ok);
    };
    failing(false);
    failing(true);
    let (record, _) = stage.stored.last().expect("a record");
    assert_eq!(
        (record.lease, &record.before),
        (Some(1_000_000), &None),
        "Bob's own"
    );
}

#[test]
fn what_is_being_stored_is_taken_away_too() {
    let roles = |verb: &str| {
        let rule = Map::new().with("allow", vec![verb.into()]);
        Map::new().with("kind", "roles").with("rules", vec![rule.into()])
    };
    let mut stage = Stage::durable(lab(Map::new()));
    stage.enter("alice", 1);
    stage.enter("bob", 1);
    stage.say("alice", "token grab /lab/key");
    let heard = stage.configure(lab(Map::new().with("manager", roles("info"))), Vec::new());
    assert_eq!(heard, ["alice< denied"]);
    stage.answer(true);
    assert_eq!(stage.say("bob", "token info /lab/key"), ["bob< ok fence=0"]);
}

#[test]
fn a_user_that_is_removed_is_granted_nothing_that_was_being_stored() {
    let mut stage = Stage::durable(lab(Map::new()));
    stage.enter("alice", 1);
    stage.enter("bob", 1);
    stage.say("alice", "token grab /lab/key");
    stage.configure(lab(Map::new()), vec![(PeerId(1), None)]);
    assert_eq!(stage.answer(true), [""; 0]);
    assert_eq!(stage.say("bob", "token info /lab/key"), ["bob< ok fence=0"]);
    stage.login(PeerId(9), user("alice", 1));
}

/// Asks the chairs about grabs.
#[derive(Debug)]
struct Chaired;

impl Manager for Chaired {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let chairs = Ask::Chairs {
            users: ["carol".to_owned()].into(),
            groups: [].into(),
            min_level: None,
        };
        match question.given("chaired") {
            _ if question.verb != Verb::Grab => Verdict::allow(),
            None => Verdict::defer("chaired", chairs, 60_000_000),
            Some(given) if given.allow => Verdict::displace(),
            Some(_) => Verdict::deny(mom_proto::Code::DENIED, "chaired", "no"),
        }
    }
}

#[test]
fn an_answer_holds_until_the_token_is_granted_to_another() {
    let mut registry = Registry::builtin();
    registry.add_kind("chaired", |_| Ok(Box::new(Chaired)));
    let settings = Settings {
        durable: true,
        ..Settings::default()
    };
    let contexts = lab(Map::new().with("manager", "chaired"));
    let mut stage = Stage::with(contexts, registry, settings);
    for name in ["alice", "bob", "carol"] {
        stage.enter(name, 1);
    }
    stage.say("alice", "token grab /lab/key");
    stage.say("bob", "token grab /lab/key");
    stage.say("carol", "manager verdict / consult=1 allow=true");
    // Alice's grant is being stored now.
    stage.say("carol", "manager verdict / consult=2 allow=true");
    let heard = stage.answer(true);
    assert!(
        heard.iter().any(|line| line.starts_with("carol< consult")),
        "she has not said that bob may have it from alice: {heard:?}"
    );
    stage.say("carol", "manager verdict / consult=3 allow=true");
    let heard = stage.answer(true);
    assert!(heard.contains(&"bob< ok fence=2".to_owned()), "{heard:?}");
}
