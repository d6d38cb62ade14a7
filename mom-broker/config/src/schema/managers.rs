//! The kinds of manager with their parameters.

use mom_managers::Registry;
use mom_proto::Verb;
use serde_json::{Map, Value, json};

use super::{flag, list, millis, names, number, table, text, with_default, words};

/// `manager`, one definition for each kind, and what they share.
///
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
            "Rules in order: the first that covers a request decides; a request that none covers is denied.",
            json!({ "rules": list("The rules, in order.", rule()) }),
            &["rules"],
        ),
        "first-come" => (
            "The peer that grabs a free token keeps it until it releases it.",
            json!({ "lease": lease(), "expiry": expiry() }),
            &[],
        ),
        "level-or-lease" => (
            "A higher level takes the token at once, anybody after the lease.",
            level_or_lease(),
            &[],
        ),
        "queue" => (
            "A token goes from one peer to the next, in the order of asking.",
            queue(),
            &[],
        ),
        "moderated" => ("A chair has to approve.", moderated(), &["chairs"]),
        "schedule" => ("Reserved slots of the calendar.", schedule(), &["slots"]),
        "quota" => ("Limits how often and how much, by peer.", quota(), &["limits"]),
        "self" => (
            "The peer that created the context decides.",
            json!({
                "verbs": verbs_for("The verbs that it is asked about; absent = all."),
                "within": with_default(within("Its silence"), 5_000),
            }),
            &[],
        ),
        "zones" => (
            "Boxes in space with a token each, of which no two that overlap have different owners.",
            json!({ "zones": list("The zones.", zone()) }),
            &["zones"],
        ),
        "chain" => (
            "Several managers that all have to allow; the first refusal is the answer.",
            json!({ "of": list("The managers, in order.", json!({ "$ref": "#/definitions/manager" })) }),
            &["of"],
        ),
        _ => return None,
    })
}

fn zone() -> Value {
    let corner = |description: &str| {
        let mut corner = list(description, json!({ "type": "number" }));
        corner["minItems"] = json!(3);
        corner["maxItems"] = json!(3);
        corner
    };
    let properties = json!({
        "token": text("The path of its token."),
        "from": corner("The box's corner with the smaller x, y and z."),
        "to": corner("The opposite corner."),
    });
    table("A zone.", &properties, &["token", "from", "to"])
}

fn rule() -> Value {
    let mut properties = json!({
        "name": text("The rule's name in answers; absent = its number."),
        "allow": verbs_for("The verbs that it allows; * stands for all. Either this or deny."),
        "deny": verbs_for("The verbs that it refuses; * stands for all. Either this or allow."),
        "where": names("Patterns of paths: /robot/arm, /camera/* (one level), /robot/** (the context and all below); absent = everywhere."),
        "messages": names("Names of messages, for send; absent = all."),
        "invited": flag("Only peers that a member has invited lately, or only the others; absent = both."),
        "max-age": millis("Messages whose age plus error is greater are refused, in ms; with allow only; absent = any age."),
        "priority": json!({
            "description": "The highest priority of messages that no token guards: a higher one becomes this; with allow only; absent = 0.",
            "type": "integer",
            "minimum": -100,
            "maximum": 100,
        }),
    });
    add(&mut properties, peers());
    table("A rule.", &properties, &[])
}

fn level_or_lease() -> Value {
    let mut properties = terms();
    add(
        &mut properties,
        json!({
            "lease": with_default(lease(), 180_000),
            "equal": with_default(flag("Whether an equal level takes the token, too."), false),
            "queue": flag("Whether a refused grab may be queued; absent = if there is hold."),
        }),
    );
    properties
}

fn queue() -> Value {
    let mut properties = terms();
    add(&mut properties, json!({ "lease": lease() }));
    properties
}

fn moderated() -> Value {
    json!({
        "chairs": table("The chairs; at least one key. They need no approval themselves.", &peers(), &[]),
        "verbs": verbs_for("The moderated verbs; absent = grab, accept, inhibit."),
        "messages": names("For send, only messages of these names; absent = all."),
        "within": with_default(within("Nobody's answer"), 30_000),
        "displace": with_default(flag("Whether an approved grab takes the token from its owner, whatever its lease."), false),
    })
}

fn schedule() -> Value {
    let day = json!({ "type": "string", "enum": ["mon", "tue", "wed", "thu", "fri", "sat", "sun"] });
    let mut slot = json!({
        "name": text("The slot's name in answers; absent = its number."),
        "from": text("A time of the day such as 09:00, or an instant such as 2026-11-23T09:00:00Z; UTC."),
        "to": text("The end, exclusive, in the same form as from. A time of the day before from is on the next day."),
        "days": list("The days on which a daily slot begins; absent = every day.", day),
    });
    add(&mut slot, peers());
    json!({
        "slots": list("The slots.", table("A slot.", &slot, &["from", "to"])),
        "free": with_default(words("What holds where no slot is.", &["allow", "deny"]), "allow"),
        "verbs": verbs_for("The reserved verbs; absent = grab, accept, inhibit."),
    })
}

fn quota() -> Value {
    let mut limit = json!({
        "name": text("The limit's name in answers; absent = its number."),
        "verbs": verbs_for("The counted verbs, all together; absent = send."),
        "parcels": number("Parcels per second; absent = unlimited."),
        "burst": number("Parcels at once; absent = those of one second."),
        "bytes": number("Bytes of content per second; absent = unlimited."),
        "bytes-burst": number("Bytes at once, and nothing larger passes; absent = those of one second."),
    });
    add(&mut limit, peers());
    json!({ "limits": list("The first limit that covers the peer and the verb applies.", table("A limit.", &limit, &[])) })
}

/// The keys that select peers.
fn peers() -> Value {
    json!({
        "users": names("The user is among these …"),
        "groups": names("… or in one of these groups; with neither anybody."),
        "min-level": number("And the user's level is at least this."),
    })
}

/// The terms of a token.
fn terms() -> Value {
    json!({
        "expiry": expiry(),
        "deadman": millis("The owner loses the token when it neither renews nor grabs for so long, in ms."),
        "hold": millis("The longest ownership while others wait, in ms."),
        "notice": with_default(
            number("The least time that an owner keeps the token after another peer has begun to wait, in ms."),
            10_000
        ),
    })
}

fn lease() -> Value {
    millis("How long ownership lasts without renewal, in ms; absent = unlimited.")
}

fn expiry() -> Value {
    let description =
        "At the end of the lease the token is lost at once (eager), or at the next grab (lazy).";
    with_default(words(description, &["lazy", "eager"]), "lazy")
}

fn within(silence: &str) -> Value {
    let description = format!("How long an answer may take, in ms. {silence} is a no.");
    millis(&description)
}

fn verbs_for(description: &str) -> Value {
    json!({ "description": description, "$ref": "#/definitions/verbs" })
}

fn add(properties: &mut Value, more: Value) {
    if let (Value::Object(properties), Value::Object(more)) = (properties, more) {
        properties.extend(more);
    }
}
