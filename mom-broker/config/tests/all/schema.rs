//! The schemas for editors: the shipped ones are those of the code, and every key is documented.

use std::fs;
use std::path::{Path, PathBuf};

use mom_config::{config_schema, users_schema};
use serde_json::Value;

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
fn editors_find_them() {
    for file in ["mom.toml", "lab.toml", "lab-users.toml"] {
        let text = fs::read_to_string(shipped(file)).expect("readable");
        let name = if file.contains("users") { "users" } else { "mom" };
        assert!(
            text.starts_with(&format!("#:schema {name}.schema.json\n")),
            "editors find the schema of {file}"
        );
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
