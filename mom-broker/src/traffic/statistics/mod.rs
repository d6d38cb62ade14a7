//! What a channel counts: sent, delivered, dropped, and how old what was sent was (design §4).

mod histogram;

use std::collections::BTreeMap;

use mom_hub::Route;
use mom_proto::{Delivery, Map, Parcel, Value};

pub(crate) use histogram::Histogram;

use mom_net::DropReason;

/// The counts of a channel, of all who were ever in it and of who is in it now.
#[derive(Debug, Default)]
pub(crate) struct Statistics {
    all: Counts,
    /// In the order of the route's members. Who leaves and comes back begins anew.
    members: Vec<Counts>,
}

/// The counts of one peer in a channel, or of all.
#[derive(Clone, Debug, Default)]
pub(crate) struct Counts {
    pub(crate) sent: u64,
    pub(crate) bytes: u64,
    /// Taken by a receiver's outbox.
    pub(crate) delivered: u64,
    /// Dropped for a receiver, at its outbox or while it waited there, by reason and class.
    pub(crate) dropped: BTreeMap<(DropReason, Delivery), u64>,
    /// The ages at ingress of what was sent, where they are known; made with the first.
    pub(crate) ages: Option<Box<Histogram>>,
}

impl Statistics {
    pub(crate) fn new(route: &Route) -> Statistics {
        Statistics {
            all: Counts::default(),
            members: vec![Counts::default(); route.members.len()],
        }
    }

    /// Follows a change of the route: both lists are sorted by the numbers of the peers. Those in front of the first change
    /// stay where they are: a channel of thousands would be copied for each that comes, and the copies kept by the allocator.
    pub(crate) fn follow(&mut self, old: &Route, new: &Route) {
        let same = new.same_front(old).min(self.members.len());
        let rest = self.members.split_off(same);
        let old = old.members[same..].iter().map(|member| member.peer);
        let mut known = old.zip(rest).peekable();
        self.members.extend(new.members[same..].iter().map(|member| {
            while known.next_if(|(peer, _)| *peer < member.peer).is_some() {}
            let found = known.next_if(|(peer, _)| *peer == member.peer);
            found.map(|(_, counts)| counts).unwrap_or_default()
        }));
        self.members.shrink_to(2 * new.members.len());
    }

    /// Counts an admitted message of the member at this place; none = it has left meanwhile.
    pub(crate) fn sent(&mut self, place: Option<usize>, size: usize, age: Option<i64>) {
        self.all.send(size, age);
        if let Some(counts) = place.and_then(|place| self.members.get_mut(place)) {
            counts.send(size, age);
        }
    }

    /// Counts that the outbox of the member at this place took so many messages.
    pub(crate) fn delivered(&mut self, place: usize, count: u64) {
        self.all.delivered += count;
        if let Some(counts) = self.members.get_mut(place) {
            counts.delivered += count;
        }
    }

    /// Counts what was dropped for a receiver.
    pub(crate) fn dropped(&mut self, place: Option<usize>, reason: DropReason, class: Delivery, count: u64) {
        *self.all.dropped.entry((reason, class)).or_default() += count;
        if let Some(counts) = place.and_then(|place| self.members.get_mut(place)) {
            *counts.dropped.entry((reason, class)).or_default() += count;
        }
    }

    /// Of all.
    pub(crate) fn all(&self) -> &Counts {
        &self.all
    }

    /// Of the members, in the order of the route.
    pub(crate) fn members(&self) -> &[Counts] {
        &self.members
    }
}

impl Counts {
    fn send(&mut self, size: usize, age: Option<i64>) {
        self.sent += 1;
        self.bytes += size as u64;
        if let Some(age) = age {
            let ages = self.ages.get_or_insert_with(|| Box::new(Histogram::new()));
            ages.note(age);
        }
    }

    /// Counts what others have counted.
    pub(crate) fn add(&mut self, other: &Counts) {
        self.sent += other.sent;
        self.bytes += other.bytes;
        self.delivered += other.delivered;
        for (key, count) in &other.dropped {
            *self.dropped.entry(*key).or_default() += count;
        }
        if let Some(ages) = &other.ages {
            let all = self.ages.get_or_insert_with(|| Box::new(Histogram::new()));
            all.add(ages);
        }
    }

    /// In the words of the wire, `queued` bytes of it.
    pub(crate) fn to_map(&self, map: Map, queued: usize) -> Map {
        let (mut by_reason, mut by_class) = (BTreeMap::new(), BTreeMap::new());
        for ((reason, class), count) in &self.dropped {
            *by_reason.entry(reason.word()).or_default() += count;
            *by_class.entry(class.word()).or_default() += count;
        }
        let map = map
            .with("sent", int(self.sent))
            .with("bytes", int(self.bytes))
            .with("delivered", int(self.delivered))
            .with("dropped", numbers(&by_reason))
            .with("dropped-classes", numbers(&by_class))
            .with("queued", int(queued as u64));
        match &self.ages {
            Some(ages) => map.with("age", age_map(ages)),
            None => map,
        }
    }
}

