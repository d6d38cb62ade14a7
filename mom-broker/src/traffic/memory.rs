//! What waits here, charged to the users who sent it, and the bound on all of it.
//!
//! One bound holds for the whole hub: what waits in outboxes and stop lanes, what channels keep, what has been read of
//! parcels that are not whole. Below three quarters of it nobody notices. Above, the hub is tight: largest queues lose
//! what may be dropped, and who is charged more than an equal share is held back. Above the bound itself, who is charged
//! most is refused, and after a second put out, with all that waits of it.

use std::collections::HashMap;
use std::sync::{Arc, Weak};

use mom_proto::{Code, Map, Micros, Value, WireError};
use mom_system::Clock;
use mom_system::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use mom_system::sync::{Mutex, Notify};

/// An account tells the ledger of so many bytes at once, so that its users do not all write to one place.
const STEP: usize = 16 * 1024;

/// Who is refused for so long, and still charged most above the bound, is put out.
const PATIENCE: Micros = 1_000_000;

/// Accounts that `stats` lists.
const LISTED: usize = 16;

/// The accounts of one broker.
#[derive(Debug, Default)]
pub(crate) struct Memory {
    ledger: Arc<Ledger>,
    accounts: Mutex<HashMap<Arc<str>, Weak<Account>>>,
}

/// What all accounts share.
#[derive(Debug)]
struct Ledger {
    /// `usize::MAX` = none.
    bound: AtomicUsize,
    /// As far as accounts have told.
    used: AtomicUsize,
    tight: AtomicBool,
    /// What one account may hold while the hub is tight.
    share: AtomicUsize,
    became_tight: Notify,
    relieved: Notify,
}

/// What is charged to one user.
#[derive(Debug)]
pub(crate) struct Account {
    user: Arc<str>,
    ledger: Arc<Ledger>,
    held: AtomicUsize,
    told: AtomicUsize,
    refused: AtomicBool,
    /// Since when, in µs.
    refused_since: Mutex<Micros>,
}

/// Bytes that are charged to an account for as long as this exists.
#[derive(Debug)]
pub(crate) struct Charge {
    account: Arc<Account>,
    bytes: usize,
}

/// Whether more of an account may be taken in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Gate {
    Open,
    /// A little later.
    Held,
    Refused,
}

impl Default for Ledger {
    fn default() -> Ledger {
        Ledger {
            bound: AtomicUsize::new(usize::MAX),
            used: AtomicUsize::new(0),
            tight: AtomicBool::new(false),
            share: AtomicUsize::new(usize::MAX),
            became_tight: Notify::new(),
            relieved: Notify::new(),
        }
    }
}

impl Ledger {
    /// Where the hub becomes tight.
    fn mark(&self) -> usize {
        self.bound.load(Ordering::Relaxed) / 4 * 3
    }

    fn used(&self) -> usize {
        whole(self.used.load(Ordering::Relaxed))
    }
}

impl Memory {
    /// Sets the bound, in bytes.
    pub(crate) fn set_bound(&self, bytes: usize) {
        self.ledger.bound.store(bytes, Ordering::Relaxed);
    }

    /// The account of a user, the same for all of its connections.
    pub(crate) fn account(&self, user: &Arc<str>) -> Arc<Account> {
        let mut accounts = self.accounts.lock();
        if let Some(account) = accounts.get(user).and_then(Weak::upgrade) {
            return account;
        }
        // Rarely: as many go as have come.
        if accounts.len().is_power_of_two() {
            accounts.retain(|_, account| account.strong_count() > 0);
        }
        let account = Arc::new(Account {
            user: Arc::clone(user),
            ledger: Arc::clone(&self.ledger),
            held: AtomicUsize::new(0),
            told: AtomicUsize::new(0),
            refused: AtomicBool::new(false),
            refused_since: Mutex::new(0),
        });
        accounts.insert(Arc::clone(user), Arc::downgrade(&account));
        account
    }

    /// Waits until the hub is tight.
    pub(crate) async fn tight(&self) {
        while !self.ledger.tight.load(Ordering::Acquire) {
            self.ledger.became_tight.notified().await;
        }
    }

    /// How many bytes have to go before the hub is not tight any more.
    pub(crate) fn excess(&self) -> usize {
        self.ledger.used().saturating_sub(self.ledger.mark())
    }

