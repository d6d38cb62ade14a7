//! Which lanes hold rows of which tokens, and which of these rows nothing is to be known from any more: no IO.
//!
//! A row is not needed where another lane has a newer one of its token, nor where it is the token's only one and
//! nobody owns it: the next epoch is above its fence. So older rows go everywhere before the newest one goes anywhere,
//! and no crash between the two brings an older one back.

use std::collections::{BTreeMap, BTreeSet};

use mom_hub::Record;
use mom_proto::{Fence, Path};

/// What one commit removes at most: it adds next to nothing to its time.
const AT_ONCE: usize = 256;

/// The rows of all lanes.
#[derive(Debug)]
pub(super) struct Rows {
    tokens: BTreeMap<Path, TokenRows>,
    /// Per lane the tokens whose row there is not needed.
    unneeded: Vec<BTreeSet<Path>>,
}

/// The rows of one token.
#[derive(Debug)]
struct TokenRows {
    /// Per lane whether it has a row, or may have one: what is being written may have landed.
    lanes: Vec<bool>,
    /// The one that is known to be durable and has the highest sequence.
    newest: Option<NewestRow>,
}

#[derive(Clone, Copy, Debug)]
struct NewestRow {
    sequence: u64,
    lane: usize,
    /// The epoch of its fence, if nobody owns the token.
    free: Option<u64>,
}

/// Whether nobody has the token, nor may turn out to have it.
pub(super) fn is_free(record: &Record) -> bool {
    record.owner.is_none() && record.before.is_none()
}

impl Rows {
    /// The rows that so many lanes are known to have: per token its lane and sequence.
    pub(super) fn new(lanes: usize, known: impl IntoIterator<Item = (Path, usize, u64)>) -> Rows {
        let mut rows = Rows {
            tokens: BTreeMap::new(),
            unneeded: vec![BTreeSet::new(); lanes],
        };
        for (path, lane, sequence) in known {
            let token = rows.token(&path);
            token.lanes[lane] = true;
            token.newest = Some(NewestRow {
                sequence,
                lane,
                free: None,
            });
        }
        rows
    }

    fn token(&mut self, path: &Path) -> &mut TokenRows {
        let lanes = self.unneeded.len();
        self.tokens.entry(path.clone()).or_insert_with(|| TokenRows {
            lanes: vec![false; lanes],
            newest: None,
        })
    }

    /// A lane begins to write a record.
    pub(super) fn begin(&mut self, lane: usize, record: &Record) {
        self.token(&record.path).lanes[lane] = true;
        self.review(&record.path);
    }

    /// It has written it.
    pub(super) fn wrote(&mut self, lane: usize, sequence: u64, record: &Record) {
        let token = self.token(&record.path);
        if token.newest.is_none_or(|newest| newest.sequence < sequence) {
            token.newest = Some(NewestRow {
                sequence,
                lane,
                free: is_free(record).then(|| Fence::from(record.last_fence()).epoch()),
            });
        }
        self.review(&record.path);
    }

    /// How many rows a lane has for nothing.
    pub(super) fn unneeded(&self, lane: usize) -> usize {
        self.unneeded[lane].len()
    }

    /// Some of them, to be removed in a commit that writes nothing about these tokens; and the highest epoch of a fence
    /// that is forgotten with them.
    pub(super) fn take(&mut self, lane: usize, written: &BTreeSet<&Path>) -> (Vec<Path>, u64) {
        let unneeded = self.unneeded[lane].iter();
        let gone: Vec<Path> = unneeded
            .filter(|path| !written.contains(path))
            .take(AT_ONCE)
            .cloned()
            .collect();
        let mut epoch = 0;
        for path in &gone {
            self.unneeded[lane].remove(path);
            let newest = self.tokens.get(path).and_then(|token| token.newest);
            epoch = epoch.max(newest.and_then(|newest| newest.free).unwrap_or_default());
        }
        (gone, epoch)
    }

    /// They are removed.
    pub(super) fn removed(&mut self, lane: usize, gone: &[Path]) {
        for path in gone {
            if let Some(token) = self.tokens.get_mut(path) {
                token.lanes[lane] = false;
            }
            self.review(path);
        }
    }

    /// Nothing is removed from a lane that failed, and what it may hold stays in the way.
    pub(super) fn lose(&mut self, lane: usize) {
        self.unneeded[lane].clear();
    }

    fn review(&mut self, path: &Path) {
        let Some(token) = self.tokens.get(path) else {
            return;
        };
        let held = token.lanes.iter().filter(|held| **held).count();
        if held == 0 {
            self.tokens.remove(path);
            for lane in &mut self.unneeded {
                lane.remove(path);
            }
            return;
        }
        for (lane, unneeded) in self.unneeded.iter_mut().enumerate() {
            let goes = token.lanes[lane]
                && token.newest.is_some_and(|newest| match newest.lane == lane {
                    true => newest.free.is_some() && held == 1,
                    false => true,
                });
            let _ = match goes {
                true => unneeded.insert(path.clone()),
                false => unneeded.remove(path),
            };
        }
    }
}
