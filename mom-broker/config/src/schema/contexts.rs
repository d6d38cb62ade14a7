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
        "channel": text("The channel that gets it; one that the token guards."),
        "name": text("The message's name."),
        "content": { "description": "The message's content." },
    });
    let keep = json!({
        "latest": with_default(flag("Only the newest of each sender and name, as long as its sender is there."), false),
        "parcels": { "description": "At most so many; absent = 1000.", "type": "integer", "minimum": 1, "maximum": 10_000 },
        "bytes": { "description": "At most so many bytes; absent = 1 MiB.", "type": "integer", "minimum": 1, "maximum": 16 << 20 },
        "age": millis("Nothing that came longer ago, in ms; absent = however long ago."),
    });
    let properties = json!({
        "path": text("Where it is, such as /robot/arm."),
        "kind": words("What it is.", &ContextKind::ALL.map(ContextKind::word)),
        "manager": { "description": "Who decides about it; absent = whoever decides about its parent.", "$ref": "#/definitions/manager" },
        "presence": with_default(words("Who is told who comes and goes.", &["all", "counts", "none"]), "all"),
        "transient": with_default(flag("Deleted with its last member; contexts of this file stay all the same."), false),
        "guard": table("Channels: the messages that need ownership of a token.", &guard, &["token", "names"]),
        "delivery": with_default(
            words("Channels: the delivery class of parcels that name none.", &Delivery::ALL.map(Delivery::word)),
            Delivery::default().word()
        ),
        "overflow": with_default(
            words(
                "Channels: where a receiver has no room for a reliable parcel, it is closed (close), or the sender waits (wait).",
                &Overflow::ALL.map(Overflow::word)
            ),
            Overflow::default().word()
        ),
        "keep": table("Channels: what those who join later are given; absent = nothing.", &keep, &[]),
        "safe": table("Tokens: what is sent when ownership ends; absent = halt to every guarded channel.", &safe, &["channel", "name"]),
        "lease": millis("Tokens: how long ownership lasts without renewal, in ms; absent = as the manager says."),
        "expiry": words("Tokens: at the end of the lease lost at once (eager), or at the next grab (lazy); absent = as the manager says.", &["lazy", "eager"]),
        "deadman": millis(
            "Tokens: the owner loses it if it does not renew for so long, in ms; absent = as the manager says."
        ),
        "safe-on-give": with_default(flag("Tokens: whether the safe state is sent also when the owner gives it away."), false),
    });
    table("A context that is always there.", &properties, &["path", "kind"])
}
