//! The shape of the configuration and users files as JSON schema, so that editors complete and check them.
//!
//! Written by hand, because descriptions are for people; a test holds its keys equal to those that the parser
//! takes. Draft 4 is what editors' TOML plugins understand.

mod audit;
mod contexts;
mod login;
mod managers;
#[cfg(test)]
mod tests;

use mom_net::{Protocol, TlsUse};
use mom_proto::to_value;
use serde_json::{Map, Value, json};

use crate::Config;

const DRAFT: &str = "http://json-schema.org/draft-04/schema#";

/// The schema of the configuration file.
pub fn config_schema() -> Value {
    let default = Config::default();
    let addresses: Vec<&str> = default.listen.iter().map(|listen| &*listen.address).collect();
    let mut definitions = managers::definitions();
    definitions.insert("context".to_owned(), contexts::context());
    let properties = json!({
        "listen": {
            "description": "The addresses to listen at. All that a listener takes shares its port.",
            "type": "array", "items": listen(),
            "minItems": 1, "default": addresses
        },
        "tls": table(
            "The certificate that the hub shows. XML and binary with TLS share the port with those without.",
            &json!({
                "certificate": text("The certificate in PEM, those that signed it behind it; relative to this file. Read again when it changes."),
                "key": text("Its key in PEM, relative to this file."),
                "self-signed": with_default(flag("Make both files where they are not there; clients know the hub by its fingerprint then."), false),
                "hosts": { "description": "The names and addresses of this hub, for the certificate that is made.", "type": "array", "items": text("A name or an address."), "default": ["localhost"] }
            }),
            &[]
        ),
        "web": web(),
        "connections": with_default(positive("Connections at once; one more is told too-many-connections."), default.connections),
        "connections-before-login": positive("Of them, those that have not logged in; absent = a quarter. One more closes the oldest."),
        "connections-per-address": positive("Of these, those from one address; absent = a quarter. One more closes the oldest of that address."),
        "connections-per-user": positive("Connections of one user; absent = a quarter of all. A login more is told too-many-connections."),
        "memory": positive("Bytes that may wait or be kept in the whole hub; absent = a quarter of the machine's memory."),
        "log": with_default(text("What to log: error, warn, info, debug, trace, or filters such as info,mom_broker=debug."), &default.log),
        "reload": with_default(
            words("When this file and the users file are read again: when one of them has changed, or only at SIGHUP.", &["change", "signal"]),
            "change"
        ),
        "users": text("The users file, relative to this one. Without it there are no users."),
        "root": {
            "description": "The manager of the root, which also decides wherever no other manager is nearer.",
            "$ref": "#/definitions/manager"
        },
        "limits": limits(),
        "login": login::login(),
        "store": table(
            "The store of token owners and fences, which outlives the broker.",
            &json!({
                "path": text("A directory of this broker's own, relative to this file; absent = only the epoch of fences outlives it."),
                "state": text("Without path: the directory of the number by which fences rise over restarts; absent = $STATE_DIRECTORY, $XDG_STATE_HOME/mom or ~/.local/state/mom.")
            }),
            &[]
        ),
        "audit": audit::audit(),
        "record": audit::record(),
        "managers": {
            "description": "Named managers, for the root, for contexts and for each other.",
            "type": "object", "additionalProperties": { "$ref": "#/definitions/manager" }
        },
        "contexts": {
            "description": "Permanent contexts, parents first.",
            "type": "array", "items": { "$ref": "#/definitions/context" }
        },
    });
    let mut schema = table("The configuration of a MOM broker.", &properties, &[]);
    document(&mut schema, "MOM broker configuration");
    schema["definitions"] = definitions.into();
    schema
}

fn web() -> Value {
    table(
        "What HTTP may ask.",
        &json!({
            "origins": with_default(names("Where pages come from that may use the hub, such as https://lab.example.org; those that the hub itself serves may."), json!([])),
            "console": with_default(flag("Whether the console is served to browsers, if it was built into the broker."), true),
            "log": text("The channel in which the hub says what programs report of their errors by POST /log; absent = nothing is taken."),
            "metrics-token": text("A file with the token that /metrics is shown for, 16 characters at least; relative to this file."),
            "forwarded-by": with_default(names("The addresses or networks of proxies that are believed what their header Forwarded says of clients."), json!([]))
        }),
        &[],
    )
}

fn listen() -> Value {
    let doors = Protocol::ALL.map(Protocol::word);
    let mut takes = list(
        "The ways in that are open; absent = all.",
        words("A way in.", &doors),
    );
    takes["minItems"] = 1.into();
    let entry = json!({
        "address": text("The address with its port, such as 127.0.0.1:7666."),
        "takes": takes,
        "tls": with_default(words("Whether connections have TLS.", &TlsUse::WORDS), "allowed"),
        "proxy": names("The addresses or networks of proxies that begin each connection with a PROXY protocol header, such as 10.0.0.0/8."),
    });
    let description = "A listener: its address, what it takes, and the proxies before it.";
    json!({
        "description": "An address with its port, or a table with more.",
        "anyOf": [
            text("An address with its port, such as 127.0.0.1:7666."),
            table(description, &entry, &["address"])
        ]
    })
}

