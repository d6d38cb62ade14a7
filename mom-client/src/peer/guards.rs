//! The tokens that this client owns: their leases, and why they ended.

use std::collections::HashMap;
use std::sync::Arc;

use mom_proto::Path;
use parking_lot::Mutex;
use tokio::sync::watch;
use tokio::time::Instant;

use crate::said::ownership::{GrantTerms, RenewalTerms};
use crate::{Loan, Lost};

/// One ownership, from a grab to its loss; or a part in a shared hold, which has the fence 0.
#[derive(Debug)]
pub(crate) struct Hold {
    pub(crate) path: Path,
    pub(crate) fence: u64,
    pub(crate) delegation: Option<Loan>,
    terms: Mutex<RenewalTerms>,
    lost: watch::Sender<Option<Lost>>,
    /// The last command that was said under it and of which no device has said how it ended, by its id.
    command: watch::Sender<Option<u64>>,
}

impl Hold {
    /// The fence of an ownership; none of a part in a shared hold.
    pub(crate) fn fence(&self) -> Option<u64> {
        Some(self.fence).filter(|fence| *fence > 0)
    }

    pub(crate) fn terms(&self) -> RenewalTerms {
        *self.terms.lock()
    }

    pub(crate) fn lost(&self) -> Option<Lost> {
        self.lost.borrow().clone()
    }

    pub(crate) fn is_lost(&self) -> bool {
        self.lost.borrow().is_some()
    }

    pub(crate) fn watch(&self) -> watch::Receiver<Option<Lost>> {
        self.lost.subscribe()
    }

    /// Waits until a device has said how the last command ended, or it was refused or lost. Safe to cancel.
    pub(crate) async fn done(&self) {
        let mut command = self.command.subscribe();
        // The sender lives here.
        drop(command.wait_for(Option::is_none).await);
    }

    fn lose(&self, lost: Lost) {
        self.lost.send_if_modified(|known| {
            let first = known.is_none();
            known.get_or_insert(lost);
            first
        });
    }
}

/// All of them, by the token's path.
#[derive(Debug, Default)]
pub(crate) struct Guards {
    entries: HashMap<Path, HeldToken>,
    /// Grabs without an answer yet: while there are some, dropping the last guard must not release the token.
    asked: HashMap<Path, usize>,
}

#[derive(Debug)]
struct HeldToken {
    hold: Arc<Hold>,
    guards: usize,
    renew_at: Option<Instant>,
}

impl Guards {
    /// Notes a grant; a repeated grab of one's own token is the same ownership (M29).
    pub(crate) fn hold(&mut self, path: &Path, grant: GrantTerms, now: Instant) -> Arc<Hold> {
        if let Some(hold) = self.share(path, grant.fence) {
            self.renewed(path, grant.fence, grant.terms, now);
            return hold;
        }
        let hold = Arc::new(Hold {
            path: path.clone(),
            fence: grant.fence,
            delegation: grant.delegation,
            terms: Mutex::new(grant.terms),
            lost: watch::Sender::new(None),
            command: watch::Sender::new(None),
        });
        let mut entry = HeldToken {
            hold: Arc::clone(&hold),
            guards: 1,
            renew_at: None,
        };
        entry.renew(now);
        if let Some(older) = self.entries.insert(path.clone(), entry) {
            older.hold.lose(Lost::new("grabbed", None));
        }
        hold
    }

    /// Another guard of the ownership with this fence, if there is one.
    pub(crate) fn share(&mut self, path: &Path, fence: u64) -> Option<Arc<Hold>> {
        let entry = self.entry(path, fence)?;
        entry.guards += 1;
        Some(Arc::clone(&entry.hold))
    }

    fn entry(&mut self, path: &Path, fence: u64) -> Option<&mut HeldToken> {
        self.entries
            .get_mut(path)
            .filter(|entry| entry.hold.fence == fence)
    }

    /// A command is said under an ownership.
    pub(crate) fn said(&self, path: &Path, id: u64) {
        if let Some(entry) = self.entries.get(path) {
            entry.hold.command.send_replace(Some(id));
        }
    }

