//! Which devices of a channel are stopped, and by the order of causes: every stop has a number that only rises, and an
//! unstop lifts no stop above the number that it names, whichever way the two came (M43).

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use mom_proto::{Fence, Map, Path, Time, Value};

/// Devices of one channel that are remembered by name; where there would be more, all of the channel are stopped.
const NAMES: usize = 256;

/// One stop.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stop {
    /// Its number.
    pub number: Fence,
    /// The peer that said it.
    pub by: Arc<str>,
    /// Its user.
    pub user: Arc<str>,
    /// When the hub took it.
    pub since: Time,
    /// The reason, in the sender's words.
    pub reason: Option<Arc<str>>,
}

/// The stops of one channel that hold.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Latch {
    /// The number of the newest stop, which may be lifted since; 0 before the first.
    pub newest: Fence,
    /// The first number of which it is known what has become of it; 0 before the first. A device may stand by an older one of which a hub
    /// before this one knew.
    pub known: Fence,
    /// Up to which number all stops of the channel were lifted.
    pub lifted: Fence,
    /// The stop that holds for every device that `each` does not name, also for those that are away.
    pub all: Option<Arc<Stop>>,
    /// Devices for which another one holds, newer than `all`; none = it was lifted for this one.
    pub each: BTreeMap<Arc<str>, Option<Arc<Stop>>>,
    /// Whether a device has ever been there: a stop of the session is for it, too, while it is away and its channel with it.
    pub device: bool,
}

/// A latch as it is kept: what a restart of the hub must not forget.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StopRecord {
    /// The channel.
    pub path: Path,
    /// What holds there.
    pub latch: Latch,
}

/// What an unstop did not lift: a newer stop, and the device that it holds for; none = all of the channel.
pub(crate) type Newer = (Option<Arc<str>>, Arc<Stop>);

impl Latch {
    /// Whether a stop holds for any device.
    pub fn is_stopped(&self) -> bool {
        self.all.is_some() || self.each.values().any(Option::is_some)
    }

    /// The stop that holds for this device.
    pub fn holding(&self, device: &str) -> Option<&Arc<Stop>> {
        match self.each.get(device) {
            Some(own) => own.as_ref(),
            None => self.all.as_ref(),
        }
    }

    /// The newest stop that holds for a device by name whose name is this one but for what the hub added to make it another
    /// (`arm~2`); none if this one is stopped itself.
    pub(crate) fn of_namesake(&self, device: &str) -> Option<Stop> {
        let stem = |name: &str| name.split('~').next().unwrap_or_default().to_owned();
        if self.holding(device).is_some() {
            return None;
        }
        let namesakes = self.each.iter().filter(|(name, _)| stem(name) == stem(device));
        let stop = namesakes
            .filter_map(|(_, own)| own.as_ref())
            .max_by_key(|stop| stop.number);
        stop.map(|stop| Stop::clone(stop))
    }

    /// Takes in a stop that the hub has numbered now.
    pub(crate) fn issue(&mut self, stop: Stop, only: Option<&[Arc<str>]>) -> bool {
        if self.known == Fence::default() {
            self.known = stop.number;
        }
        self.stop(stop, only)
    }

    /// Takes in what a device says that joins: the newest stop that it has heard of, and whether it stands for it. Gives whether that is a
    /// stop which is to hold for it, as nothing is known of its end.
    pub(crate) fn meet(&mut self, device: &str, number: Fence, stopped: bool) -> bool {
        let is_known = self.known != Fence::default() && number >= self.known;
        let was_newest = number <= self.newest;
        if !was_newest {
            // What was said between is not known either.
            (self.newest, self.known) = (number, number.next());
        }
        let ended = was_newest && is_known || number <= self.lifted;
        stopped && !ended && self.holding(device).is_none()
    }

