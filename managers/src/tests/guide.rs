//! The examples of the guide can be had as they stand.

use mom_proto::Value;

use crate::Registry;

const GUIDE: &str = include_str!("../../../docs/managers.md");

/// The blocks of a language.
fn blocks(language: &str) -> Vec<&'static str> {
    let fence = format!("```{language}\n");
    let blocks = GUIDE.split(fence.as_str()).skip(1);
    blocks.filter_map(|rest| rest.split("```").next()).collect()
}

#[test]
fn every_manager_of_the_guide_can_be_made() {
    let mut kinds = Vec::new();
    for block in blocks("toml") {
        let file: Value = toml::from_str(block).unwrap_or_else(|error| panic!("{error}: {block}"));
        let mut registry = Registry::builtin();
        // The names that the examples take as given.
        registry.define("lab", "open".into());
        let named = file
            .get("managers")
            .and_then(Value::as_map)
            .cloned()
            .unwrap_or_default();
        for (name, spec) in named.iter() {
            // What the worked example adds is in its own block of Rust.
            if spec.get("kind").and_then(Value::as_str) == Some("small-only") {
                continue;
            }
            registry.define(name, spec.clone());
            kinds.extend(spec.get("kind").and_then(Value::as_str).map(str::to_owned));
        }
        let contexts = file.get("contexts").and_then(Value::as_list).unwrap_or_default();
        let inline = contexts
            .iter()
            .filter_map(|context| context.get("manager").cloned());
        let names = named
            .iter()
            .filter(|(name, _)| registry.names().any(|known| known == *name));
        let specs: Vec<Value> = names.map(|(name, _)| name.into()).chain(inline).collect();
        for spec in specs {
            registry
                .build(&spec)
                .unwrap_or_else(|error| panic!("{error}: {block}"));
        }
    }
    for kind in Registry::builtin()
        .kinds()
        .filter(|kind| !["open", "closed"].contains(kind))
    {
        assert!(
            kinds.iter().any(|shown| shown == kind),
            "the guide has no example of {kind}"
        );
    }
}

#[test]
fn every_kind_and_verb_has_its_place_in_the_guide() {
    for kind in Registry::builtin().kinds() {
        assert!(GUIDE.contains(&format!("\n### `{kind}`\n")), "{kind}");
    }
    for verb in mom_proto::Verb::ALL {
        assert!(GUIDE.contains(&format!("| `{verb}` |")), "{verb} has no row");
    }
}
