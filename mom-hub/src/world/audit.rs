//! Facts for the audit log: who, what, by which rule, under which fence.

use std::sync::Arc;

use mom_proto::event::Reason;
use mom_proto::{Code, Map, Path, Verb};

/// One fact. It holds no content and no secret; a field that does not apply is none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Audit {
    /// What happened: one of [`Audit::WORDS`].
    pub what: &'static str,
    /// The peer that caused it, or that it happened to.
    pub peer: Option<Arc<str>>,
    /// Its user.
    pub user: Option<Arc<str>>,
    /// Its level.
    pub level: Option<i32>,
    /// The verb that was asked for.
    pub verb: Option<Verb>,
    /// Where.
    pub context: Option<Path>,
    /// The name of a message that was refused.
    pub message: Option<Arc<str>>,
    /// The rule that decided.
    pub rule: Option<Arc<str>>,
    /// The code of a refusal.
    pub code: Option<Code>,
    /// Plain words of a refusal, of who put a peer out, of a step of the clock, of a fault, or why devices are stopped.
    pub text: Option<String>,
    /// The fence of the ownership that began or ended.
    pub fence: Option<u64>,
    /// The number of a stop that began or was lifted.
    pub stop: Option<u64>,
    /// Why an ownership ended, or how it began if not by a grab.
    pub reason: Option<Reason>,
    /// The other peer: who broke the token, gave it, or owns it.
    pub by: Option<Arc<str>>,
}

impl Audit {
    /// All values of [`Audit::what`].
    pub const WORDS: [&'static str; 18] = [
        "login",
        "gone",
        "link-lost",
        "resumed",
        "granted",
        "lost",
        "refused",
        "inhibited",
        "uninhibited",
        "expelled",
        "invited",
        "created",
        "deleted",
        "configured",
        "clock-stepped",
        "stopped",
        "unstopped",
        "fault",
    ];

    /// A fact of this kind.
    pub fn new(what: &'static str) -> Audit {
        debug_assert!(Audit::WORDS.contains(&what), "{what}");
        Audit {
            what,
            ..Audit::default()
        }
    }

    /// The fact with its keys in order; those that do not apply are left out.
    pub fn to_map(&self) -> Map {
        let mut map = Map::new().with("what", self.what);
        let mut text = |key: &str, text: Option<&str>| {
            if let Some(text) = text {
                map.set(key, text);
            }
        };
        text("peer", self.peer.as_deref());
        text("user", self.user.as_deref());
        text("verb", self.verb.map(Verb::word));
        text("context", self.context.as_ref().map(Path::as_str));
        text("message", self.message.as_deref());
        text("rule", self.rule.as_deref());
        text("code", self.code.as_ref().map(Code::word));
        text("reason", self.reason.map(Reason::word));
        text("by", self.by.as_deref());
        text("text", self.text.as_deref());
        if let Some(level) = self.level {
            map.set("level", level);
        }
        if let Some(fence) = self.fence {
            map.set("fence", i64::try_from(fence).unwrap_or(i64::MAX));
        }
        if let Some(stop) = self.stop {
            map.set("stop", i64::try_from(stop).unwrap_or(i64::MAX));
        }
        map
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_of_the_audit_log_has_all_words() {
        let page = include_str!("../../../docs/audit.md");
        let table = page.split("| `what` | when |").nth(1).expect("a table");
        let table = table.split("\n\n").next().expect("its rows");
        for word in Audit::WORDS {
            assert!(
                table.contains(&format!("`{word}`")),
                "docs/audit.md lacks `{word}`"
            );
        }
    }
}