    /// Takes in a stop for these devices, or for all. Gives whether it stops one that no stop held.
    pub(crate) fn stop(&mut self, stop: Stop, only: Option<&[Arc<str>]>) -> bool {
        self.newest = self.newest.max(stop.number);
        let stop = Arc::new(stop);
        let known = self.each.keys().chain(only.unwrap_or_default());
        let many = known.collect::<BTreeSet<_>>().len() > NAMES;
        match only.filter(|_| !many) {
            None => {
                let before = std::mem::take(&mut self.each);
                let was_whole = self.all.is_some() && before.values().all(Option::is_some);
                // One by name may be an older one, of a namesake.
                let newest = before.into_values().flatten().chain([stop]);
                self.all = newest.max_by_key(|stop| stop.number);
                !was_whole
            }
            Some(names) => {
                let new = names.iter().any(|name| self.holding(name).is_none());
                let stops = names
                    .iter()
                    .map(|name| (Arc::clone(name), Some(Arc::clone(&stop))));
                self.each.extend(stops);
                new
            }
        }
    }

    /// Lifts what holds for these devices, or for all, up to a number. Gives what is newer and holds on.
    pub(crate) fn lift(&mut self, up_to: Fence, only: Option<&[Arc<str>]>) -> Vec<Newer> {
        let mut newer = Vec::new();
        let Some(names) = only else {
            self.lifted = self.lifted.max(up_to);
            if let Some(all) = self.all.take_if(|all| all.number <= up_to) {
                drop(all);
            } else if let Some(all) = &self.all {
                newer.push((None, Arc::clone(all)));
                return newer;
            }
            self.each.retain(|name, own| match own {
                Some(own) if own.number > up_to => {
                    newer.push((Some(Arc::clone(name)), Arc::clone(own)));
                    true
                }
                _ => false,
            });
            return newer;
        };
        for name in names {
            match self.holding(name) {
                None => {}
                Some(own) if own.number > up_to => newer.push((Some(Arc::clone(name)), Arc::clone(own))),
                // Forgetting a name makes it one of all, so one too many stays stopped.
                Some(_) if self.all.is_some() && self.each.len() < NAMES => {
                    self.each.insert(Arc::clone(name), None);
                }
                Some(own) if self.all.is_some() => newer.push((Some(Arc::clone(name)), Arc::clone(own))),
                Some(_) => drop(self.each.remove(name)),
            }
        }
        newer
    }

    /// Takes in what another hub has kept of the same channel: whatever holds in one of both holds.
    pub fn join(&mut self, other: &Latch) {
        let newer = |one: Option<&Arc<Stop>>, other: Option<&Arc<Stop>>| {
            one.into_iter()
                .chain(other)
                .max_by_key(|stop| stop.number)
                .cloned()
        };
        let all = newer(self.all.as_ref(), other.all.as_ref());
        let names: BTreeSet<Arc<str>> = self.each.keys().chain(other.each.keys()).cloned().collect();
        let each = names.into_iter().filter_map(|name| {
            let own = newer(self.holding(&name), other.holding(&name));
            (own != all).then_some((name, own))
        });
        self.each = each.collect();
        self.all = all;
        self.newest = self.newest.max(other.newest);
        self.known = self.known.max(other.known);
        self.lifted = self.lifted.max(other.lifted);
        self.device |= other.device;
    }

    /// The newest stop that holds.
    pub(crate) fn newest_holding(&self) -> Option<&Arc<Stop>> {
        let each = self.each.values().filter_map(Option::as_ref);
        each.chain(&self.all).max_by_key(|stop| stop.number)
    }

    /// `{number, stopped, by, user, since, reason, only, except}` of the channel.
    pub(crate) fn describe(&self) -> Map {
        let mut map = self.head(self.newest_holding());
        // Those that are stopped where not all are, and those that are not where all others are.
        let (key, stopped) = match self.all {
            None => ("only", true),
            Some(_) => ("except", false),
        };
        let names = self.each.iter().filter(|(_, own)| own.is_some() == stopped);
        let names: Vec<Value> = names.map(|(name, _)| Value::from(&**name)).collect();
        if !names.is_empty() {
            map.set(key, names);
        }
        map
    }

