//! Folds grants and losses, logins and ends, which may come by the thousand per second: the first ones of a second are
//! written one by one, then a line with a count. So nobody can push older lines out of the files by grabbing and
//! releasing a token in a loop, or by coming and going.
//!
//! The last state is never lost: the line of folded facts is that of the last one, and it is written before any other
//! line about its context, or about the same user where there is none.

use std::collections::HashMap;
use std::sync::Arc;

use mom_hub::Audit;
use mom_proto::Path;
use mom_proto::event::Reason;

use super::Fact;

/// The facts that are folded: a peer can repeat them at will, and each reverses the one before.
const FOLDING: [&str; 8] = [
    "login",
    "gone",
    "granted",
    "lost",
    "inhibited",
    "uninhibited",
    "invited",
    "expelled",
];

/// Identical facts of one second that get lines of their own.
const OWN_LINES: u32 = 8;

/// Kinds of facts that are distinguished; facts beyond get lines of their own.
const OF_ALL: usize = 1024;

/// Facts with the same key are identical.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct FactKey {
    what: &'static str,
    peer: Option<Arc<str>>,
    user: Option<Arc<str>>,
    context: Option<Path>,
    rule: Option<Arc<str>>,
    reason: Option<&'static str>,
    by: Option<Arc<str>>,
}

#[derive(Debug, Default)]
struct FoldedFacts {
    /// Lines of the present second.
    own: u32,
    /// The last fact not written yet, the number of such facts, and its position in the order of all.
    folded: Option<(Fact, u64, u64)>,
}

/// Facts of the present and the last second.
#[derive(Debug, Default)]
pub(super) struct Successes {
    alike: HashMap<FactKey, FoldedFacts>,
    /// Facts that were folded so far.
    order: u64,
}

impl Successes {
    /// Takes a fact; gives the facts to be written now, in order.
    pub(super) fn take(&mut self, fact: Fact) -> Vec<Fact> {
        if !FOLDING.contains(&fact.audit.what) {
            return vec![fact];
        }
        let (key, room) = (key_of(&fact.audit), self.alike.len() < OF_ALL);
        match self.alike.get_mut(&key) {
            Some(alike) if alike.own >= OWN_LINES => {
                self.order += 1;
                let count = alike.folded.take().map_or(0, |(_, count, _)| count);
                alike.folded = Some((fact, count + 1, self.order));
                return Vec::new();
            }
            Some(alike) => alike.own += 1,
            None if room => {
                let first = FoldedFacts { own: 1, folded: None };
                self.alike.insert(key, first);
            }
            None => {}
        }
        // Folded facts about the same context happened before.
        let Audit { context, user, .. } = &fact.audit;
        let about = |key: &FactKey| key.context == *context && (context.is_some() || key.user == *user);
        let mut lines = self.unfold(about);
        lines.push(fact);
        lines
    }

    /// Facts folded since the last call; kinds without new ones are forgotten. To be called each second.
    pub(super) fn drain(&mut self) -> Vec<Fact> {
        let lines = self.unfold(|_| true);
        self.alike.retain(|_, alike| std::mem::take(&mut alike.own) > 0);
        lines
    }

    fn unfold(&mut self, of: impl Fn(&FactKey) -> bool) -> Vec<Fact> {
        let about = self.alike.iter_mut().filter(|(key, _)| of(key));
        let mut folded: Vec<_> = about.filter_map(|(_, alike)| alike.folded.take()).collect();
        folded.sort_by_key(|(_, _, order)| *order);
        let line = |(fact, count, _)| Fact {
            // One alone stands for itself.
            count: (count > 1).then_some(count),
            ..fact
        };
        folded.into_iter().map(line).collect()
    }
}

