//! The kinds of manager with their parameters.

use mom_managers::Registry;
use mom_proto::Verb;
use serde_json::{Map, Value, json};

use super::{flag, list, millis, names, number, table, text, with_default, words};

/// `manager`, one definition for each kind, and what they share.
///
/// Only of kinds that the hub has: what is described here and is not there would be completed and then refused.
pub(super) fn definitions() -> Map<String, Value> {
    let registry = Registry::builtin();
    let mut all = Map::new();
    let mut any = vec![text(
        "The name of a manager, or of a kind that needs no parameters.",
    )];
    for kind in registry.kinds() {
        let Some((description, parameters, required)) = parameters(kind) else {
            continue;
        };
        let mut properties = Map::new();
        properties.insert("kind".to_owned(), words(description, &[kind]));
        if let Value::Object(parameters) = parameters {
            properties.extend(parameters);
        }
        let required: Vec<&str> = std::iter::once("kind").chain(required.iter().copied()).collect();
        all.insert(kind.to_owned(), table(description, &properties.into(), &required));
        any.push(json!({ "$ref": format!("#/definitions/{kind}") }));
    }
    all.insert(
        "manager".to_owned(),
        json!({ "description": "A manager: a name, or its kind and parameters.", "anyOf": any }),
    );
    all.insert("verbs".to_owned(), verbs());
    all
}

fn verbs() -> Value {
    let mut known = vec!["*"];
    known.extend(Verb::ALL.iter().map(|verb| verb.word()));
    json!({ "type": "array", "items": { "type": "string", "enum": known } })
}

/// What a kind is, its parameters, and those that it needs.
fn parameters(kind: &str) -> Option<(&'static str, Value, &'static [&'static str])> {
    Some(match kind {
        "open" => ("Everybody may do everything.", json!({}), &[]),
        "closed" => ("Nobody may do anything.", json!({}), &[]),
        "roles" => (
            "Rules, asked in order: the first that covers a request decides, and no rule is a refusal.",
            json!({ "rules": list("The rules, in order.", rule()) }),
            &["rules"],
        ),
        "first-come" => (
            "Whoever grabs a free token keeps it until giving it back.",
            json!({ "lease": millis("How long without renewal, in ms; absent = without end."), "expiry": expiry() }),
            &[],
        ),
        "level-or-lease" => (
            "A higher level takes the token at once, anybody after the lease.",
            level_or_lease(),
            &[],
        ),
        "chain" => (
            "Several managers that all have to allow; the first refusal is the answer.",
            json!({ "of": list("The managers, in order.", json!({ "$ref": "#/definitions/manager" })) }),
            &["of"],
        ),
        "queue" => ("Whoever waits gets the token in turn.", queue(), &[]),
        "moderated" => (
            "Chairs are asked before what they moderate is allowed.",
            moderated(),
            &["chairs"],
        ),
        "schedule" => (
            "Who may when: slots of time that belong to users or groups.",
            schedule(),
            &["slots"],
        ),
        "quota" => ("How much may be sent, by level.", quota(), &["limits"]),
        "self" => (
            "The peer that made the context answers for it.",
            json!({ "within": within(), "verbs": verbs_for("The verbs about which it is asked.") }),
            &[],
        ),
        _ => return None,
    })
}

fn rule() -> Value {
    let properties = json!({
        "name": text("What an answer calls the rule; absent = its number."),
        "allow": verbs_for("The verbs that it allows; * stands for all."),
        "deny": verbs_for("The verbs that it refuses; * stands for all."),
        "users": names("It is for these users …"),
        "groups": names("… or for users in one of these groups; neither = everybody."),
        "min-level": number("It is for users of at least this level."),
        "where": names("Patterns of paths: /robot/arm, /camera/* (one level), /robot/** (the place and all below); absent = everywhere."),
        "messages": names("Names of messages, for send; absent = all."),
    });
    table("A rule.", &properties, &[])
}

fn level_or_lease() -> Value {
    json!({
        "lease": with_default(millis("How long without renewal, in ms."), 180_000),
        "expiry": expiry(),
    })
}

fn queue() -> Value {
    json!({
        "lease": millis("How long without renewal, in ms."),
        "expiry": expiry(),
        "deadman": deadman(),
        "hold": millis("The longest ownership while others wait, in ms."),
        "notice": millis("How long an owner keeps the token at least once the first begins to wait, in ms."),
    })
}

fn moderated() -> Value {
    let chairs = json!({
        "users": names("These users …"),
        "groups": names("… or users in one of these groups."),
        "min-level": number("Of at least this level."),
    });
    json!({
        "chairs": table("Who is asked.", &chairs, &[]),
        "verbs": verbs_for("The verbs about which they are asked."),
        "within": within(),
        "messages": names("The messages about which they are asked, for send; absent = all."),
        "displace": flag("Whether a grab that they allow takes the token from its owner."),
    })
}

fn schedule() -> Value {
    let day = json!({ "type": "string", "enum": ["mon", "tue", "wed", "thu", "fri", "sat", "sun"] });
    let slot = json!({
        "from": text("When it begins, such as 08:00, UTC."),
        "to": text("When it ends, such as 12:30, UTC."),
        "users": names("It belongs to these users …"),
        "groups": names("… and to users in one of these groups."),
        "days": list("The days of the week; absent = every day.", day),
    });
    json!({
        "slots": list("The slots.", table("A slot of time.", &slot, &["from", "to"])),
        "free": flag("Whether anybody may outside all slots."),
        "verbs": verbs_for("The verbs that it is about."),
    })
}

fn quota() -> Value {
    let limit = json!({
        "min-level": number("It is for users of at least this level."),
        "parcels": number("Parcels per second."),
        "burst": number("Parcels at once."),
        "bytes": number("Bytes per second."),
        "bytes-burst": number("Bytes at once."),
        "verbs": verbs_for("The verbs that it is about."),
    });
    json!({ "limits": list("The limits.", table("How much a user may send.", &limit, &[])) })
}

fn expiry() -> Value {
    let description = "At the end of the lease lost at once (eager), or at the next grab (lazy).";
    with_default(words(description, &["lazy", "eager"]), "lazy")
}

fn deadman() -> Value {
    millis("The owner loses the token if it does not renew for so long, in ms.")
}

fn within() -> Value {
    millis("How long an answer may take, in ms; after that the request is refused.")
}

fn verbs_for(description: &str) -> Value {
    json!({ "description": description, "$ref": "#/definitions/verbs" })
}
