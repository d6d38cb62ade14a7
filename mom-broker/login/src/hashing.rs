//! The bounded pool in which passwords are hashed (threat 16).
//!
//! Hashing takes a core for some 20 ms, so only so many passwords are hashed at once and only so many logins wait for
//! that. Logins from places where their users have logged in before have a lane of their own, and every other hash is one
//! of theirs: a storm of strangers, however great, does not keep them out.

use std::collections::{HashMap, VecDeque};
use std::net::IpAddr;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use mom_proto::{Code, WireError};
use mom_system::give_way;
use parking_lot::Mutex;
use tokio::sync::oneshot;

use super::password::matches;

/// How far hashing threads give way: a renewal or a stop must not wait until a stranger's password is hashed. An idle core
/// is still used for hashing.
const NICENESS: i32 = 5;

/// Logins of one user from one known place that wait in the lane for those; more wait with the strangers.
const OF_PLACE: usize = 8;

/// Statistics of password hashing since the broker's start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct LoginStats {
    /// Logins whose password waits to be hashed, or is being hashed.
    pub waiting: usize,
    /// Passwords that were hashed.
    pub hashed: u64,
    /// Those that are being hashed now.
    pub hashing: usize,
    /// The most that were hashed at one time.
    pub most: usize,
}

/// A user and where it has logged in before.
pub(super) type KnownPlace = (String, IpAddr);

/// The pool. Its threads end when there is nothing to hash, and the memory that they hash in goes with them.
#[derive(Debug)]
pub(super) struct Hashing {
    pub(super) hashers: usize,
    lanes: Arc<Mutex<Lanes>>,
}

#[derive(Debug, Default)]
struct Lanes {
    known: VecDeque<Check>,
    strangers: VecDeque<Check>,
    /// Whether the next one is a stranger's, if both wait.
    strangers_turn: bool,
    /// Logins that wait or are being hashed.
    strangers_count: usize,
    of_place: HashMap<KnownPlace, usize>,
    threads: usize,
    put_off: u32,
    last: u64,
    stats: LoginStats,
}

/// A password to be checked.
#[derive(Debug)]
struct Check {
    id: u64,
    password: String,
    hash: String,
    answer: oneshot::Sender<bool>,
}

impl Hashing {
    pub(super) fn new(hashers: usize) -> Hashing {
        Hashing {
            hashers,
            lanes: Arc::default(),
        }
    }

    /// Whether the password belongs to the hash.
    ///
    /// # Errors
    /// `try-later` when `most` logins are waiting here.
    pub(super) async fn verify(
        &self,
        password: String,
        hash: String,
        known: Option<KnownPlace>,
        most: usize,
    ) -> Result<bool, WireError> {
        let (answer, answered) = oneshot::channel();
        let _waiting = self.enter((password, hash, answer), known, most)?;
        answered.await.map_err(|_| failed())
    }

    fn enter(
        &self,
        (password, hash, answer): (String, String, oneshot::Sender<bool>),
        known: Option<KnownPlace>,
        most: usize,
    ) -> Result<WaitingLogin, WireError> {
        let mut lanes = self.lanes.lock();
        let of_place = |place: &KnownPlace| lanes.of_place.get(place).copied().unwrap_or_default();
        let known = known.filter(|place| of_place(place) < OF_PLACE);
        if known.is_none() && lanes.strangers_count >= most {
            let error = WireError::new(Code::TRY_LATER, "too many logins at once");
            // Spread, or all who were put off would come again at once, and hold up those who are in.
            lanes.put_off = lanes.put_off.wrapping_add(1);
            let spread = u64::from(lanes.put_off.wrapping_mul(37) % 1000);
            return Err(error.retry_after(Duration::from_millis(1000 + spread)));
        }
        if lanes.threads < self.hashers {
            let shared = Arc::clone(&self.lanes);
            let thread = thread::Builder::new().name("hash".to_owned());
            match thread.spawn(move || work(&shared)) {
                Ok(_) => lanes.threads += 1,
                Err(_) if lanes.threads == 0 => return Err(failed()),
                Err(_) => {}
            }
        }
        lanes.last += 1;
        let check = Check {
            id: lanes.last,
            password,
            hash,
            answer,
        };
        let waiting = WaitingLogin {
            lanes: Arc::clone(&self.lanes),
            id: lanes.last,
            known: known.clone(),
        };
        lanes.stats.waiting += 1;
        match known {
            Some(place) => {
                *lanes.of_place.entry(place).or_default() += 1;
                lanes.known.push_back(check);
            }
            None => {
                lanes.strangers_count += 1;
                lanes.strangers.push_back(check);
            }
        }
        Ok(waiting)
    }

    pub(super) fn stats(&self) -> LoginStats {
        self.lanes.lock().stats
    }

    #[cfg(feature = "occupy")]
    pub(super) async fn occupy(&self) -> Occupied {
        loop {
            {
                let mut lanes = self.lanes.lock();
                if lanes.threads == 0 {
                    lanes.threads = self.hashers;
                    return Occupied(Arc::clone(&self.lanes), self.hashers);
                }
            }
            tokio::task::yield_now().await;
        }
    }
}

