//! Looks at a hub from outside and asserts what it promises.

use std::collections::BTreeMap;

use mom_hub::{Effect, Hub, Input, PeerId, Record};
use mom_proto::{Family, Parcel, Path};

use crate::answers::Answers;
use crate::disk::Disk;
use crate::handover::HandOver;
use crate::lab::{self, EPOCH, Rules, USERS, user};
use crate::links::Links;
use crate::look::Looks;
use crate::owners::{Kept, Owners};
use crate::queues::Queues;
use crate::robots::Robots;
use crate::seen::Seen;
use crate::tree::{Admitted, Tree};

/// How a hub begins.
#[derive(Clone, Debug)]
pub(crate) struct Start {
    pub(crate) variant: usize,
    pub(crate) durable: bool,
    pub(crate) epoch: u64,
    pub(crate) records: Vec<Record>,
}

impl Start {
    pub(crate) fn new(durable: bool) -> Start {
        Start {
            variant: 0,
            durable,
            epoch: EPOCH,
            records: Vec::new(),
        }
    }

    pub(crate) fn hub(&self) -> Hub {
        lab::hub(self.variant, self.durable, self.epoch, self.records.clone())
    }
}

/// A hub and what was seen of it.
pub(crate) struct Observer {
    pub(crate) start: Start,
    pub(crate) hub: Hub,
    pub(crate) now: u64,
    /// The configuration that holds.
    pub(crate) variant: usize,
    /// When the store answers what comes next, and how.
    pub(crate) store: (usize, bool),
    pub(crate) tree: Tree,
    /// The tokens, when they were looked at last.
    pub(crate) looks: Looks,
    pub(crate) answers: Answers,
    pub(crate) owners: Owners,
    pub(crate) queues: Queues,
    pub(crate) handover: HandOver,
    pub(crate) robots: Robots,
    pub(crate) links: Links,
    pub(crate) disk: Disk,
    pub(crate) inputs: Vec<(u64, Input)>,
    pub(crate) effects: Vec<Vec<Effect>>,
    pub(crate) seen: Seen,
}

impl Observer {
    /// `gated` = whether its broker looks at the gates of channels.
    pub(crate) fn new(start: Start, gated: bool) -> Observer {
        let mut hub = start.hub();
        let mut robots = Robots::default();
        robots.gated = gated;
        robots.begin(hub.routes().into_iter());
        Observer {
            tree: Tree::new(&mut hub),
            looks: Looks::default(),
            hub,
            now: 0,
            variant: start.variant,
            store: (0, true),
            answers: Answers::default(),
            owners: Owners::default(),
            queues: Queues::default(),
            handover: HandOver::default(),
            robots,
            links: Links::default(),
            disk: Disk::default(),
            inputs: Vec::new(),
            effects: Vec::new(),
            seen: Seen::default(),
            start,
        }
    }

    /// After its hub was killed: a new one, begun with what was durable; what peers and robots know they know.
    pub(crate) fn restart(mut self, luck: u64) -> (Observer, Past) {
        let (records, settled) = self.disk.survive(luck);
        let start = Start {
            variant: self.variant,
            durable: true,
            epoch: crate::disk::next_epoch(self.start.epoch, &records),
            records,
        };
        let kept = self.owners.to_keep();
        let mut next = Observer::new(start, self.robots.gated);
        self.robots.disconnect();
        next.robots = self.robots;
        next.robots.begin(next.hub.routes().into_iter());
        next.owners.fences = self.owners.fences;
        next.seen = self.seen;
        next.check_restart(&kept, &settled);
        next.owners.kept = kept;
        let past = Past {
            start: self.start,
            inputs: self.inputs,
            effects: self.effects,
        };
        (next, past)
    }

    /// A token is kept for who owned it; one that nobody owned, and nobody was about to, is free at once.
    fn check_restart(&mut self, kept: &BTreeMap<Path, Kept>, settled: &[Path]) {
        let looks = Looks::at(&mut self.hub, 0);
        for (path, look) in &looks.seen {
            let owned = kept.contains_key(path);
            let written = self.start.records.iter().any(|record| record.path == *path);
            assert!(
                !owned || look.reserved,
                "{path} is kept for its owner: {:?}",
                kept.get(path)
            );
            let free = !owned && (settled.contains(path) || !written);
            assert!(!free || !look.reserved, "{path} was free, and is: {look:?}");
            if look.reserved {
                self.seen.note("kept after a restart");
            }
        }
    }

    /// Gives the hub an input and checks all that follows; `variant` = the configuration that holds after it.
    pub(crate) fn take(&mut self, now: u64, input: &Input, variant: usize) -> &[Effect] {
        let mut effects = Vec::new();
        self.now = now;
        let early = self.tree.admit(&self.hub, now, input);
        self.hub.handle(now, Input::Tick, &mut effects);
        self.hub.check();
        let deadline = self.hub.deadline();
        assert!(
            deadline.is_none_or(|deadline| deadline > now),
            "deadlines have acted"
        );
        self.follow(&effects, None);
        self.check_like_gone(&effects);
        self.check_ends();
        self.check_grace();
        let by_route = self.tree.admit(&self.hub, now, input);
        if !effects.iter().any(taken_by_somebody) {
            check_early(early, by_route.as_ref());
        }
        self.answers.ask(input);
        self.configure(variant);
        let start = effects.len();
        self.hub.handle(now, input.clone(), &mut effects);
        self.hub.check();
        self.follow(&effects[start..], Some(input));
        self.check_link(input, &effects[start..]);
        self.check_grace();
        self.check_one_truth(by_route.as_ref(), input, &effects[start..]);
        self.check_stop(input, &effects[start..]);
        self.inputs.push((now, input.clone()));
        self.effects.push(effects);
        self.effects.last().unwrap()
    }

