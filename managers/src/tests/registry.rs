//! Managers that cannot be made, and why.

use mom_proto::{Code, Map, Value};

use super::{GRAB, ask, of, short};
use crate::Registry;

fn registry() -> Registry {
    let mut registry = Registry::builtin();
    let rule = Map::new().with("allow", vec!["grab".into()]).with("min-level", 2);
    registry.define("staff", of("roles").with("rules", vec![rule.into()]).into());
    registry.define("again", "staff".into());
    registry.define("ring", of("chain").with("of", vec!["ring".into()]).into());
    registry.define("ping", "pong".into());
    registry.define("pong", "ping".into());
    registry
}

/// Specifications, and the code, slot and nearest of their errors.
#[rustfmt::skip]
fn wrong() -> Vec<(Value, Code, &'static str, Option<&'static str>)> {
    let rules = |rule: Map| of("roles").with("rules", vec![rule.into()]);
    let grab = || Map::new().with("allow", vec!["grab".into()]);
    let chain = |inner: Value| of("chain").with("of", vec!["open".into(), inner]);
    let (unknown, bad) = (Code::UNKNOWN_MANAGER, Code::BAD_CONTENT);
    let table: Vec<(Value, &Code, &str, Option<&str>)> = vec![
        ("opne".into(), &unknown, "kind", Some("open")),
        ("stuff".into(), &unknown, "kind", Some("staff")),
        ("xyzzy".into(), &unknown, "kind", None),
        (of("rolls").into(), &unknown, "kind", Some("roles")),
        (Map::new().into(), &bad, "kind", None),
        (3.into(), &bad, "", None),
        (Value::Null, &bad, "", None),
        (of("open").with("colour", "red").into(), &bad, "colour", None),
        (of("closed").with("colour", "red").into(), &bad, "colour", None),
        (of("roles").into(), &bad, "rules", None),
        (of("level-or-lease").with("lease", 0).into(), &bad, "lease", None),
        (of("level-or-lease").with("lease", i64::MAX).into(), &bad, "lease", None),
        (of("level-or-lease").with("lease", "long").into(), &bad, "lease", None),
        (of("first-come").with("lease", -1).into(), &bad, "lease", None),
        (of("first-come").with("expiry", "soon").into(), &bad, "expiry", None),
        (rules(Map::new()).into(), &bad, "rules/0/allow", None),
        (rules(grab().with("deny", vec!["send".into()])).into(), &bad, "rules/0/allow", None),
        (rules(Map::new().with("deny", vec!["grib".into()])).into(), &bad, "rules/0/deny", Some("grab")),
        (rules(grab().with("where", vec!["robot".into()])).into(), &bad, "rules/0/where/0", None),
        (rules(grab().with("min-level", "high")).into(), &bad, "rules/0/min-level", None),
        (rules(grab().with("invited", "yes")).into(), &bad, "rules/0/invited", None),
        (of("chain").with("of", Vec::<Value>::new()).into(), &bad, "of", None),
        (chain("opne".into()).into(), &unknown, "of/1/kind", Some("open")),
        (chain(of("level-or-lease").with("lease", 0).into()).into(), &bad, "of/1/lease", None),
    ];
    table.into_iter().map(|(spec, code, slot, nearest)| (spec, code.clone(), slot, nearest)).collect()
}

/// `bad-content` of the kinds that narrow what others allow.
#[rustfmt::skip]
fn wrong_tokens_and_chairs() -> Vec<(Value, &'static str, Option<&'static str>)> {
    let queue = || of("queue");
    let within = |millis: i64| of("self").with("within", millis);
    let chairs = |chairs: Map| of("moderated").with("chairs", chairs);
    vec![
        (of("level-or-lease").with("leese", 1).into(), "leese", Some("lease")),
        (of("level-or-lease").with("equal", "yes").into(), "equal", None),
        (of("level-or-lease").with("deadman", 0).into(), "deadman", None),
        (of("level-or-lease").with("hold", 0).into(), "hold", None),
        (of("level-or-lease").with("notice", -1).into(), "notice", None),
        (queue().with("lease", 0).into(), "lease", None),
        (queue().with("hold", i64::MAX).into(), "hold", None),
        (queue().with("equal", true).into(), "equal", None),
        (within(0).into(), "within", None),
        (within(3_600_001).into(), "within", None),
        (of("self").with("verbs", vec!["jion".into()]).into(), "verbs", Some("join")),
        (of("self").with("verbs", Vec::<Value>::new()).into(), "verbs", None),
        (of("moderated").into(), "chairs", None),
        (chairs(Map::new()).into(), "chairs", None),
        (chairs(Map::new().with("users", Vec::<Value>::new())).into(), "chairs/users", None),
        (chairs(Map::new().with("users", vec!["x".into()]).with("groups", Vec::<Value>::new())).into(), "chairs/groups", None),
        (chairs(Map::new().with("minlevel", 1)).into(), "chairs/minlevel", Some("min-level")),
        (chairs(Map::new().with("min-level", 1)).with("verbs", vec!["gaab".into()]).into(), "verbs", Some("grab")),
        (chairs(Map::new().with("min-level", 1)).with("within", 0).into(), "within", None),
    ]
}