fn key_of(audit: &Audit) -> FactKey {
    // Who comes again may have another name as a peer.
    let coming = ["login", "gone"].contains(&audit.what);
    FactKey {
        what: audit.what,
        peer: audit.peer.clone().filter(|_| !coming),
        user: audit.user.clone(),
        context: audit.context.clone(),
        rule: audit.rule.clone(),
        reason: audit.reason.map(Reason::word),
        by: audit.by.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mom_proto::Time;

    fn fact(what: &'static str, peer: &str, fence: u64) -> Fact {
        let audit = Audit {
            peer: Some(peer.into()),
            context: Path::parse("/robot/token").ok(),
            fence: Some(fence),
            ..Audit::new(what)
        };
        Fact::new(Time::default(), audit)
    }

    /// What, whose, fence and count.
    type Shown<'a> = (&'a str, Option<&'a str>, Option<u64>, Option<u64>);

    fn shown(lines: &[Fact]) -> Vec<Shown<'_>> {
        let mut shown = Vec::new();
        for Fact { audit, count, .. } in lines {
            shown.push((audit.what, audit.peer.as_deref(), audit.fence, *count));
        }
        shown
    }

    #[test]
    fn a_loop_has_a_few_lines_and_its_last_state() {
        let mut successes = Successes::default();
        let mut lines = Vec::new();
        for fence in 1..=1000 {
            lines.extend(successes.take(fact("granted", "eve", fence)));
            lines.extend(successes.take(fact("lost", "eve", fence)));
        }
        lines.extend(successes.take(fact("granted", "eve", 1001)));
        assert_eq!(lines.len(), 2 * OWN_LINES as usize);
        assert_eq!(
            shown(&successes.drain()),
            [
                ("lost", Some("eve"), Some(1000), Some(992)),
                ("granted", Some("eve"), Some(1001), Some(993)),
            ],
            "who owns it now comes last"
        );
        assert!(successes.drain().is_empty() && successes.alike.is_empty());
    }

    #[test]
    fn coming_and_going_has_a_few_lines_for_each_user() {
        let mut successes = Successes::default();
        let mut lines = Vec::new();
        let of = |what, number: u64| {
            let mut fact = fact(what, &format!("guest~{number}"), number);
            (fact.audit.context, fact.audit.user) = (None, Some("guest".into()));
            fact
        };
        for number in 1..=1000 {
            lines.extend(successes.take(of("login", number)));
            lines.extend(successes.take(of("gone", number)));
        }
        let mut other = fact("login", "alice", 1);
        (other.audit.context, other.audit.user) = (None, Some("alice".into()));
        assert_eq!(
            successes.take(other).len(),
            1,
            "another user's tells nothing of these"
        );
        assert_eq!(lines.len(), 2 * OWN_LINES as usize);
        assert_eq!(
            shown(&successes.drain()),
            [
                ("login", Some("guest~1000"), Some(1000), Some(992)),
                ("gone", Some("guest~1000"), Some(1000), Some(992)),
            ]
        );
    }

    #[test]
    fn what_was_folded_is_told_before_what_comes_after() {
        let mut successes = Successes::default();
        for fence in 1..=9 {
            successes.take(fact("granted", "eve", fence));
            successes.take(fact("lost", "eve", fence));
        }
        assert_eq!(
            shown(&successes.take(fact("granted", "bob", 10))),
            [
                ("granted", Some("eve"), Some(9), None),
                ("lost", Some("eve"), Some(9), None),
                ("granted", Some("bob"), Some(10), None),
            ]
        );
        assert!(successes.drain().is_empty());
    }

    #[test]
    fn what_does_not_fold_and_what_is_beyond_has_its_line() {
        let mut successes = Successes::default();
        for _ in 0..100 {
            assert_eq!(successes.take(fact("created", "eve", 0)).len(), 1);
        }
        for peer in 0..2 * OF_ALL {
            assert_eq!(
                successes.take(fact("granted", &format!("eve~{peer}"), 1)).len(),
                1
            );
        }
        assert_eq!(successes.alike.len(), OF_ALL);
    }
}
