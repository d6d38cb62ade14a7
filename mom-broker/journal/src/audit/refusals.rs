//! Folds refusals, which may come by the hundred thousand per second: the first is written at once, then one line a
//! second with a count.
//!
//! A peer decides how often it is refused, and may vary message and context. So the number of kinds that are
//! distinguished is bounded, per peer, per user and in all; others are only counted.

use std::collections::HashMap;
use std::sync::Arc;

use mom_hub::Audit;
use mom_proto::{Code, Path, Verb};

use super::Fact;

/// Kinds of refusals distinguished per peer.
const OF_ONE: usize = 8;

/// Kinds distinguished per user. Who is refused as nobody's user, as at a login with a name that does not exist, is one
/// user here, whatever address it comes from; and a guest that comes again has another name as a peer.
const OF_USER: usize = 32;

/// Kinds of refusals distinguished in all.
const OF_ALL: usize = 1024;

/// The text of refusals beyond these bounds.
const MANY: &str = "more than can be told apart";

/// Who was refused: a peer, or an address where there is none yet.
type Refused = Arc<str>;

/// Refusals with the same key are identical.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct RefusalKey {
    who: Refused,
    user: Option<Arc<str>>,
    verb: Option<Verb>,
    context: Option<Path>,
    message: Option<Arc<str>>,
    code: Option<Code>,
    rule: Option<Arc<str>>,
}

/// Whose keys are counted.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Whose {
    Peer(Refused),
    User(Arc<str>),
}

/// Refusals of the present and the last second.
#[derive(Debug, Default)]
pub(super) struct Refusals {
    alike: HashMap<RefusalKey, FoldedRefusals>,
    /// How many keys one peer or user has.
    keys: HashMap<Whose, usize>,
    /// One refusal beyond all bounds, and the count of all such.
    others: Option<(Fact, u64)>,
}

#[derive(Debug)]
struct FoldedRefusals {
    last: Fact,
    /// Refusals not written yet.
    count: u64,
    /// Whose key this is.
    whose: Vec<Whose>,
}

impl Refusals {
    /// Counts a refusal; gives it back if it is the first of its kind, to be written at once.
    pub(super) fn take(&mut self, mut fact: Fact) -> Option<Fact> {
        let mut key = key_of(&fact);
        if self.count(&key, &fact) {
            return None;
        }
        let mut whose = vec![Whose::Peer(Arc::clone(&key.who))];
        let user = key.user.clone();
        // Logins stay apart from what users ask for.
        let verb = key.verb.filter(|verb| *verb == Verb::Login);
        if self.has(&whose[0], OF_ONE) {
            key = reduced(key);
            fact.audit = reduced_fact(fact.audit);
            if self.count(&key, &fact) {
                return None;
            }
        }
        if let Some(user) = user {
            let of_user = Whose::User(Arc::clone(&user));
            if self.has(&of_user, OF_USER) {
                key = reduced(key);
                (key.who, key.user, key.verb) = ("".into(), Some(user), verb);
                fact.audit = reduced_fact(fact.audit);
                (fact.audit.peer, fact.audit.verb, fact.from) = (None, verb, None);
                if self.count(&key, &fact) {
                    return None;
                }
                // Beyond all that are counted: there are few codes.
                whose.clear();
            } else {
                whose.push(of_user);
            }
        }
        if self.alike.len() >= OF_ALL {
            let (last, count) = self.others.get_or_insert_with(|| (fact.clone(), 0));
            last.at = fact.at;
            *count += 1;
            return None;
        }
        for whose in &whose {
            *self.keys.entry(whose.clone()).or_default() += 1;
        }
        let first = FoldedRefusals {
            last: fact.clone(),
            count: 0,
            whose,
        };
        self.alike.insert(key, first);
        Some(fact)
    }

    fn has(&self, whose: &Whose, most: usize) -> bool {
        self.keys.get(whose).is_some_and(|keys| *keys >= most)
    }

    fn count(&mut self, key: &RefusalKey, fact: &Fact) -> bool {
        let Some(alike) = self.alike.get_mut(key) else {
            return false;
        };
        alike.count += 1;
        alike.last.at = fact.at;
        true
    }

    /// Refusals counted since the last call; kinds without new ones are forgotten. To be called each second.
    pub(super) fn drain(&mut self) -> Vec<Fact> {
        let mut counted = Vec::new();
        let keys = &mut self.keys;
        self.alike.retain(|_, alike| {
            if alike.count > 0 {
                let count = Some(std::mem::take(&mut alike.count));
                counted.push(Fact {
                    count,
                    ..alike.last.clone()
                });
                return true;
            }
            for whose in &alike.whose {
                if let Some(left) = keys.get_mut(whose) {
                    *left -= 1;
                    if *left == 0 {
                        keys.remove(whose);
                    }
                }
            }
            false
        });
        if let Some((fact, count)) = self.others.take() {
            let mut others = Fact::new(fact.at, Audit::new("refused"));
            others.audit.text = Some(MANY.to_owned());
            others.count = Some(count);
            counted.push(others);
        }
        counted.sort_by_key(|fact| fact.at);
        counted
    }
}