    /// A command has ended, or will not be carried out.
    pub(crate) fn ended(&self, id: u64) {
        for entry in self.entries.values() {
            entry
                .hold
                .command
                .send_if_modified(|command| command.take_if(|last| *last == id).is_some());
        }
    }

    /// A grab was sent.
    pub(crate) fn ask(&mut self, path: &Path) {
        *self.asked.entry(path.clone()).or_default() += 1;
    }

    /// A grab was answered; the ownership that it was to share, if that is to be given back now.
    pub(crate) fn answered(&mut self, path: &Path) -> Option<Arc<Hold>> {
        if let Some(asked) = self.asked.get_mut(path) {
            *asked -= 1;
            if *asked == 0 {
                self.asked.remove(path);
            }
        }
        self.remove_unguarded(path)
    }

    /// One guard less; whether it was the last of an ownership that is not lost.
    pub(crate) fn let_go(&mut self, hold: &Arc<Hold>) -> bool {
        let Some(entry) = self
            .entries
            .get_mut(&hold.path)
            .filter(|entry| Arc::ptr_eq(&entry.hold, hold))
        else {
            return false;
        };
        entry.guards -= 1;
        self.remove_unguarded(&hold.path).is_some()
    }

    fn remove_unguarded(&mut self, path: &Path) -> Option<Arc<Hold>> {
        let entry = self.entries.get(path)?;
        if entry.guards > 0 || self.asked.contains_key(path) {
            return None;
        }
        self.entries.remove(path).map(|entry| entry.hold)
    }

    /// The ownership with this fence is over.
    pub(crate) fn lose(&mut self, path: &Path, fence: u64, lost: Lost) -> bool {
        if self
            .entries
            .get(path)
            .is_none_or(|entry| entry.hold.fence != fence)
        {
            return false;
        }
        if let Some(entry) = self.entries.remove(path) {
            entry.hold.lose(lost);
        }
        true
    }

    /// Another peer has a higher fence, so the ownership is over even without `released`.
    pub(crate) fn outdate(&mut self, path: &Path, fence: u64, by: &str) {
        let known = self.entries.get(path).map(|entry| entry.hold.fence);
        if let Some(known) = known.filter(|known| *known < fence) {
            self.lose(path, known, Lost::new("grabbed", Some(by.to_owned())));
        }
    }

    /// The link is gone, and with it every ownership and every grab.
    pub(crate) fn lose_all(&mut self, lost: &Lost) {
        self.asked.clear();
        self.entries
            .drain()
            .for_each(|(_, entry)| entry.hold.lose(lost.clone()));
    }

    /// A renewal was granted.
    pub(crate) fn renewed(&mut self, path: &Path, fence: u64, terms: RenewalTerms, now: Instant) {
        if let Some(entry) = self.entry(path, fence) {
            *entry.hold.terms.lock() = terms;
            entry.renew(now);
        }
    }

    /// A renewal was put off.
    pub(crate) fn retry(&mut self, path: &Path, fence: u64, at: Instant) {
        if let Some(entry) = self.entry(path, fence) {
            entry.renew_at = Some(entry.renew_at.map_or(at, |planned| planned.min(at)));
        }
    }

    /// When the next renewal is due.
    pub(crate) fn next_renewal(&self) -> Option<Instant> {
        self.entries.values().filter_map(|entry| entry.renew_at).min()
    }

    /// The tokens to renew now; each comes again later, should no answer come.
    pub(crate) fn take_due(&mut self, now: Instant) -> Vec<(Path, u64)> {
        let due = self
            .entries
            .values_mut()
            .filter(|entry| entry.renew_at.is_some_and(|at| at <= now));
        due.map(|entry| {
            entry.renew(now);
            (entry.hold.path.clone(), entry.hold.fence)
        })
        .collect()
    }
}

impl HeldToken {
    fn renew(&mut self, now: Instant) {
        self.renew_at = self.hold.terms().renewal().map(|after| now + after);
    }
}