/// All places in the pool, until it is dropped.
#[cfg(feature = "occupy")]
#[derive(Debug)]
pub(super) struct Occupied(Arc<Mutex<Lanes>>, usize);

#[cfg(feature = "occupy")]
impl Drop for Occupied {
    fn drop(&mut self) {
        for _ in 0..self.1 {
            let shared = Arc::clone(&self.0);
            thread::spawn(move || work(&shared));
        }
    }
}

/// Hashes until nothing waits.
fn work(shared: &Mutex<Lanes>) {
    give_way(NICENESS);
    let mut memory = Vec::new();
    while let Some(check) = next(shared) {
        let matches = matches(&check.password, &check.hash, &mut memory);
        let mut lanes = shared.lock();
        lanes.stats.hashing -= 1;
        lanes.stats.hashed += 1;
        drop(lanes);
        // The receiver is gone if the login was abandoned.
        let _ = check.answer.send(matches);
    }
}

/// The next one; if there is none the thread ends, and is not counted any more.
fn next(shared: &Mutex<Lanes>) -> Option<Check> {
    let mut lanes = shared.lock();
    let lanes = &mut *lanes;
    let (first, second) = match lanes.strangers_turn {
        true => (&mut lanes.strangers, &mut lanes.known),
        false => (&mut lanes.known, &mut lanes.strangers),
    };
    lanes.strangers_turn = !lanes.strangers_turn;
    let Some(check) = first.pop_front().or_else(|| second.pop_front()) else {
        lanes.threads -= 1;
        return None;
    };
    lanes.stats.hashing += 1;
    lanes.stats.most = lanes.stats.most.max(lanes.stats.hashing);
    Some(check)
}

fn failed() -> WireError {
    WireError::new(Code::TRY_LATER, "the login failed here").retry_after(Duration::from_secs(1))
}

/// A login that waits; one that is abandoned makes way.
struct WaitingLogin {
    lanes: Arc<Mutex<Lanes>>,
    id: u64,
    known: Option<KnownPlace>,
}

impl Drop for WaitingLogin {
    fn drop(&mut self) {
        let mut lanes = self.lanes.lock();
        lanes.stats.waiting -= 1;
        let queue = match &self.known {
            Some(place) => {
                if let Some(count) = lanes.of_place.get_mut(place) {
                    *count -= 1;
                    if *count == 0 {
                        lanes.of_place.remove(place);
                    }
                }
                &mut lanes.known
            }
            None => {
                lanes.strangers_count -= 1;
                &mut lanes.strangers
            }
        };
        queue.retain(|check| check.id != self.id);
    }
}

#[cfg(all(test, feature = "occupy"))]
mod tests {
    use super::*;
    use crate::hash;

    fn place(number: u8) -> KnownPlace {
        ("alice".to_owned(), IpAddr::from([127, 0, 0, number]))
    }

    /// Threat 41: however many strangers wait, who logs in from a known place is let in to wait, and is next but one.
    #[tokio::test]
    async fn a_storm_of_strangers_does_not_keep_known_places_out() {
        let hashing = Arc::new(Hashing::new(1));
        let hash = hash("secret").expect("a hash");
        let occupied = hashing.occupy().await;
        let (told, mut order) = tokio::sync::mpsc::unbounded_channel();
        let mut waiting = Vec::new();
        let mut come = |known: Option<KnownPlace>, who: u8| {
            let (answer, answered) = oneshot::channel();
            let check = ("secret".to_owned(), hash.clone(), answer);
            let entered = hashing.enter(check, known, 4);
            let told = told.clone();
            if entered.is_ok() {
                tokio::spawn(async move {
                    assert_eq!(answered.await, Ok(true));
                    told.send(who).expect("the receiver is there");
                });
            }
            waiting.extend(entered.ok());
            waiting.len()
        };
        let come_to = (0..10).map(|who| come(None, who)).last();
        assert_eq!(come_to, Some(4), "the others are told to come later");
        assert_eq!(come(Some(place(1)), 100), 5);
        assert_eq!(
            (0..20).map(|who| come(Some(place(2)), 200 + who)).last(),
            Some(13)
        );
        assert_eq!(come(Some(place(1)), 101), 14, "other places are not concerned");
        drop(occupied);
        let mut heard = Vec::new();
        for _ in 0..14 {
            heard.push(order.recv().await.expect("an answer"));
        }
        let rank = |who| heard.iter().position(|heard| *heard == who);
        assert!(rank(100) < rank(1) && rank(1) < rank(206), "{heard:?}");
        drop(waiting);
        assert_eq!(hashing.stats().waiting, 0);
    }

    #[tokio::test]
    async fn who_goes_makes_way() {
        let hashing = Hashing::new(1);
        let occupied = hashing.occupy().await;
        for known in [None, Some(place(1))] {
            for _ in 0..100 {
                let (answer, _) = oneshot::channel();
                let check = (String::new(), String::new(), answer);
                drop(hashing.enter(check, known.clone(), 1).expect("a place"));
            }
        }
        let lanes = hashing.lanes.lock();
        assert!(lanes.known.is_empty() && lanes.strangers.is_empty() && lanes.of_place.is_empty());
        drop(lanes);
        drop(occupied);
        assert_eq!(hashing.stats().hashed, 0);
    }
}
