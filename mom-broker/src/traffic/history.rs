//! What a channel keeps for late joiners: in order, bounded, given with its true age (design §4, §7).

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use mom_hub::{Keep, PeerId};
use mom_proto::{HISTORY, Micros, Parcel, Time};

use crate::traffic::memory::{Account, Charge};

/// What a parcel counts beside its size: the slots of its head, and its place here.
const OVERHEAD: usize = 256;

/// The parcels that one channel keeps, by the order in which they came.
#[derive(Debug)]
pub(crate) struct History {
    keep: Keep,
    kept: BTreeMap<u64, Arc<Kept>>,
    /// Where the newest of a sender and name is, if only that is kept.
    newest: HashMap<(PeerId, Arc<str>), u64>,
    bytes: usize,
    next: u64,
}

/// One of them.
#[derive(Debug)]
pub(crate) struct Kept {
    parcel: Parcel,
    sender: PeerId,
    came: Micros,
    size: usize,
    charge: Option<Charge>,
}

impl Kept {
    /// The bytes that it counts.
    pub(crate) fn size(&self) -> usize {
        self.size
    }

    /// What a joiner gets at this moment, marked, and stamped anew, so that its age is its age now; none if its time is
    /// over.
    pub(crate) fn at(&self, now: Micros, wall: Time) -> Option<Parcel> {
        let since = i64::try_from(now.saturating_sub(self.came)).unwrap_or(i64::MAX);
        let age = self.parcel.age.unwrap_or_default().saturating_add(since);
        let life = self.parcel.expires.map(|expires| expires.saturating_mul(1000));
        let over = life.is_some_and(|life| u64::try_from(age).is_ok_and(|age| age >= life));
        if over {
            return None;
        }
        let mut parcel = self.parcel.clone();
        parcel.received = Some(wall);
        parcel.age = Some(age);
        parcel.receipt = None;
        parcel.extra.set(HISTORY, true);
        Some(parcel)
    }
}

impl History {
    pub(crate) fn new(keep: Keep) -> History {
        History {
            keep,
            kept: BTreeMap::new(),
            newest: HashMap::new(),
            bytes: 0,
            next: 0,
        }
    }

    pub(crate) fn keep(&self) -> &Keep {
        &self.keep
    }

    /// Whether this is for later at all: an addressed message is not for who comes then.
    pub(crate) fn covers(parcel: &Parcel) -> bool {
        parcel.address.is_none() && Keep::covers(&parcel.name)
    }

    /// Keeps a parcel that was admitted now, and lets go of what it leaves no room for.
    pub(crate) fn note(
        &mut self,
        sender: PeerId,
        parcel: Parcel,
        now: Micros,
        account: Option<&Arc<Account>>,
    ) {
        let origin = (sender, Arc::clone(&parcel.name));
        if self.keep.latest
            && let Some(old) = self.newest.remove(&origin)
        {
            self.forget(old);
        }
        let size = OVERHEAD + parcel.size();
        if size > self.keep.bytes {
            return;
        }
        while self.kept.len() >= self.keep.parcels || self.bytes + size > self.keep.bytes {
            let Some(oldest) = self.kept.first_key_value().map(|(place, _)| *place) else {
                break;
            };
            self.forget(oldest);
        }
        if self.keep.latest {
            self.newest.insert(origin, self.next);
        }
        self.bytes += size;
        let kept = Kept {
            parcel,
            sender,
            came: now,
            size,
            charge: account.map(|account| account.charge(size)),
        };
        self.kept.insert(self.next, Arc::new(kept));
        self.next += 1;
    }

    /// Lets go of the newest values of a peer that has left: nobody's state is not a state. A history stays.
    pub(crate) fn leave(&mut self, peer: PeerId) {
        if !self.keep.latest {
            return;
        }
        let of_peer = |(place, kept): (&u64, &Arc<Kept>)| (kept.sender == peer).then_some(*place);
        let gone: Vec<u64> = self.kept.iter().filter_map(of_peer).collect();
        gone.into_iter().for_each(|place| self.forget(place));
    }

    /// Lets go of all that is charged to an account.
    pub(crate) fn forget_of(&mut self, account: &Arc<Account>) {
        let is_of = |kept: &Kept| kept.charge.as_ref().is_some_and(|charge| charge.is_of(account));
        let gone = self.kept.iter().filter(|(_, kept)| is_of(kept));
        let gone: Vec<u64> = gone.map(|(place, _)| *place).collect();
        gone.into_iter().for_each(|place| self.forget(place));
    }