fn numbers(counts: &BTreeMap<&'static str, u64>) -> Map {
    let counts = counts.iter();
    counts.fold(Map::new(), |map, (word, count)| map.with(word, int(*count)))
}

fn age_map(ages: &Histogram) -> Map {
    let percentile = |percent| int(ages.percentile(percent).unwrap_or_default());
    Map::new()
        .with("count", int(ages.count()))
        .with("p50", percentile(50))
        .with("p99", percentile(99))
        .with("most", int(ages.most()))
}

/// The size of a message, and its age where it is known.
pub(crate) fn measures(parcel: &Parcel) -> (usize, Option<i64>) {
    (parcel.size(), parcel.age.filter(|_| parcel.age_error.is_some()))
}

fn int(number: u64) -> Value {
    Value::Int(i64::try_from(number).unwrap_or(i64::MAX))
}

#[cfg(test)]
mod tests {
    use mom_hub::PeerId;

    use super::*;
    use crate::traffic::channel::tests::route;

    /// Who comes last or leaves takes nothing from those in front, nor from those behind.
    #[test]
    fn statistics_stay_with_their_peers_as_one_comes_or_leaves() {
        let delivered = |statistics: &Statistics| -> Vec<u64> {
            let members = statistics.members().iter();
            members.map(|counts| counts.delivered).collect()
        };
        let mut old = route(&[2, 4, 6]);
        let mut statistics = Statistics::new(&old);
        (0..3).for_each(|place| statistics.delivered(place, 1 + place as u64));
        let changes: [(&[u64], &[u64]); 6] = [
            (&[2, 4, 6, 9], &[1, 2, 3, 0]),
            (&[2, 6, 9], &[1, 3, 0]),
            (&[2, 4, 6, 9], &[1, 0, 3, 0]),
            (&[2, 4, 6], &[1, 0, 3]),
            (&[4, 6], &[0, 3]),
            (&[], &[]),
        ];
        for (members, expected) in changes {
            let new = route(members);
            statistics.follow(&old, &new);
            assert_eq!(delivered(&statistics), expected, "{members:?}");
            old = new;
        }
    }

    #[test]
    fn statistics_stay_with_their_peers() {
        let (first, second) = (route(&[2, 4, 6]), route(&[1, 4, 5, 6]));
        let mut statistics = Statistics::new(&first);
        statistics.sent(first.position(PeerId(4)), 10, Some(70));
        statistics.sent(first.position(PeerId(4)), 10, None);
        statistics.delivered(0, 1);
        statistics.delivered(2, 1);
        statistics.dropped(
            first.position(PeerId(6)),
            DropReason::Expired,
            Delivery::Latest,
            3,
        );
        statistics.follow(&first, &second);
        statistics.sent(None, 5, None);
        statistics.dropped(
            second.position(PeerId(2)),
            DropReason::Expired,
            Delivery::Latest,
            1,
        );

        let sent = |counts: &Counts| {
            (
                counts.sent,
                counts.delivered,
                counts
                    .dropped
                    .get(&(DropReason::Expired, Delivery::Latest))
                    .copied(),
            )
        };
        let members: Vec<_> = statistics.members().iter().map(sent).collect();
        assert_eq!(
            members,
            [(0, 0, None), (2, 0, None), (0, 0, None), (0, 1, Some(3))]
        );
        assert_eq!(sent(statistics.all()), (3, 2, Some(4)));

        statistics.dropped(None, DropReason::Full, Delivery::Latest, 2);
        statistics.dropped(None, DropReason::Full, Delivery::Fleeting, 5);
        let all = statistics.all().to_map(Map::new(), 0);
        let reasons = Map::new().with("expired", 4).with("queue-full", 7);
        let classes = Map::new().with("fleeting", 5).with("latest", 6);
        assert_eq!(
            (all.get("dropped"), all.get("dropped-classes")),
            (Some(&Value::Map(reasons)), Some(&Value::Map(classes)))
        );

        let map = statistics.members()[1].to_map(Map::new(), 9);
        let age = Map::new()
            .with("count", 1)
            .with("p50", 70)
            .with("p99", 70)
            .with("most", 70);
        let expected = Map::new()
            .with("sent", 2)
            .with("bytes", 20)
            .with("delivered", 0)
            .with("dropped", Map::new())
            .with("dropped-classes", Map::new())
            .with("queued", 9)
            .with("age", age);
        assert_eq!(map, expected);
    }
}
