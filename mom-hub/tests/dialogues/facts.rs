//! What the audit log is told: who did what to what, by which rule, under which fence.

use crate::stage::{Stage, lab, level_or_lease};

const STEPS: [(&str, &str, &[&str]); 20] = [
    (
        "alice",
        "token grab /lab/key",
        &["granted peer=alice user=alice context=/lab/key rule=level-or-lease level=1 fence=1"],
    ),
    (
        "bob",
        "token give /lab/key to=carol",
        &[
            "refused peer=bob user=bob verb=give context=/lab/key rule=one owner at most code=not-owner by=alice level=2",
        ],
    ),
    ("alice", "message command /lab/arm", &[]),
    (
        "bob",
        "message command /lab/arm",
        &[
            "refused peer=bob user=bob verb=send context=/lab/arm message=command rule=guard of /lab/arm code=not-owner by=alice level=2",
        ],
    ),
    ("alice", "token give /lab/key to=bob", &[]),
    (
        "bob",
        "token accept /lab/key",
        &[
            "lost peer=alice user=alice context=/lab/key reason=given by=bob level=1 fence=1",
            "granted peer=bob user=bob context=/lab/key rule=level-or-lease reason=given level=2 fence=2",
        ],
    ),
    ("alice", "token request /lab/key", &[]),
    (
        "bob",
        "token accept /lab/key peer=alice",
        &[
            "lost peer=bob user=bob context=/lab/key reason=given by=alice level=2 fence=2",
            "granted peer=alice user=alice context=/lab/key rule=level-or-lease reason=given level=1 fence=3",
        ],
    ),
    (
        "carol",
        "token grab /lab/key",
        &[
            "lost peer=alice user=alice context=/lab/key reason=preempted by=carol level=1 fence=3",
            "granted peer=carol user=carol context=/lab/key rule=level-or-lease reason=preempted level=5 fence=4",
        ],
    ),
    (
        "carol",
        "token release /lab/key",
        &["lost peer=carol user=carol context=/lab/key reason=released by=carol level=5 fence=4"],
    ),
    (
        "bob",
        "token inhibit /lab/key",
        &["inhibited peer=bob user=bob context=/lab/key level=2"],
    ),
    (
        "alice",
        "token grab /lab/key",
        &["refused peer=alice user=alice verb=grab context=/lab/key rule=shared hold code=held level=1"],
    ),
    (
        "carol",
        "token break /lab/key",
        &["uninhibited peer=bob user=bob context=/lab/key level=2"],
    ),
    (
        "alice",
        "context create /lab/own kind=session",
        &["created peer=alice user=alice context=/lab/own level=1"],
    ),
    ("alice", "context join /lab/own", &[]),
    (
        "alice",
        "context invite /lab/own peer=bob",
        &["invited peer=alice user=alice context=/lab/own by=bob level=1"],
    ),
    ("bob", "context join /lab/own", &[]),
    (
        "alice",
        "context expel /lab/own peer=bob text=enough",
        &["expelled peer=bob user=bob context=/lab/own by=alice text=enough level=2"],
    ),
    (
        "alice",
        "context delete /lab/own",
        &["deleted peer=alice user=alice context=/lab/own level=1"],
    ),
    (
        "bob",
        "context delete /lab/own",
        &["refused peer=bob user=bob verb=delete context=/lab/own code=unknown-path level=2"],
    ),
];

#[test]
fn every_fact_says_who_and_where() {
    let mut stage = Stage::new(lab(level_or_lease(60_000, "lazy")));
    for (name, level) in [("alice", 1), ("bob", 2), ("carol", 5)] {
        stage.enter(name, level);
    }
    for (who, line, facts) in STEPS {
        stage.say(who, line);
        let facts: Vec<String> = facts.iter().map(|fact| format!("what={fact}")).collect();
        assert_eq!(stage.facts(), facts, "{who}: {line}");
    }
    stage.gone("alice");
    assert_eq!(stage.facts(), ["what=gone peer=alice user=alice level=1"]);
}

#[test]
fn who_has_waited_is_granted_by_a_rule_too() {
    let mut stage = Stage::new(lab(level_or_lease(60_000, "lazy")));
    for name in ["alice", "bob"] {
        stage.enter(name, 1);
        stage.say(name, "token grab /lab/key wait=unlimited");
    }
    stage.say("alice", "token release /lab/key");
    assert_eq!(
        stage.facts(),
        [
            "what=lost peer=alice user=alice context=/lab/key reason=released by=alice level=1 fence=1",
            "what=granted peer=bob user=bob context=/lab/key rule=level-or-lease level=1 fence=2",
        ]
    );
}