    /// What is kept at this moment and passes `covers`, oldest first.
    pub(crate) fn snapshot(&mut self, now: Micros, covers: impl Fn(&Parcel) -> bool) -> Arc<[Arc<Kept>]> {
        if let Some(most) = self.keep.age {
            let old = |kept: &Kept| now.saturating_sub(kept.came) > most;
            // In the order in which they came, so the old ones are in front.
            while let Some((place, _)) = self.kept.first_key_value().filter(|(_, kept)| old(kept)) {
                let place = *place;
                self.forget(place);
            }
        }
        let kept = self.kept.values().filter(|kept| covers(&kept.parcel));
        kept.cloned().collect()
    }

    fn forget(&mut self, place: u64) {
        let Some(kept) = self.kept.remove(&place) else {
            return;
        };
        self.bytes -= kept.size;
        let origin = (kept.sender, Arc::clone(&kept.parcel.name));
        if self.newest.get(&origin) == Some(&place) {
            self.newest.remove(&origin);
        }
    }
}

#[cfg(test)]
mod tests {
    use mom_proto::Family;

    use super::*;

    const SECOND: Micros = 1_000_000;

    fn history(latest: bool, parcels: usize, bytes: usize, age: Option<Micros>) -> History {
        History::new(Keep {
            latest,
            parcels,
            bytes,
            age,
        })
    }

    fn parcel(name: &str, content: &str) -> Parcel {
        let mut parcel = Parcel::new(Family::Message, name).content(content);
        parcel.age = Some(5);
        parcel
    }

    /// Contents and ages of what is given.
    fn given(history: &mut History, now: Micros) -> Vec<(String, i64)> {
        let wall = Time::from_micros(77).expect("a time");
        let given = history.snapshot(now, |_| true);
        let told = given.iter().filter_map(|kept| kept.at(now, wall)).map(|parcel| {
            assert_eq!(parcel.received, Some(wall));
            assert_eq!(parcel.extra.get(HISTORY), Some(&true.into()));
            let content = parcel.value();
            (
                content.as_str().expect("text").to_owned(),
                parcel.age.expect("an age"),
            )
        });
        told.collect()
    }

    fn texts(history: &mut History, now: Micros) -> Vec<String> {
        given(history, now).into_iter().map(|(text, _)| text).collect()
    }

    #[test]
    fn the_newest_of_each_sender_and_name() {
        let mut history = history(true, 10, 1 << 20, None);
        let (one, two) = (PeerId(1), PeerId(2));
        for (sender, name, text) in [
            (one, "state", "a"),
            (two, "state", "b"),
            (one, "state", "c"),
            (one, "status", "d"),
        ] {
            history.note(sender, parcel(name, text), 0, None);
        }
        assert_eq!(texts(&mut history, 0), ["b", "c", "d"]);
        history.leave(one);
        assert_eq!(given(&mut history, SECOND), [("b".to_owned(), 1_000_005)]);
        assert!(history.newest.len() == 1 && history.bytes > 0);
        history.leave(two);
        assert_eq!((history.newest.len(), history.bytes), (0, 0));
    }

    #[test]
    fn a_history_is_bounded_in_number_bytes_and_age() {
        let mut few = history(false, 2, 1 << 20, None);
        let mut small = history(false, 100, 2 * OVERHEAD + 600, None);
        let mut young = history(false, 100, 1 << 20, Some(3 * SECOND));
        let long = "x".repeat(250);
        for (number, text) in ["a", "b", "c", &long, &long].into_iter().enumerate() {
            for history in [&mut few, &mut small, &mut young] {
                history.note(PeerId(1), parcel("say", text), SECOND * number as u64, None);
            }
        }
        few.leave(PeerId(1));
        assert_eq!(texts(&mut few, 0), [long.clone(), long.clone()]);
        assert_eq!(texts(&mut small, 0), [long.clone(), long.clone()]);
        assert_eq!(texts(&mut young, 5 * SECOND), ["c", &*long, &*long]);
        assert_eq!(texts(&mut young, 60 * SECOND), Vec::<String>::new());
        assert_eq!(young.bytes, 0);
        small.note(PeerId(1), parcel("say", &"y".repeat(4000)), 0, None);
        assert_eq!(
            texts(&mut small, 0).len(),
            2,
            "what is too large for all room displaces nothing"
        );
    }

    #[test]
    fn what_is_over_is_not_given() {
        let mut history = history(false, 10, 1 << 20, None);
        let mut short = parcel("say", "short");
        short.expires = Some(1000);
        history.note(PeerId(1), short, 0, None);
        assert_eq!(texts(&mut history, SECOND - 6), ["short"]);
        assert_eq!(texts(&mut history, SECOND - 5), Vec::<String>::new());
    }

    #[test]
    fn nothing_that_moves_a_device_is_for_later() {
        for name in ["command", "stop", "unstop", "halt"] {
            assert!(!History::covers(&parcel(name, "")), "{name}");
        }
        let mut addressed = parcel("say", "to bob");
        assert!(History::covers(&addressed));
        addressed.address = Some(vec!["bob".into()]);
        assert!(!History::covers(&addressed));
    }
}
