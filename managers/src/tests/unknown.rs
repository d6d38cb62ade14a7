//! What a kind does with requests that it has no rule for: who decides denies them, who narrows allows them.

use mom_proto::{Map, Value, Verb};

use super::{Ask, GRAB, ask, build, of, words};

/// A peer with nothing, and another that owns the token.
const NOBODY: Ask<'_> = Ask {
    user: "nobody",
    level: 0,
    owner: Some(("bob", 5, false)),
    ..GRAB
};

fn one(key: &str, of_it: Map) -> Vec<Value> {
    vec![of_it.with(key, words(&["dora"])).into()]
}

#[test]
fn what_a_kind_does_not_know() {
    use Verb::{Accept, Grab, Inhibit};
    let slot = || one("users", Map::new().with("from", "00:00").with("to", "24:00"));
    let rule = || one("users", Map::new().with("allow", words(&["*"])));
    let chairs = || Map::new().with("users", words(&["dora"]));
    let limit = || {
        one(
            "users",
            Map::new().with("parcels", 1).with("verbs", words(&["*"])),
        )
    };
    let decides: &[Verb] = &Verb::ALL;
    let table: Vec<(Map, &[Verb])> = vec![
        (of("closed"), decides),
        (of("roles").with("rules", rule()), decides),
        (of("self"), decides),
        (of("open"), &[]),
        (of("first-come"), &[Grab, Inhibit]),
        (of("level-or-lease"), &[Grab, Inhibit]),
        (of("queue"), &[Grab, Inhibit]),
        (of("moderated").with("chairs", chairs()), &[Grab, Accept, Inhibit]),
        (of("schedule").with("slots", slot()), &[Grab, Accept, Inhibit]),
        (of("quota").with("limits", limit()), &[]),
    ];
    for (spec, refused) in table {
        let mut manager = build(spec.clone());
        for verb in Verb::ALL {
            let allowed = ask(&mut *manager, &Ask { verb, ..NOBODY }).is_allow();
            let expected = verb.gives_up() || !refused.contains(&verb);
            assert_eq!(allowed, expected, "{verb}: {spec:?}");
        }
    }
}

#[test]
#[rustfmt::skip]
fn every_answer_names_its_rule() {
    let slot = || one("users", Map::new().with("from", "00:00").with("to", "24:00").with("name", "night"));
    let rule = || one("users", Map::new().with("allow", words(&["grab"])).with("name", "dora may"));
    let limit = || vec![Map::new().with("parcels", 1).with("verbs", words(&["grab"])).into()];
    for (spec, user, verb, expected) in [
        (of("open"), "dora", Verb::Grab, "open"),
        (of("closed"), "dora", Verb::Leave, "closed"),
        (of("roles").with("rules", rule()), "dora", Verb::Grab, "roles/dora may"),
        (of("roles").with("rules", rule()), "dora", Verb::Leave, "roles"),
        (of("level-or-lease"), "dora", Verb::Grab, "level-or-lease"),
        (of("first-come"), "dora", Verb::Renew, "first-come"),
        (of("queue"), "dora", Verb::Grab, "queue"),
        (of("schedule").with("slots", slot()), "dora", Verb::Grab, "schedule/night"),
        (of("schedule").with("slots", slot()), "erik", Verb::Grab, "schedule/night"),
        (of("schedule").with("slots", slot()), "erik", Verb::Join, "schedule"),
        (of("quota").with("limits", limit()), "erik", Verb::Grab, "quota/limit 1"),
        (of("quota").with("limits", limit()), "erik", Verb::Join, "quota"),
        (of("self"), "erik", Verb::Grab, "self"),
    ] {
        let question = Ask { user, verb, ..GRAB };
        let verdict = ask(&mut *build(spec.clone()), &question);
        assert_eq!(verdict.rule.as_deref(), Some(expected), "{verb} by {user}: {spec:?}");
    }
}