/// The schema of the users file.
pub fn users_schema() -> Value {
    let any = |description: &str| json!({ "description": description, "type": "object" });
    let user = json!({
        "name": text("The user's name."),
        "password": text("The argon2id hash of the password, as mom-broker passwd writes it."),
        "certificates": names("Fingerprints of certificates, as openssl x509 -fingerprint -sha256 prints them, or sha256: and 64 digits."),
        "keys": names("Public keys, as mom keygen writes them: ed25519 BASE64 and a comment."),
        "level": with_default(number("The authority level; higher is more."), 0),
        "groups": names("The groups that the user is in."),
        "preferences": any("The user's preferences; returned at login."),
        "personal": any("Personal information; returned at login."),
    });
    let users = json!({
        "users": {
            "description": "The users: people, devices, servers, agents.",
            "type": "array",
            "items": table("A user.", &user, &["name"])
        }
    });
    let mut schema = table("The users of a MOM broker.", &users, &[]);
    document(&mut schema, "MOM users");
    schema
}

fn document(schema: &mut Value, title: &str) {
    let Value::Object(keys) = schema else { return };
    let mut all = Map::new();
    all.insert("$schema".to_owned(), DRAFT.into());
    all.insert("title".to_owned(), title.into());
    all.append(keys);
    *keys = all;
}

fn limits() -> Value {
    let defaults = to_value(&mom_proto::Limits::default()).unwrap_or_default();
    let mut properties = Map::new();
    for (key, description) in [
        (
            "parcel",
            "One parcel with its headers and parts, in bytes, or unlimited.",
        ),
        ("slots", "All slots of one parcel but its content, in bytes."),
        ("control", "The content of other parcels than messages, in bytes."),
        ("depth", "Lists and maps inside each other."),
        ("attributes", "Attributes of one XML element."),
        ("attribute-size", "One XML attribute, in bytes."),
        ("path", "A path's text, in bytes."),
        ("path-levels", "A path's segments."),
        (
            "header",
            "The header lines before an XML entity, and of each part, in bytes.",
        ),
        ("parts", "Parts of one multipart entity."),
        ("before-login", "One parcel before login, in bytes."),
        ("login-time", "From connection to login, in ms."),
        ("outbox", "The parcels that wait for one peer, in bytes."),
        (
            "burst",
            "As many may wait for one peer for a while (stalled) if they may not be dropped, in bytes.",
        ),
        (
            "send-wait",
            "How long a sender waits for a receiver without capacity, in channels with overflow = wait, in ms.",
        ),
        (
            "stalled",
            "A receiver that stays behind outbox for so long is closed, as is one that frees no capacity for so long while senders wait for it, in ms.",
        ),
        ("heartbeat", "How often an idle peer sends time ping, in ms."),
        (
            "gone",
            "A peer that sends nothing for so long is closed as silent, in ms; longer than heartbeat.",
        ),
        (
            "grace",
            "The longest that a peer with a link may be away after it has lost its connection, in ms; 0 lets nobody come back.",
        ),
        (
            "future",
            "How far ahead the timestamp of a message may be, beyond the error of its sender's clock, in ms.",
        ),
        ("contexts", "Contexts in the whole tree, or unlimited."),
        (
            "user-contexts",
            "Contexts of the tree that peers of one user have made, or unlimited.",
        ),
        ("joined", "Contexts that one peer may have joined, or unlimited."),
        (
            "requests",
            "Requests about contexts and tokens per second and connection, or unlimited.",
        ),
    ] {
        let shape = match key {
            "parcel" | "contexts" | "user-contexts" | "joined" | "requests" => json!({
                "description": description,
                "anyOf": [{ "type": "integer", "minimum": 1 }, { "enum": ["unlimited"] }]
            }),
            _ => positive(description),
        };
        let default = defaults.get(key).and_then(mom_proto::Value::as_int);
        properties.insert(key.to_owned(), with_default(shape, default));
    }
    let description = "The hub's limits; sizes in bytes, times in ms.";
    table(description, &properties.into(), &[])
}

/// A table with these keys and no others.
fn table(description: &str, properties: &Value, required: &[&str]) -> Value {
    let mut schema = json!({
        "description": description, "type": "object", "additionalProperties": false, "properties": properties
    });
    if !required.is_empty() {
        schema["required"] = json!(required);
    }
    schema
}

fn text(description: &str) -> Value {
    json!({ "description": description, "type": "string" })
}

fn number(description: &str) -> Value {
    json!({ "description": description, "type": "integer" })
}

fn positive(description: &str) -> Value {
    json!({ "description": description, "type": "integer", "minimum": 1 })
}

fn flag(description: &str) -> Value {
    json!({ "description": description, "type": "boolean" })
}

fn names(description: &str) -> Value {
    json!({ "description": description, "type": "array", "items": { "type": "string" } })
}

/// A duration in ms.
fn millis(description: &str) -> Value {
    positive(description)
}

/// One of some words.
fn words(description: &str, words: &[&str]) -> Value {
    json!({ "description": description, "type": "string", "enum": words })
}

fn list(description: &str, items: Value) -> Value {
    let mut schema = json!({ "description": description, "type": "array" });
    schema["items"] = items;
    schema
}

fn with_default(mut schema: Value, default: impl serde::Serialize) -> Value {
    if let Ok(default) = serde_json::to_value(default)
        && !default.is_null()
    {
        schema["default"] = default;
    }
    schema
}