#[rustfmt::skip]
fn wrong_slots_and_limits() -> Vec<(Value, &'static str, Option<&'static str>)> {
    let slot = |from: &str, to: &str| Map::new().with("from", from).with("to", to);
    let schedule = |second: Map| of("schedule").with("slots", vec![slot("00:00", "24:00").into(), second.into()]);
    let quota = |limit: Map| of("quota").with("limits", vec![limit.into()]);
    let (once, end) = ("2026-11-23T09:00:00Z", "2026-11-23T10:00:00Z");
    vec![
        (of("schedule").into(), "slots", None),
        (of("schedule").with("slots", Vec::<Value>::new()).into(), "slots", None),
        (schedule(slot("9:00", "10:00")).into(), "slots/1/from", None),
        (schedule(slot("24:00", "10:00")).into(), "slots/1/from", None),
        (schedule(slot("09:60", "10:00")).into(), "slots/1/from", None),
        (schedule(slot("009:00", "10:00")).into(), "slots/1/from", None),
        (schedule(slot("09:00", "24:01")).into(), "slots/1/to", None),
        (schedule(slot("09:00", "09:00")).into(), "slots/1/to", None),
        (schedule(slot("09:00", once)).into(), "slots/1/to", None),
        (schedule(slot(once, "10:00")).into(), "slots/1/to", None),
        (schedule(slot(once, once)).into(), "slots/1/to", None),
        (schedule(slot("2026-11-31T09:00:00Z", "2026-12-23T09:00:00Z")).into(), "slots/1/from", None),
        (schedule(slot(once, end).with("days", vec!["mon".into()])).into(), "slots/1/days", None),
        (schedule(slot("09:00", "10:00").with("days", vec!["man".into()])).into(), "slots/1/days", Some("mon")),
        (schedule(slot("09:00", "10:00").with("days", Vec::<Value>::new())).into(), "slots/1/days", None),
        (schedule(slot("09:00", "10:00").with("users", Vec::<Value>::new())).into(), "slots/1/users", None),
        (schedule(slot("09:00", "10:00").with("usres", vec!["x".into()])).into(), "slots/1/usres", Some("users")),
        (schedule(slot("09:00", "10:00")).with("free", "maybe").into(), "free", None),
        (of("quota").into(), "limits", None),
        (of("quota").with("limits", Vec::<Value>::new()).into(), "limits", None),
        (quota(Map::new()).into(), "limits/0/parcels", None),
        (quota(Map::new().with("parcels", 0)).into(), "limits/0/parcels", None),
        (quota(Map::new().with("parcels", 1).with("burst", 0)).into(), "limits/0/burst", None),
        (quota(Map::new().with("bytes", i64::MAX)).into(), "limits/0/bytes", None),
        (quota(Map::new().with("parcels", 1).with("bytes-burst", 1)).into(), "limits/0/bytes-burst", None),
        (quota(Map::new().with("parcels", 1).with("verbs", vec!["stop".into()])).into(), "limits/0/verbs", None),
        (quota(Map::new().with("parcels", 1).with("verbs", vec!["leave".into()])).into(), "limits/0/verbs", None),
        (quota(Map::new().with("parcels", 1).with("groups", Vec::<Value>::new())).into(), "limits/0/groups", None),
    ]
}

#[test]
fn what_is_wrong_is_told_with_its_key() {
    let bad = wrong_tokens_and_chairs()
        .into_iter()
        .chain(wrong_slots_and_limits());
    let bad = bad.map(|(spec, slot, nearest)| (spec, Code::BAD_CONTENT, slot, nearest));
    for (spec, code, slot, nearest) in wrong().into_iter().chain(bad) {
        let error = registry().build(&spec).expect_err("it is wrong");
        let found = |key: &str| error.get(key).and_then(Value::as_str);
        assert_eq!(error.code, code, "{spec:?}: {error}");
        assert_eq!(found("slot").unwrap_or_default(), slot, "{spec:?}: {error}");
        assert_eq!(found("nearest"), nearest, "{spec:?}: {error}");
    }
}

#[test]
fn names_that_contain_themselves_end() {
    for name in ["ring", "ping"] {
        let error = registry().build(&name.into()).expect_err("it has no end");
        assert!(error.text.contains("contain each other"), "{error}");
    }
}

#[test]
fn a_named_manager_is_known_by_its_name() {
    // One that is another's name is known by the name it stands for.
    for name in ["staff", "again"] {
        let mut manager = registry().build(&name.into()).unwrap();
        assert_eq!(short(&ask(&mut *manager, &GRAB)), "staff: denied");
        let higher = super::Ask { level: 2, ..GRAB };
        assert_eq!(short(&ask(&mut *manager, &higher)), "allow");
    }
    assert_eq!(
        registry().names().collect::<Vec<_>>(),
        ["again", "ping", "pong", "ring", "staff"]
    );
}

#[test]
fn the_kinds_are_known_and_more_can_be_added() {
    let mut registry = Registry::builtin();
    let built_in = [
        "chain",
        "closed",
        "first-come",
        "level-or-lease",
        "moderated",
        "open",
        "queue",
        "quota",
        "roles",
        "schedule",
        "self",
        "zones",
    ];
    assert_eq!(registry.kinds().collect::<Vec<_>>(), built_in);
    registry.add_kind("mine", |setup| setup.inner("as", &"open".into()));
    assert!(registry.kinds().any(|kind| kind == "mine"));
    assert!(registry.build(&"mine".into()).is_ok());
}

#[test]
fn too_much_of_a_kind_is_refused() {
    let many = |key: &str, item: Map, count: usize| -> Value {
        let items: Vec<Value> = std::iter::repeat_n(item.into(), count).collect();
        let kind = if key == "slots" { "schedule" } else { "quota" };
        of(kind).with(key, items).into()
    };
    let slot = || Map::new().with("from", "09:00").with("to", "10:00");
    let limit = || Map::new().with("parcels", 1);
    for (key, item, most) in [("slots", slot(), 1024), ("limits", limit(), 64)] {
        assert!(registry().build(&many(key, item.clone(), most)).is_ok());
        let error = registry()
            .build(&many(key, item, most + 1))
            .expect_err("one too many");
        assert_eq!(error.get("slot").and_then(Value::as_str), Some(key));
    }
}