    /// The same as it concerns one device.
    pub(crate) fn describe_for(&self, device: &str) -> Map {
        self.head(self.holding(device))
    }

    fn head(&self, holding: Option<&Arc<Stop>>) -> Map {
        let map = Map::new()
            .with("number", self.newest)
            .with("stopped", holding.is_some());
        match holding {
            Some(stop) => stop.describe(map),
            None => map,
        }
    }
}

impl Stop {
    /// Adds `{by, user, since, reason}`.
    pub(crate) fn describe(&self, map: Map) -> Map {
        let map = map
            .with("by", &*self.by)
            .with("user", &*self.user)
            .with("since", self.since);
        match &self.reason {
            Some(reason) => map.with("reason", &**reason),
            None => map,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stop(number: u64) -> Stop {
        Stop {
            number: number.into(),
            by: "bob".into(),
            user: "bob".into(),
            since: Time::default(),
            reason: None,
        }
    }

    fn names(names: &[&str]) -> Vec<Arc<str>> {
        names.iter().map(|name| Arc::from(*name)).collect()
    }

    /// The numbers of what holds for the devices a, b and c; 0 = nothing.
    fn held(latch: &Latch) -> [u64; 3] {
        ["a", "b", "c"].map(|name| latch.holding(name).map_or(0, |stop| stop.number.into()))
    }

    #[test]
    fn an_unstop_lifts_what_is_not_above_it() {
        let mut latch = Latch::default();
        assert!(latch.stop(stop(1), None));
        assert!(!latch.stop(stop(2), None), "they were stopped already");
        assert_eq!(held(&latch), [2, 2, 2]);
        let newer = latch.lift(1.into(), None);
        assert_eq!(newer.len(), 1);
        assert_eq!((held(&latch), newer[0].1.number), ([2, 2, 2], 2.into()));
        assert_eq!(latch.lift(2.into(), None), []);
        assert_eq!((held(&latch), latch.newest), ([0, 0, 0], 2.into()));
        assert!(!latch.is_stopped());
    }

    #[test]
    fn each_device_has_its_own_newest_stop() {
        let mut latch = Latch::default();
        assert!(latch.stop(stop(1), None));
        assert!(!latch.stop(stop(2), Some(&names(&["a"]))));
        assert_eq!(held(&latch), [2, 1, 1]);
        // Of those that an older unstop names, the ones with a newer stop stay.
        let newer = latch.lift(1.into(), None);
        assert_eq!(held(&latch), [2, 0, 0]);
        assert_eq!(newer[0].0.as_deref(), Some("a"));
        assert!(latch.is_stopped());
        assert!(latch.stop(stop(3), None), "b and c were not");
        assert_eq!(latch.lift(3.into(), Some(&names(&["b"]))), []);
        assert_eq!(held(&latch), [3, 0, 3]);
        assert!(latch.stop(stop(4), Some(&names(&["b"]))));
        assert_eq!(latch.lift(3.into(), Some(&names(&["b", "c"]))).len(), 1);
        assert_eq!(held(&latch), [3, 4, 0]);
        assert_eq!(latch.lift(4.into(), None), []);
        assert_eq!(latch.each.len(), 0, "nothing is remembered of what nobody needs");
    }

    #[test]
    fn more_names_than_are_remembered_stop_all() {
        let mut latch = Latch::default();
        for number in 1..=NAMES as u64 {
            latch.stop(stop(number), Some(&names(&[&format!("robot-{number}")])));
        }
        assert_eq!(held(&latch), [0, 0, 0]);
        latch.stop(stop(1000), Some(&names(&["one-more"])));
        assert_eq!((held(&latch), latch.each.len()), ([1000, 1000, 1000], 0));
        for number in 0..2 * NAMES {
            latch.lift(1000.into(), Some(&names(&[&format!("robot-{number}")])));
        }
        assert_eq!(latch.each.len(), NAMES, "who is one too many stays stopped");
        assert_eq!(held(&latch), [1000, 1000, 1000]);
    }

    #[test]
    fn whatever_holds_in_one_of_two_holds() {
        let kept = |stops: &[(u64, Option<&[&str]>)], lifted: &[&str]| {
            let mut latch = Latch::default();
            for (number, only) in stops {
                latch.stop(stop(*number), only.map(names).as_deref());
            }
            if !lifted.is_empty() {
                latch.lift(99.into(), Some(&names(lifted)));
            }
            latch
        };
        let join = |mut one: Latch, other: &Latch| {
            one.join(other);
            (held(&one), u64::from(one.newest))
        };
        let (none, all) = (Latch::default(), kept(&[(5, None)], &["c"]));
        let by_name = kept(&[(7, Some(&["a"])), (8, Some(&["b"]))], &["b"]);
        assert_eq!(join(none.clone(), &all), ([5, 5, 0], 5));
        assert_eq!(
            join(all.clone(), &none),
            ([5, 5, 0], 5),
            "who was let go stays so"
        );
        assert_eq!(join(all.clone(), &by_name), ([7, 5, 0], 8));
        assert_eq!(join(by_name, &kept(&[(6, None)], &["a"])), ([7, 6, 6], 8));
        let device = Latch {
            device: true,
            ..Latch::default()
        };
        let mut joined = all;
        joined.join(&device);
        assert!(joined.device);
    }

    /// A hub that begins anew, and devices that come back to it by what the one before has told them.
    #[test]
    fn a_device_stands_by_a_stop_of_which_nothing_is_known() {
        let meets = |latch: &mut Latch, device: &str, number: u64, stopped| {
            let holds = latch.meet(device, number.into(), stopped);
            if holds {
                latch.stop(stop(number), Some(&names(&[device])));
            }
            holds
        };
        let mut latch = Latch::default();
        assert!(meets(&mut latch, "a", 5, true));
        assert!(!meets(&mut latch, "a", 5, true), "it stands already");
        assert!(meets(&mut latch, "b", 5, true), "what a says is not said of b");
        assert!(!meets(&mut latch, "c", 5, false));
        assert_eq!((held(&latch), latch.newest), ([5, 5, 0], 5.into()));
        assert_eq!(latch.lift(5.into(), None), []);
        assert!(
            !meets(&mut latch, "c", 5, true),
            "it was away while it was lifted"
        );

        // The hub says one to a alone: that b has stood by an older one is not known.
        let mut latch = Latch::default();
        latch.issue(stop(7), Some(&names(&["a"])));
        assert!(meets(&mut latch, "b", 5, true));
        // By one of its own it is known that it was lifted.
        assert_eq!(latch.lift(7.into(), Some(&names(&["a"]))), []);
        assert!(!meets(&mut latch, "a", 7, true));
        // One that is newer than all tells of a hub between.
        assert!(!meets(&mut latch, "c", 9, false));
        assert!(meets(&mut latch, "a", 8, true));
        assert!(meets(&mut latch, "a", 7, true) || latch.holding("a").is_some());
    }

    #[test]
    fn it_says_for_whom_it_holds() {
        let mut latch = Latch::default();
        latch.stop(stop(7), Some(&names(&["a", "b"])));
        let known = latch.describe();
        let only = Value::List(vec!["a".into(), "b".into()]);
        assert_eq!(
            (known.get("number"), known.get("stopped"), known.get("only")),
            (Some(&Value::Int(7)), Some(&Value::Bool(true)), Some(&only))
        );
        assert_eq!(latch.describe_for("c").get("stopped"), Some(&Value::Bool(false)));
        assert_eq!(latch.describe_for("a").get("by"), Some(&"bob".into()));
    }
}