    /// Looks at all accounts: sets everybody's share, and gives who has to be put out. Ends what was tight once nothing is
    /// in excess.
    pub(crate) fn settle(&self, now: Micros) -> Option<Arc<Account>> {
        let accounts = self.live();
        accounts.iter().for_each(|account| account.tell());
        let (ledger, count) = (
            &self.ledger,
            accounts.iter().filter(|account| account.held() > 0).count(),
        );
        ledger
            .share
            .store(ledger.mark() / count.max(1), Ordering::Relaxed);
        if self.excess() == 0 {
            accounts
                .iter()
                .for_each(|account| account.refused.store(false, Ordering::Relaxed));
            ledger.tight.store(false, Ordering::Release);
            ledger.relieved.notify_waiters();
            return None;
        }
        if ledger.used() <= ledger.bound.load(Ordering::Relaxed) {
            accounts
                .iter()
                .for_each(|account| account.refused.store(false, Ordering::Relaxed));
            return None;
        }
        let most = accounts.into_iter().max_by_key(|account| account.held())?;
        let mut since = most.refused_since.lock();
        if !most.refused.swap(true, Ordering::Relaxed) {
            *since = now;
        }
        let over = now.saturating_sub(*since) >= PATIENCE;
        drop(since);
        over.then_some(most)
    }

    /// How many bytes are held, and how many may be; none = as many as there are.
    pub(crate) fn used_and_bound(&self) -> (usize, Option<usize>) {
        let bound = self.ledger.bound.load(Ordering::Relaxed);
        (self.ledger.used(), (bound != usize::MAX).then_some(bound))
    }

    /// Bound, use, and who is charged most, for `stats`.
    pub(crate) fn to_map(&self) -> Map {
        let int = |bytes: usize| i64::try_from(bytes).unwrap_or(i64::MAX);
        let mut accounts = self.live();
        accounts.iter().for_each(|account| account.tell());
        accounts.sort_by_key(|account| std::cmp::Reverse(account.held()));
        let users = accounts.iter().filter(|account| account.held() > 0).take(LISTED);
        let users: Vec<Value> = users
            .map(|account| {
                Map::new()
                    .with("user", &*account.user)
                    .with("bytes", int(account.held()))
                    .into()
            })
            .collect();
        let map = Map::new()
            .with("used", int(self.ledger.used()))
            .with("users", users);
        match self.ledger.bound.load(Ordering::Relaxed) {
            usize::MAX => map,
            bound => map.with("bound", int(bound)),
        }
    }

    fn live(&self) -> Vec<Arc<Account>> {
        self.accounts.lock().values().filter_map(Weak::upgrade).collect()
    }
}

impl Account {
    /// Charges so many bytes.
    pub(crate) fn charge(self: &Arc<Account>, bytes: usize) -> Charge {
        self.change(bytes);
        Charge {
            account: Arc::clone(self),
            bytes,
        }
    }

    /// Whose it is.
    pub(crate) fn user(&self) -> &str {
        &self.user
    }

    /// The bytes that are charged.
    pub(crate) fn held(&self) -> usize {
        self.held.load(Ordering::Relaxed)
    }

    /// Whether more may be taken in for this user.
    pub(crate) fn gate(&self) -> Gate {
        if !self.ledger.tight.load(Ordering::Acquire)
            || self.held() <= self.ledger.share.load(Ordering::Relaxed)
        {
            return Gate::Open;
        }
        match self.refused.load(Ordering::Relaxed) {
            true => Gate::Refused,
            false => Gate::Held,
        }
    }

    /// Waits until the hub is not tight any more, at most until this time.
    pub(crate) async fn relieved(&self, clock: &Clock, until: Micros) {
        let relieved = self.ledger.relieved.notified();
        if self.gate() == Gate::Open {
            return;
        }
        tokio::select! {
            () = relieved => {}
            () = clock.reach(until) => {}
        }
    }

    /// Adds bytes, or, as wrapping, takes them away.
    fn change(&self, bytes: usize) {
        let held = self.held.fetch_add(bytes, Ordering::Relaxed).wrapping_add(bytes);
        if held.abs_diff(self.told.load(Ordering::Relaxed)) >= STEP {
            self.tell();
        }
    }

