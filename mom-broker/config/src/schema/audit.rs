//! The tables `[audit]` and `[record]`.

use mom_journal::{AuditConfig, RecordConfig};
use serde_json::{Value, json};

use super::{number, table, text, with_default};

const RESERVE: &str =
    "Bytes that are left free on the disk, a tenth of it at most: the oldest files go first.";

pub(super) fn audit() -> Value {
    let default = AuditConfig::default();
    let properties = json!({
        "path": text("The file, relative to this one; absent = the log, at level info as target audit."),
        "size": with_default(at_least("Bytes after which a new file is begun.", AuditConfig::LEAST), default.size),
        "keep": with_default(at_least("Files that are kept beside the present one.", 0), default.keep),
        "reserve": with_default(at_least(RESERVE, 0), default.reserve),
    });
    let description =
        "The audit log: who was granted or refused what, or lost it, by which rule, as JSON lines.";
    table(description, &properties, &[])
}

pub(super) fn record() -> Value {
    let default = RecordConfig::default();
    let properties = json!({
        "path": text("The file, relative to this one; absent = nothing is recorded."),
        "size": with_default(at_least("Bytes after which recording stops.", RecordConfig::LEAST), default.size),
        "keep": with_default(at_least("Earlier recordings that are kept beside the present one.", 0), default.keep),
        "reserve": with_default(at_least(RESERVE, 0), default.reserve),
    });
    let description = "The recording of the hub's inputs and decisions, for mom-broker what-if.";
    table(description, &properties, &[])
}

fn at_least(description: &str, least: u64) -> Value {
    let mut number = number(description);
    number["minimum"] = least.into();
    number
}
