//! Shuttle's primitives with the methods of parking_lot and tokio that the broker uses.

use std::ops::{Deref, DerefMut};
use std::sync::{PoisonError, TryLockError};
use std::task::{Poll, Waker};

/// As `parking_lot::Mutex`: nothing is poisoned, because a panic ends the test.
#[derive(Debug, Default)]
pub struct Mutex<T>(shuttle::sync::Mutex<T>);

/// As `parking_lot::MutexGuard`; it is empty only while a [`Condvar`] waits.
#[derive(Debug)]
pub struct MutexGuard<'a, T>(Option<shuttle::sync::MutexGuard<'a, T>>);

impl<T> Mutex<T> {
    /// As its model.
    pub fn new(value: T) -> Mutex<T> {
        Mutex(shuttle::sync::Mutex::new(value))
    }

    /// As its model.
    pub fn lock(&self) -> MutexGuard<'_, T> {
        MutexGuard(Some(self.0.lock().unwrap_or_else(PoisonError::into_inner)))
    }

    /// As its model.
    pub fn try_lock(&self) -> Option<MutexGuard<'_, T>> {
        match self.0.try_lock() {
            Ok(guard) => Some(MutexGuard(Some(guard))),
            Err(TryLockError::Poisoned(error)) => Some(MutexGuard(Some(error.into_inner()))),
            Err(TryLockError::WouldBlock) => None,
        }
    }
}

impl<T> Deref for MutexGuard<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.0.as_ref().expect("nobody looks while it waits")
    }
}

impl<T> DerefMut for MutexGuard<'_, T> {
    fn deref_mut(&mut self) -> &mut T {
        self.0.as_mut().expect("nobody looks while it waits")
    }
}

/// As `parking_lot::Condvar`, which takes the guard by reference.
#[derive(Debug, Default)]
pub struct Condvar(shuttle::sync::Condvar);

impl Condvar {
    /// As its model.
    pub fn new() -> Condvar {
        Condvar::default()
    }

    /// As its model.
    pub fn wait<T>(&self, guard: &mut MutexGuard<'_, T>) {
        let held = guard.0.take().expect("nobody else waits with it");
        guard.0 = Some(self.0.wait(held).unwrap_or_else(PoisonError::into_inner));
    }

    /// How many it has woken is not known here; nobody asks.
    pub fn notify_all(&self) -> usize {
        self.0.notify_all();
        0
    }
}

/// As `tokio::sync::Notify`, where one task at a time waits for the permit, which is kept until it is taken, or any
/// number of them for all to be woken, which is not kept.
#[derive(Debug)]
pub struct Notify(Mutex<Permit>);

#[derive(Debug, Default)]
struct Permit {
    given: bool,
    /// How often all were woken.
    rounds: u64,
    waiting: Vec<Waker>,
}

impl Notify {
    /// Without a permit.
    pub fn new() -> Notify {
        Notify(Mutex::new(Permit::default()))
    }

    /// Gives the permit, and wakes the task that waits for it.
    pub fn notify_one(&self) {
        let mut permit = self.0.lock();
        permit.given = true;
        let waiting = std::mem::take(&mut permit.waiting);
        drop(permit);
        waiting.into_iter().for_each(Waker::wake);
    }

    /// Wakes the waiters, without a permit for later ones.
    pub fn notify_waiters(&self) {
        let mut permit = self.0.lock();
        permit.rounds += 1;
        let waiting = std::mem::take(&mut permit.waiting);
        drop(permit);
        waiting.into_iter().for_each(Waker::wake);
    }

    /// Waits for the permit and takes it, or for the next time that all are woken; as its model's, that counts from
    /// here and not from the first poll.
    pub fn notified(&self) -> impl Future<Output = ()> + '_ {
        let since = self.0.lock().rounds;
        std::future::poll_fn(move |context| {
            let mut permit = self.0.lock();
            if permit.rounds != since || std::mem::take(&mut permit.given) {
                return Poll::Ready(());
            }
            permit.waiting.push(context.waker().clone());
            Poll::Pending
        })
    }
}