    fn tell(&self) {
        let held = self.held();
        let told = self.told.swap(held, Ordering::Relaxed);
        let change = held.wrapping_sub(told);
        let ledger = &self.ledger;
        let used = ledger
            .used
            .fetch_add(change, Ordering::Relaxed)
            .wrapping_add(change);
        if whole(used) > ledger.mark() && !ledger.tight.swap(true, Ordering::AcqRel) {
            ledger.became_tight.notify_one();
        }
    }
}

impl Charge {
    /// Where it is charged.
    pub(crate) fn account(&self) -> &Arc<Account> {
        &self.account
    }

    /// Whether it is of this account.
    pub(crate) fn is_of(&self, account: &Arc<Account>) -> bool {
        Arc::ptr_eq(&self.account, account)
    }

    /// Whether it is something, and more of its account has to wait.
    pub(crate) fn is_held(&self) -> bool {
        self.bytes > 0 && self.account.gate() != Gate::Open
    }

    /// Changes it to so many bytes.
    pub(crate) fn set(&mut self, bytes: usize) {
        if bytes != self.bytes {
            self.account.change(bytes.wrapping_sub(self.bytes));
            self.bytes = bytes;
        }
    }
}

impl Drop for Charge {
    fn drop(&mut self) {
        self.set(0);
    }
}

/// Two threads of one account may tell what they changed in another order than they changed it: less than nothing is
/// nothing.
fn whole(used: usize) -> usize {
    match used > isize::MAX.unsigned_abs() {
        true => 0,
        false => used,
    }
}

/// Why something is refused of who is charged most.
pub(crate) fn over_memory() -> WireError {
    let text =
        "the hub's memory is exhausted, and this user's queued messages take more of it than any other's";
    WireError::new(Code::OVER_MEMORY, text).retry_after(std::time::Duration::from_secs(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    const MIB: usize = 1 << 20;

    #[test]
    fn who_holds_most_is_held_back_then_refused_then_put_out() {
        let memory = Memory::default();
        memory.set_bound(4 * MIB);
        let [alice, bob] = ["alice", "bob"].map(|user| memory.account(&user.into()));
        let little = bob.charge(10_000);
        let much = alice.charge(2 * MIB);
        assert_eq!((alice.gate(), memory.excess()), (Gate::Open, 0));
        let more = alice.charge(MIB + 100_000);
        assert!(memory.excess() >= 100_000);
        assert!(memory.settle(0).is_none());
        assert_eq!((alice.gate(), bob.gate()), (Gate::Held, Gate::Open));
        let most = bob.charge(MIB);
        assert!(memory.settle(10).is_none(), "at first it is only refused");
        assert_eq!((alice.gate(), bob.gate()), (Gate::Refused, Gate::Open));
        assert!(memory.settle(PATIENCE).is_none());
        let out = memory.settle(PATIENCE + 10).expect("it did not become less");
        assert!(Arc::ptr_eq(&out, &alice));
        drop((much, more));
        assert!(memory.settle(PATIENCE + 20).is_none());
        assert_eq!((alice.gate(), memory.excess()), (Gate::Open, 0));
        drop((little, most));
        let told = memory.to_map();
        assert_eq!(told.get("used"), Some(&Value::Int(0)), "{told:?}");
    }

    #[test]
    fn users_have_one_account_and_are_listed_by_what_they_hold() {
        let memory = Memory::default();
        let account = memory.account(&"alice".into());
        assert!(Arc::ptr_eq(&account, &memory.account(&"alice".into())));
        let small = account.charge(5);
        let mut large = memory.account(&"bob".into()).charge(7);
        assert!(!small.is_of(large.account()) && small.is_of(&account));
        large.set(100);
        let told = memory.to_map();
        let users = told.get("users").and_then(Value::as_list).expect("a list");
        let users: Vec<_> = users
            .iter()
            .map(|user| (user.get("user").cloned(), user.get("bytes").cloned()))
            .collect();
        let row = |user: &str, bytes: i64| (Some(Value::from(user)), Some(Value::Int(bytes)));
        assert_eq!(users, [row("bob", 100), row("alice", 5)]);
        assert_eq!(
            (told.get("used"), told.get("bound")),
            (Some(&Value::Int(105)), None)
        );
    }

    #[test]
    fn threads_that_tell_at_once_lose_nothing() {
        let memory = Memory::default();
        let account = memory.account(&"alice".into());
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| (0..2000).for_each(|number| drop(account.charge(number * 64))));
            }
        });
        account.tell();
        assert_eq!((account.held(), memory.ledger.used()), (0, 0));
    }
}
