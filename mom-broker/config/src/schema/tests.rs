//! The schema says what the parser takes: the same keys, and nothing else.

use std::collections::BTreeSet;

use serde_json::{Value, json};

use super::{config_schema, users_schema};
use crate::load::parser_error;
use crate::source::SourceText;
use crate::{ConfigError, shape, users};

#[test]
fn they_refuse_what_the_parser_refuses() {
    let schema = config_schema();
    for (file, key) in [
        (json!({ "listne": [] }), "listne"),
        (json!({ "reload": "never" }), "reload"),
        (json!({ "limits": { "parcel": "endless" } }), "limits.parcel"),
        (
            json!({ "managers": { "lab": { "kind": "role" } } }),
            "managers.lab.kind",
        ),
        (
            json!({ "managers": { "lab": { "kind": "roles", "rules": [{ "allow": ["jion"] }] } } }),
            "managers.lab.rules[0].allow[0]",
        ),
        (json!({ "contexts": [{ "path": "/a" }] }), "contexts[0].kind"),
        (
            json!({ "contexts": [{ "path": "/a", "kind": "chanel" }] }),
            "contexts[0].kind",
        ),
    ] {
        let text = toml::to_string(&file).expect("TOML");
        let found = shape::faults(&schema, &SourceText::new("mom.toml", &*text));
        let told = |fault: &ConfigError| fault.key.as_deref() == Some(key);
        assert!(found.iter().any(told), "{file}: {found:?}");
        assert!(parser_error(&text).is_some(), "the parser takes {text}");
    }
}

/// Every table of the schema against the list that the parser gives for a key that it does not know.
#[test]
fn they_have_the_keys_that_the_parser_knows() {
    let schema = config_schema();
    let mut seen = BTreeSet::new();
    let mut config = |value: Value| {
        let text = toml::to_string(&value).expect("TOML");
        parser_error(&text).expect("an unknown key is refused")
    };
    visit(&schema, &schema, "", &|inner| inner, &mut config, &mut seen);
    let schema = users_schema();
    let mut users = |value: Value| {
        let text = toml::to_string(&value).expect("TOML");
        users::parser_error(&text).expect("an unknown key is refused")
    };
    visit(&schema, &schema, "users", &|inner| inner, &mut users, &mut seen);
    for kind in mom_managers::Registry::builtin().kinds() {
        assert!(
            seen.contains(&format!("#/definitions/{kind}")),
            "{kind} has no schema"
        );
    }
    for table in ["", "/limits", "/login/jwt", "/contexts/0/guard", "users/users/0"] {
        assert!(seen.contains(table), "{table:?} was not looked at: {seen:?}");
    }
}

const UNKNOWN: &str = "nobody-knows-this";

/// Checks a schema's table by giving the parser a key that is not there, and goes into all its keys. `wrap` puts a
/// value where the schema is for.
fn visit(
    root: &Value,
    schema: &Value,
    place: &str,
    wrap: &dyn Fn(Value) -> Value,
    parse: &mut dyn FnMut(Value) -> String,
    seen: &mut BTreeSet<String>,
) {
    if let Some(definition) = schema["$ref"].as_str() {
        if seen.insert(definition.to_owned()) {
            visit(root, resolve(root, schema), place, wrap, parse, seen);
        }
        return;
    }
    for one in schema["anyOf"].as_array().into_iter().flatten() {
        visit(root, one, place, wrap, parse, seen);
    }
    if schema["items"].is_object() {
        let in_list = |inner| wrap(json!([inner]));
        let place = format!("{place}/0");
        visit(root, &schema["items"], &place, &in_list, parse, seen);
    }
    if schema["additionalProperties"].is_object() {
        let named = |inner| wrap(json!({ "x": inner }));
        visit(root, &schema["additionalProperties"], place, &named, parse, seen);
    }
    let Some(properties) = schema["properties"].as_object() else {
        return;
    };
    seen.insert(place.to_owned());
    // A manager is read after its kind is known.
    let kind = &properties.get("kind").unwrap_or(&Value::Null)["enum"];
    let kind = kind
        .as_array()
        .filter(|kinds| kinds.len() == 1)
        .map(|kinds| &kinds[0]);
    let table = |key: &str, inner: Value| match kind {
        Some(kind) => wrap(json!({ "kind": kind, key: inner })),
        None => wrap(json!({ key: inner })),
    };
    let error = parse(table(UNKNOWN, json!(1)));
    let keys: BTreeSet<String> = properties.keys().cloned().collect();
    let mut known = known_keys(&error);
    if kind.is_some() {
        known.insert("kind".to_owned());
    }
    assert_eq!(keys, known, "keys of {place:?}: {error}");
    for (key, inner) in properties {
        assert!(inner["description"].is_string(), "{place}/{key} is not described");
        let in_table = |inner| table(key, inner);
        visit(root, inner, &format!("{place}/{key}"), &in_table, parse, seen);
    }
}

fn resolve<'a>(root: &'a Value, schema: &'a Value) -> &'a Value {
    match schema["$ref"].as_str() {
        Some(definition) => root
            .pointer(definition.trim_start_matches('#'))
            .expect("a definition that is there"),
        None => schema,
    }
}

/// The keys that an error about an unknown key lists.
fn known_keys(error: &str) -> BTreeSet<String> {
    assert!(error.contains(UNKNOWN), "an error about the key: {error}");
    // From the parser of values a list, from that of files words in backticks.
    if let Some((_, list)) = error.split_once("known are ") {
        let list = list.split(" (did you mean").next().unwrap_or_default();
        return list.split(", ").map(str::to_owned).collect();
    }
    let listed = error.split_once(", expected ").map_or("", |(_, list)| list);
    listed.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}
