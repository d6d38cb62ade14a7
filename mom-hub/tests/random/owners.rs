//! Who owns what, as it is told: by events and replies only.

use std::collections::BTreeMap;

use mom_proto::{Parcel, Path, Value};

use crate::lab::Rules;
use crate::seen::Seen;

/// What rests after a restart where a token has no lease, µs.
const REST: u64 = 30_000_000;

/// An ownership as it was told.
#[derive(Clone, Debug)]
pub(crate) struct Owned {
    pub(crate) name: String,
    pub(crate) user: String,
    pub(crate) fence: u64,
    /// When its turn began: a turn goes on where the token is given or returned.
    pub(crate) turn: u64,
    /// µs; none = without end.
    pub(crate) lease: Option<u64>,
    pub(crate) lease_end: Option<u64>,
    pub(crate) alive_until: Option<u64>,
    /// Who gave it for a while.
    pub(crate) from: Option<String>,
}

/// Who had it last, and how it was lost.
#[derive(Clone, Debug)]
pub(crate) struct Lost {
    pub(crate) owned: Owned,
    pub(crate) reason: String,
}

/// Who alone may have a token since a restart, and until when.
#[derive(Clone, Debug)]
pub(crate) struct Kept {
    pub(crate) user: String,
    pub(crate) name: String,
    pub(crate) until: u64,
}

/// The owners of all tokens.
#[derive(Debug, Default)]
pub(crate) struct Owners {
    pub(crate) now: BTreeMap<Path, Owned>,
    /// The latest loss of each token, while the token is on its way to who is next.
    pub(crate) lost: BTreeMap<Path, Lost>,
    /// The highest fence of each path.
    pub(crate) fences: BTreeMap<Path, u64>,
    pub(crate) kept: BTreeMap<Path, Kept>,
}

/// A grant as it is told.
pub(crate) struct Grant<'a> {
    pub(crate) path: &'a Path,
    pub(crate) name: &'a str,
    pub(crate) user: &'a str,
    pub(crate) told: &'a Value,
    pub(crate) rules: Option<&'a Rules>,
    pub(crate) at: u64,
}

impl Owners {
    /// A token has a new owner; how the one before lost it, if it was on its way.
    pub(crate) fn grant(&mut self, grant: &Grant<'_>) -> Option<Lost> {
        let path = grant.path;
        assert!(!self.now.contains_key(path), "released before grabbed: {path}");
        let fence = fence_of(grant.told);
        let highest = self.fences.insert(path.clone(), fence);
        assert!(
            highest.is_none_or(|highest| fence > highest),
            "fences of {path} only rise: {fence} after {highest:?}"
        );
        if let Some(kept) = self.kept.get(path).filter(|kept| grant.at < kept.until) {
            let same = kept.user == grant.user && kept.name == grant.name;
            assert!(
                same,
                "{path} is {}'s for now, not {}'s: {kept:?}",
                kept.name, grant.name
            );
        }
        self.kept.remove(path);
        let lost = self.lost.remove(path);
        let goes_on = lost.as_ref().filter(|lost| {
            let returns = !matches!(&*lost.reason, "broken" | "deleted" | "preempted");
            lost.reason == "given" || (returns && lost.owned.from.as_deref() == Some(grant.name))
        });
        let mut owned = Owned {
            name: grant.name.to_owned(),
            user: grant.user.to_owned(),
            fence,
            turn: goes_on.map_or(grant.at, |lost| lost.owned.turn),
            lease: None,
            lease_end: None,
            alive_until: None,
            from: grant.told.get("from").and_then(Value::as_str).map(str::to_owned),
        };
        owned.renew(grant);
        self.now.insert(path.clone(), owned);
        lost
    }

    /// The owner has a new lease, by renewing or by grabbing what it has.
    pub(crate) fn renewed(&mut self, grant: &Grant<'_>) {
        let owned = self.now.get_mut(grant.path).unwrap();
        assert_eq!(
            (&*owned.name, owned.fence),
            (grant.name, fence_of(grant.told)),
            "the owner of {} is who was granted it",
            grant.path
        );
        owned.renew(grant);
    }

    /// An owner has lost its token.
    pub(crate) fn release(&mut self, parcel: &Parcel, seen: &mut Seen) -> Lost {
        let path = parcel.context.clone().unwrap();
        let content = parcel.value();
        let word = |key: &str| content.get(key).and_then(Value::as_str).unwrap().to_owned();
        let owned = self.now.remove(&path);
        let owned = owned.unwrap_or_else(|| panic!("nobody had {path}: {content:?}"));
        assert_eq!(
            (&owned.name, owned.fence),
            (&word("owner"), fence_of(&content)),
            "who lost {path} had it"
        );
        seen.note(format!("reason {}", word("reason")));
        let lost = Lost {
            owned,
            reason: word("reason"),
        };
        self.lost.insert(path, lost.clone());
        lost
    }

    /// Those whose tokens are kept for them by a restart now.
    pub(crate) fn to_keep(&self) -> BTreeMap<Path, Kept> {
        let kept = |owned: &Owned| Kept {
            user: owned.user.clone(),
            name: owned.name.clone(),
            until: owned.lease.unwrap_or(REST),
        };
        let now = self.now.iter();
        now.map(|(path, owned)| (path.clone(), kept(owned))).collect()
    }
}

impl Owned {
    fn renew(&mut self, grant: &Grant<'_>) {
        let micros = |key: &str| {
            let ms = grant.told.get(key).and_then(Value::as_int);
            ms.map(|ms| u64::try_from(ms * 1000).unwrap())
        };
        self.lease = micros("lease");
        self.lease_end = self.lease.map(|lease| grant.at + lease);
        self.alive_until = micros("deadman").map(|deadman| grant.at + deadman);
        if let Some(rules) = grant.rules {
            assert_eq!(
                (rules.lease, rules.deadman),
                (self.lease, micros("deadman")),
                "the terms of {} are told",
                grant.path
            );
        }
    }
}

/// The fence that something names.
pub(crate) fn fence_of(value: &Value) -> u64 {
    let fence = value.get("fence").and_then(Value::as_int);
    fence.and_then(|fence| u64::try_from(fence).ok()).unwrap()
}
