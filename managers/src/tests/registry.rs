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
        (of("chain").with("of", Vec::<Value>::new()).into(), &bad, "of", None),
        (chain("opne".into()).into(), &unknown, "of/1/kind", Some("open")),
        (chain(of("level-or-lease").with("lease", 0).into()).into(), &bad, "of/1/lease", None),
    ];
    table.into_iter().map(|(spec, code, slot, nearest)| (spec, code.clone(), slot, nearest)).collect()
}

#[test]
fn what_is_wrong_is_told_with_its_key() {
    for (spec, code, slot, nearest) in wrong() {
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
