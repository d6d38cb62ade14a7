//! An entry of `[[contexts]]`.

use mom_proto::{ContextKind, Delivery, Overflow};
use serde_json::{Value, json};

use super::{flag, millis, names, table, text, with_default, words};

pub(super) fn context() -> Value {
    let guard = json!({
        "token": text("The token's path."),
        "names": names("The messages that need its ownership; * stands for all."),
    });
    let safe = json!({
        "channel": text("The channel that gets it; the token must guard it."),
        "name": text("The message's name."),
        "content": { "description": "The message's content." },
    });
    let keep = json!({
        "latest": with_default(flag("Only the newest of each sender and name, as long as its sender is there."), false),
        "parcels": { "description": "The most parcels; absent = 1000.", "type": "integer", "minimum": 1, "maximum": 10_000 },
        "bytes": { "description": "The most bytes; absent = 1 MiB.", "type": "integer", "minimum": 1, "maximum": 16 << 20 },
        "age": millis("The greatest age, in ms; absent = any age."),
    });
    let properties = json!({
        "path": text("Its path, such as /robot/arm."),
        "kind": words("What it is.", &ContextKind::ALL.map(ContextKind::word)),
        "manager": { "description": "Its manager; absent = its parent's.", "$ref": "#/definitions/manager" },
        "presence": with_default(words("Who is told who comes and goes.", &["all", "counts", "none"]), "all"),
        "transient": with_default(flag("Deleted with its last member; contexts of this file stay all the same."), false),
        "guard": table("Channels: the messages that need ownership of a token.", &guard, &["token", "names"]),
        "delivery": with_default(
            words("Channels: the delivery class of parcels that name none.", &Delivery::ALL.map(Delivery::word)),
            Delivery::default().word()
        ),
        "overflow": with_default(
            words(
                "Channels: when a receiver has no capacity for a reliable parcel, it is closed (close), or the sender waits (wait).",
                &Overflow::ALL.map(Overflow::word)
            ),
            Overflow::default().word()
        ),
        "pace": {
            "description": "Channels: bytes that their devices read in a second; no more waits for one than it reads in a second, beyond what its owner says; absent = not known.",
            "type": "integer",
            "minimum": 1000,
            "maximum": u32::MAX,
        },
        "devices": words("Channels: how many devices may obey there; absent = one where a token guards it, else several.", &["one", "several"]),
        "keep": table("Channels: what late joiners get; absent = nothing.", &keep, &[]),
        "safe": table("Tokens: the message sent when ownership ends; absent = halt to every guarded channel.", &safe, &["channel", "name"]),
        "lease": millis("Tokens: how long ownership lasts without renewal, in ms; absent = as the manager says."),
        "expiry": words("Tokens: at the end of the lease the token is lost at once (eager), or at the next grab (lazy); absent = as the manager says.", &["lazy", "eager"]),
        "deadman": millis(
            "Tokens: the owner loses it if it does not renew for so long, in ms; absent = as the manager says."
        ),
        "safe-on-give": with_default(flag("Tokens: whether the safe state is sent also when the owner gives it away."), true),
        "stop-ends-grant": with_default(flag("Tokens: whether a stop of a channel that it guards ends its owner's grant."), false),
    });
    table("A permanent context.", &properties, &["path", "kind"])
}
