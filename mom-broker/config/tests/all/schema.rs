//! The schemas for editors say what the parser takes: the same keys, the shipped files, nothing else.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use mom_config::{Config, config_schema, users_schema};
use serde_json::{Value, json};
use tempfile::TempDir;

fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../config")
        .join(name)
}

#[test]
fn the_shipped_schemas_are_those_of_the_code() {
    for (schema, file, command) in [
        (config_schema(), "mom.schema.json", "mom-broker schema"),
        (users_schema(), "users.schema.json", "mom-broker schema --users"),
    ] {
        let text = serde_json::to_string_pretty(&schema).expect("JSON") + "\n";
        let known = fs::read_to_string(shipped(file)).unwrap_or_default();
        assert!(
            known == text,
            "config/{file} is old; run: {command} > config/{file}"
        );
    }
}

#[test]
fn the_shipped_files_follow_them() {
    for (file, schema) in [
        ("mom.toml", config_schema()),
        ("lab.toml", config_schema()),
        ("lab-users.toml", users_schema()),
    ] {
        let text = fs::read_to_string(shipped(file)).expect("readable");
        let name = if file.contains("users") { "users" } else { "mom" };
        assert!(
            text.starts_with(&format!("#:schema {name}.schema.json\n")),
            "editors find the schema of {file}"
        );
        let value: Value = toml::from_str(&text).expect("TOML");
        assert_eq!(
            faults(&schema, &schema, &value, ""),
            Vec::<String>::new(),
            "{file}"
        );
    }
}

#[test]
fn they_refuse_what_the_parser_refuses() {
    let schema = config_schema();
    for (file, words) in [
        (json!({ "listne": [] }), "/listne"),
        (json!({ "listen": [] }), "/listen"),
        (json!({ "connections": 0 }), "/connections"),
        (json!({ "reload": "never" }), "/reload"),
        (json!({ "limits": { "parcel": "endless" } }), "/limits/parcel"),
        (
            json!({ "managers": { "lab": { "kind": "role" } } }),
            "/managers/lab",
        ),
        (
            json!({ "managers": { "lab": { "kind": "roles", "rules": [{ "allow": ["jion"] }] } } }),
            "/managers/lab",
        ),
        (json!({ "contexts": [{ "path": "/a" }] }), "/contexts/0"),
        (
            json!({ "contexts": [{ "path": "/a", "kind": "chanel" }] }),
            "/contexts/0/kind",
        ),
    ] {
        let found = faults(&schema, &schema, &file, "");
        assert!(
            found.iter().any(|fault| fault.starts_with(words)),
            "{file}: {found:?}"
        );
        let text = toml::to_string(&file).expect("TOML");
        assert!(parse_error(&text, None).is_some(), "the parser takes {text}");
    }
}

/// Every table of the schema against the list that the parser gives for a key that it does not know.
#[test]
fn they_have_the_keys_that_the_parser_knows() {
    let schema = config_schema();
    let mut seen = BTreeSet::new();
    let mut config = |value: Value| {
        let text = toml::to_string(&value).expect("TOML");
        parse_error(&text, None).expect("an unknown key is refused")
    };
    visit(&schema, &schema, "", &|inner| inner, &mut config, &mut seen);
    let schema = users_schema();
    let mut users = |value: Value| {
        let text = toml::to_string(&value).expect("TOML");
        parse_error("users = \"users.toml\"\n", Some(&text)).expect("an unknown key is refused")
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

#[test]
fn every_key_is_documented() {
    let page = |name: &str| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../docs")
            .join(name);
        fs::read_to_string(path).expect("readable")
    };
    let pages = page("configuration.md") + &page("managers.md");
    let mut missing = Vec::new();
    for schema in [config_schema(), users_schema()] {
        collect_missing(&schema, &pages, &mut missing);
    }
    assert!(
        missing.is_empty(),
        "neither in docs/configuration.md nor in docs/managers.md: {missing:?}"
    );
}

fn collect_missing(schema: &Value, pages: &str, missing: &mut Vec<String>) {
    for key in schema["properties"]
        .as_object()
        .into_iter()
        .flatten()
        .map(|(key, _)| key)
    {
        // In backticks, as a table's head, or among the keys of a small map.
        let stands = ["`", "[", "{ ", ", "].iter().any(|before| {
            let mut ends = ["`", "]", ",", " }", ".NAME"].iter();
            ends.any(|after| pages.contains(&format!("{before}{key}{after}")))
        });
        if !stands {
            missing.push(key.clone());
        }
    }
    match schema {
        Value::Object(map) => map
            .values()
            .for_each(|inner| collect_missing(inner, pages, missing)),
        Value::Array(list) => list
            .iter()
            .for_each(|inner| collect_missing(inner, pages, missing)),
        _ => {}
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

fn parse_error(config: &str, users: Option<&str>) -> Option<String> {
    let folder = TempDir::new().expect("a folder");
    fs::write(folder.path().join("mom.toml"), config).expect("written");
    if let Some(users) = users {
        fs::write(folder.path().join("users.toml"), users).expect("written");
    }
    let loaded = Config::load(&folder.path().join("mom.toml"));
    loaded.err().map(|error| error.text)
}

/// Where a value does not follow a schema, as far as our schemas go.
fn faults(root: &Value, schema: &Value, value: &Value, place: &str) -> Vec<String> {
    let schema = resolve(root, schema);
    let mut found = Vec::new();
    let fault = |what: &str| format!("{place}: {what}");
    if let Some(any) = schema["anyOf"].as_array()
        && !any.iter().any(|one| faults(root, one, value, place).is_empty())
    {
        found.push(fault("fits nothing"));
    }
    let right_type = match schema["type"].as_str() {
        Some("string") => value.is_string(),
        Some("integer") => value.is_i64(),
        Some("boolean") => value.is_boolean(),
        Some("array") => value.is_array(),
        Some("object") => value.is_object(),
        _ => true,
    };
    if !right_type {
        found.push(fault("another type"));
    }
    if let Some(words) = schema["enum"].as_array()
        && !words.contains(value)
    {
        found.push(fault("none of the words"));
    }
    if let (Some(least), Some(number)) = (schema["minimum"].as_i64(), value.as_i64())
        && number < least
    {
        found.push(fault("too small"));
    }
    if let Some(list) = value.as_array() {
        if (list.len() as u64) < schema["minItems"].as_u64().unwrap_or_default() {
            found.push(fault("too few"));
        }
        let items = list.iter().enumerate().filter(|_| schema["items"].is_object());
        found.extend(
            items.flat_map(|(index, item)| faults(root, &schema["items"], item, &format!("{place}/{index}"))),
        );
    }
    if let Some(table) = value.as_object() {
        let required = schema["required"].as_array().into_iter().flatten();
        let missing = required
            .filter_map(Value::as_str)
            .filter(|key| !table.contains_key(*key));
        found.extend(missing.map(|key| fault(&format!("{key} is missing"))));
        for (key, inner) in table {
            let place = format!("{place}/{key}");
            match (&schema["properties"][key], &schema["additionalProperties"]) {
                (Value::Null, Value::Bool(false)) => found.push(format!("{place}: unknown")),
                (Value::Null, Value::Object(_)) => {
                    found.extend(faults(root, &schema["additionalProperties"], inner, &place));
                }
                (Value::Null, _) => {}
                (known, _) => found.extend(faults(root, known, inner, &place)),
            }
        }
    }
    found
}