    /// A new configuration: a new deadman time holds for the owner of now too.
    fn configure(&mut self, variant: usize) {
        let old = std::mem::replace(&mut self.variant, variant);
        if old == variant {
            return;
        }
        for (path, owned) in &mut self.owners.now {
            let both = lab::rules(path, old).zip(lab::rules(path, variant));
            if let Some((old, new)) = both
                && old.deadman != new.deadman
            {
                owned.alive_until = new.deadman.map(|deadman| self.now + deadman);
            }
        }
    }

    /// While everybody comes in nobody looks who is where; once all are in, everything is looked at.
    pub(crate) fn look_away(&mut self, away: bool) {
        self.tree.blind = away;
        if !away {
            self.tree.look(&mut self.hub, self.now);
            self.look_at_tokens(true);
        }
    }

    /// Moves what lies in outboxes and sockets.
    pub(crate) fn link(&mut self, (write, read): (bool, bool)) {
        if write {
            self.robots.write(&mut self.seen);
        }
        if read {
            self.robots.read(&mut self.seen);
        }
    }

    /// What holds for a token of the configuration.
    pub(crate) fn rules(&self, path: &Path) -> Option<Rules> {
        lab::rules(path, self.variant)
    }

    /// No ownership outlasts its end: an eager lease, a deadman time, a lease or a turn where others wait.
    fn check_ends(&self) {
        for (path, owned) in &self.owners.now {
            let Some(rules) = self.rules(path) else { continue };
            let waited = self.queues.waits(path);
            let lease = owned.lease_end.filter(|_| rules.eager || waited);
            let turn = self.queues.turn_end(path, owned, &rules);
            let ends = [lease, owned.alive_until, turn].into_iter().flatten();
            for end in ends {
                assert!(
                    self.now < end,
                    "{path} is {}'s beyond {end}: {owned:?}",
                    owned.name
                );
            }
        }
    }

    /// A verdict that stands says what asking again would say.
    fn check_one_truth(&mut self, by_route: Option<&Admitted>, input: &Input, effects: &[Effect]) {
        let what = match by_route {
            None if matches!(input, Input::Request { parcel, .. } if parcel.family == Family::Message) => {
                self.seen.note("passed by the hub");
                return;
            }
            None => return,
            Some(Ok(_)) => "passed by its route",
            Some(Err(_)) => "refused by its route",
        };
        self.seen.note(what);
        let by_hub = effects.iter().find_map(|effect| match effect {
            Effect::Send {
                parcel,
                receivers,
                rate,
                ..
            } => Some(Ok((receivers.clone(), *rate, (**parcel).clone()))),
            Effect::Reply { parcel, .. } => Some(Err(mom_proto::WireError::from_parcel(parcel))),
            _ => None,
        });
        assert_eq!(by_hub.as_ref(), by_route, "the route and the hub say the same");
        if let Some(Ok((_, Some(rate), _))) = by_hub {
            assert_eq!(rate, crate::kinds::RATE);
            self.seen.note("passed with a rate");
        }
    }

    /// A stop passes for who has the right to it, whoever owns the device and whatever waits.
    fn check_stop(&mut self, input: &Input, effects: &[Effect]) {
        let Input::Request { peer, parcel, .. } = input else {
            return;
        };
        if !parcel.is(Family::Message, "stop") || !self.may_stop(*peer, parcel) {
            return;
        }
        let sent = |effect: &Effect| matches!(effect, Effect::Send { from, parcel, .. } if from == peer && parcel.name() == "stop");
        assert!(effects.iter().any(sent), "a stop passes: {parcel:?}, {effects:?}");
        self.seen.note("stopped");
    }

    fn may_stop(&self, peer: PeerId, parcel: &Parcel) -> bool {
        let path = parcel.context.as_ref().unwrap();
        let route = self.tree.routes.values().find(|route| route.path == *path);
        if parcel.address.is_some() || route.is_none_or(|route| route.member(peer).is_none()) {
            return false;
        }
        let Some(person) = self.tree.people.get(&peer) else {
            return false;
        };
        let number = USERS.iter().position(|(name, ..)| *name == person.user);
        let user = number.and_then(|number| user(number, self.variant)).unwrap();
        match path.as_str() {
            "/lab/arm" => user.groups == ["operator"] || (user.level >= 1 && user.name != "dave"),
            "/yard/tap" => false,
            path => path.starts_with("/yard/") && self.variant != 4,
        }
    }
}

/// What the fast path lets pass before the hub's clock has gone on is still right after.
fn check_early(early: Option<Admitted>, late: Option<&Admitted>) {
    let Some(Ok((receivers, rate, parcel))) = early else {
        return;
    };
    if parcel.fence.is_some() {
        let late = late.and_then(|late| late.as_ref().ok());
        assert_eq!(
            late,
            Some(&(receivers, rate, parcel)),
            "an ownership that is over lets nothing pass"
        );
    }
}

/// Whether a peer takes a token, by a request that waited for an answer until now, or has not come back in time and is
/// no member any more: that is nothing which the owner, or a route, could have known of before.
fn taken_by_somebody(effect: &Effect) -> bool {
    if matches!(effect, Effect::Close { .. }) {
        return true;
    }
    let Effect::Deliver { parcel, .. } = effect else {
        return false;
    };
    parcel.is(Family::Event, "released") && parcel.value().get("by").is_some()
}

/// A life of a hub that is over.
pub(crate) struct Past {
    pub(crate) start: Start,
    pub(crate) inputs: Vec<(u64, Input)>,
    pub(crate) effects: Vec<Vec<Effect>>,
}