fn key_of(fact: &Fact) -> RefusalKey {
    let Audit {
        peer,
        user,
        verb,
        context,
        message,
        code,
        rule,
        ..
    } = fact.audit.clone();
    let address = || fact.from.map(|from| from.to_string().into());
    RefusalKey {
        who: peer.or_else(address).unwrap_or_else(|| "".into()),
        user,
        verb,
        context,
        message,
        code,
        rule,
    }
}

fn reduced(key: RefusalKey) -> RefusalKey {
    RefusalKey {
        user: None,
        verb: None,
        context: None,
        message: None,
        rule: None,
        ..key
    }
}

fn reduced_fact(audit: Audit) -> Audit {
    Audit {
        verb: None,
        context: None,
        message: None,
        rule: None,
        fence: None,
        by: None,
        text: Some(MANY.to_owned()),
        ..audit
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mom_proto::Time;

    fn refusal(peer: &str, message: &str, at: i64) -> Fact {
        let audit = Audit {
            peer: Some(peer.into()),
            message: Some(message.into()),
            code: Some(Code::DENIED),
            ..Audit::new("refused")
        };
        Fact::new(Time::from_micros(at).unwrap(), audit)
    }

    #[test]
    fn the_first_comes_at_once_the_others_as_a_count() {
        let mut refusals = Refusals::default();
        assert!(refusals.take(refusal("eve", "jump", 1)).is_some());
        for at in 2..100_002 {
            assert!(refusals.take(refusal("eve", "jump", at)).is_none());
        }
        assert!(refusals.take(refusal("eve", "run", 3)).is_some());
        let counted = refusals.drain();
        assert_eq!(counted.len(), 1);
        assert_eq!(
            (counted[0].count, counted[0].at.micros()),
            (Some(100_000), 100_001)
        );
        // It goes on: still no line of its own, and none at all where nothing came.
        assert!(refusals.take(refusal("eve", "jump", 100_002)).is_none());
        assert!(
            refusals.take(refusal("eve", "run", 5)).is_some(),
            "a second without one has passed"
        );
        assert_eq!(refusals.drain()[0].count, Some(1));
        assert!(refusals.drain().is_empty());
        assert!(refusals.alike.is_empty() && refusals.keys.is_empty());
    }

    #[test]
    fn one_peer_cannot_fill_the_log() {
        let mut refusals = Refusals::default();
        let lines = (0..10_000).filter_map(|n| refusals.take(refusal("eve", &format!("m{n}"), n)));
        assert_eq!(lines.count(), OF_ONE + 1, "the last says that there are more");
        assert!(
            refusals.take(refusal("bob", "m0", 0)).is_some(),
            "others are heard"
        );
        let counted = refusals.drain();
        assert_eq!(counted.len(), 1);
        assert_eq!(counted[0].count, Some(10_000 - OF_ONE as u64 - 1));
        assert_eq!(counted[0].audit.text.as_deref(), Some(MANY));
        assert_eq!(counted[0].audit.peer.as_deref(), Some("eve"));
    }

    /// As a guest that comes and goes, and strangers from many addresses.
    #[test]
    fn one_user_cannot_fill_the_log_under_many_names() {
        let mut refusals = Refusals::default();
        for (user, named) in [("guest", true), ("unknown", false)] {
            let of_user = |n: i64| {
                let mut fact = refusal(&format!("guest~{n}"), "m", n);
                fact.audit.user = Some(user.into());
                if !named {
                    fact.audit.peer = None;
                    fact.from = Some(std::net::Ipv4Addr::from_bits(n as u32).into());
                }
                fact
            };
            let lines = (0..10_000).filter_map(|n| refusals.take(of_user(n)));
            assert_eq!(lines.count(), OF_USER + 1, "{user}");
            let counted = refusals.drain();
            assert_eq!(counted.len(), 1);
            assert_eq!(counted[0].count, Some(10_000 - OF_USER as u64 - 1));
            let audit = &counted[0].audit;
            assert_eq!((audit.user.as_deref(), &audit.peer), (Some(user), &None));
            assert_eq!(counted[0].from, None);
        }
        assert!(refusals.drain().is_empty() && refusals.drain().is_empty());
        assert!(refusals.alike.is_empty() && refusals.keys.is_empty());
    }

    #[test]
    fn all_peers_together_cannot_fill_the_memory() {
        let mut refusals = Refusals::default();
        let lines = (0..10_000).filter_map(|n| refusals.take(refusal(&format!("eve~{n}"), "m", n)));
        assert_eq!(lines.count(), OF_ALL);
        let counted = refusals.drain();
        assert_eq!(counted.len(), 1);
        assert_eq!(counted[0].count, Some(10_000 - OF_ALL as u64));
        assert_eq!(counted[0].audit.peer, None);
    }
}
