//! Which peers a parameter means: by user, group and level.

use std::sync::Arc;

use mom_proto::WireError;
use serde::Deserialize;

use crate::verdict::fits;
use crate::{Ask, Owner, PeerFacts, Setup};

/// The most names in a text; others are counted.
const NAMED: usize = 3;

/// The keys that select peers, where they are a map of their own.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub(crate) struct WhoParams {
    pub(crate) users: Option<Vec<String>>,
    pub(crate) groups: Option<Vec<String>>,
    pub(crate) min_level: Option<i32>,
}

/// A peer matches if its user or one of its groups is named (or none are), and its level is high enough.
#[derive(Clone, Debug, Default)]
pub(crate) struct Who {
    users: Arc<[String]>,
    groups: Arc<[String]>,
    min_level: Option<i32>,
}

impl Who {
    /// Peers by lists; an empty list counts as absent.
    pub(crate) fn new(users: Vec<String>, groups: Vec<String>, min_level: Option<i32>) -> Who {
        Who {
            users: users.into(),
            groups: groups.into(),
            min_level,
        }
    }

    /// Peers by the keys below `key`. An empty list is refused: it looks like nobody and would mean everybody.
    pub(crate) fn read(setup: &Setup<'_>, key: &str, params: WhoParams) -> Result<Who, WireError> {
        for (name, list) in [("users", &params.users), ("groups", &params.groups)] {
            if list.as_ref().is_some_and(Vec::is_empty) {
                let text = format!("{name} is empty; leave it out where it does not matter");
                return Err(setup.error(&format!("{key}/{name}"), &text));
            }
        }
        let list = Option::unwrap_or_default;
        Ok(Who::new(
            list(params.users),
            list(params.groups),
            params.min_level,
        ))
    }

    /// Whether this means every peer.
    pub(crate) fn is_anybody(&self) -> bool {
        self.users.is_empty() && self.groups.is_empty() && self.min_level.is_none()
    }

    pub(crate) fn fits(&self, peer: &PeerFacts) -> bool {
        self.matches(&peer.user, &peer.groups, peer.level)
    }

    pub(crate) fn fits_owner(&self, owner: &Owner<'_>) -> bool {
        self.matches(owner.user, owner.groups, owner.level)
    }

    fn matches(&self, user: &str, groups: &[String], level: i32) -> bool {
        fits(&self.users, &self.groups, self.min_level, user, groups, level)
    }

    /// These peers, to be asked.
    pub(crate) fn chairs(&self) -> Ask {
        Ask::Chairs {
            users: Arc::clone(&self.users),
            groups: Arc::clone(&self.groups),
            min_level: self.min_level,
        }
    }

    /// A description for people.
    pub(crate) fn words(&self) -> String {
        let mut names = Vec::new();
        if !self.users.is_empty() {
            names.push(some_of(&self.users));
        }
        if !self.groups.is_empty() {
            names.push(format!("the group {}", some_of(&self.groups)));
        }
        match (names.is_empty(), self.min_level) {
            (true, None) => "everybody".to_owned(),
            (true, Some(level)) => format!("levels from {level}"),
            (false, None) => names.join(" and "),
            (false, Some(level)) => format!("{} at levels from {level}", names.join(" and ")),
        }
    }
}

fn some_of(names: &[String]) -> String {
    match names.len().checked_sub(NAMED) {
        None | Some(0) => names.join(", "),
        Some(more) => format!("{} and {more} more", names[..NAMED].join(", ")),
    }
}
