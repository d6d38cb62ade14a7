//! The users who have logged in by a token and stand in no file, so that nobody else takes their names.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use mom_hub::User;
use mom_proto::{WireError, folds_of};
use parking_lot::Mutex;

use super::book::anothers_name;

/// Subjects that are remembered; after more of them the first are forgotten.
const ROOM: usize = 16 * 1024;

/// The subjects that were seen since the start.
#[derive(Debug, Default)]
pub(super) struct Subjects(Mutex<Seen>);

#[derive(Debug, Default)]
struct Seen {
    by_fold: HashMap<String, Arc<str>>,
    order: VecDeque<Arc<str>>,
}

impl Subjects {
    pub(super) fn note(&self, name: &str) {
        let folds = folds_of(name);
        let mut seen = self.0.lock();
        // Two subjects may look alike: their issuer tells them apart, and the hub numbers their peers.
        if folds.iter().all(|fold| seen.by_fold.contains_key(fold)) {
            return;
        }
        let name: Arc<str> = name.into();
        for fold in folds {
            seen.by_fold.entry(fold).or_insert_with(|| Arc::clone(&name));
        }
        seen.order.push_back(name);
        if seen.order.len() > ROOM
            && let Some(first) = seen.order.pop_front()
        {
            for fold in folds_of(&first) {
                if seen.by_fold.get(&fold) == Some(&first) {
                    seen.by_fold.remove(&fold);
                }
            }
        }
    }

    /// Refuses the name of one of them to another user, and what looks like it.
    pub(super) fn check_nickname(&self, user: &User, nickname: Option<&str>) -> Result<(), WireError> {
        let Some(nickname) = nickname.filter(|nickname| *nickname != user.name) else {
            return Ok(());
        };
        let folds = folds_of(nickname);
        let seen = self.0.lock();
        let mut whose = folds.iter().filter_map(|fold| seen.by_fold.get(fold));
        match whose.find(|whose| ***whose != *user.name) {
            Some(whose) => Err(anothers_name(nickname, **whose == *nickname)),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mom_proto::Map;

    fn user(name: &str) -> User {
        User {
            name: name.to_owned(),
            level: 0,
            groups: Vec::new(),
            details: Map::new(),
        }
    }

    #[test]
    fn a_subject_that_was_seen_keeps_its_name() {
        let subjects = Subjects::default();
        let may = |who: &str, nickname: &str| subjects.check_nickname(&user(who), Some(nickname)).is_ok();
        assert!(may("guest", "dora"));
        subjects.note("dora");
        for nickname in ["dora", "Dora", "d0ra", "d\u{43e}ra"] {
            assert!(!may("guest", nickname), "{nickname}");
            assert!(may("dora", nickname), "{nickname}");
        }
        assert!(may("guest", "theodora") && may("guest", "guest"));
    }

    #[test]
    fn the_first_are_forgotten() {
        let subjects = Subjects::default();
        for number in 0..=ROOM {
            subjects.note(&format!("user-{number}"));
            subjects.note(&format!("user-{number}"));
        }
        let seen = subjects.0.lock();
        assert_eq!(seen.order.len(), ROOM);
        assert!(!seen.by_fold.values().any(|name| &**name == "user-0"));
    }
}
