//! A channel as the broker holds it: its route with the outboxes of its members.

mod capacity;
mod kept;
mod send;
mod snapshot;

use std::collections::HashMap;
use std::sync::Arc;

use mom_hub::{PeerId, Receivers, Route, Usage};
use mom_net::{DropReason, Lane, Taken};
use mom_proto::codec::Form;
use mom_proto::{ContextNumber, Delivery, Family, Parcel, Path, Time, Verb, event};
use mom_system::Clock;
use mom_system::sync::Mutex;
use mom_system::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crate::traffic::batch::BatchPace;
use crate::traffic::encodings::{Encoder, Encodings};
use crate::traffic::history::History;
use crate::traffic::memory::Account;
use crate::traffic::outbox::{Charged, Dropped, Gate, Origin, Outbox, Packet};
use crate::traffic::statistics::Statistics;

pub(crate) use send::{
    LARGEST_STOP, Message, Outcome, Sender, Sent, Unsent, Why, run_ahead, said_before_the_loss,
};
pub(crate) use snapshot::{MemberSnapshot, Snapshot};

/// A channel. Its lock is its critical section: who holds it decides the one order for all receivers (M27). Messages
/// enter it by [`Channel::send`] and by nothing else.
#[derive(Debug)]
pub(crate) struct Channel {
    state: Mutex<State>,
    /// Whether it keeps messages, as far as that matters before its lock is taken.
    keeps: AtomicBool,
}

/// What the critical section guards.
#[derive(Debug)]
struct State {
    route: Arc<Route>,
    /// In the order of the route's members.
    outboxes: Vec<Option<Arc<Outbox>>>,
    gate: Gate,
    /// All members speak the binary form.
    binary: bool,
    /// At least one member asked for thinning.
    thins: bool,
    pace: BatchPace,
    encoder: Encoder,
    statistics: Statistics,
    history: Option<History>,
    /// What members, and connections that were some, have used of the rates that their manager set.
    used: HashMap<PeerId, Usage>,
}

/// Where a delivered parcel went.
#[derive(Debug, Default)]
pub(crate) struct Delivered {
    pub(crate) delivered: u64,
    pub(crate) dropped: Vec<Arc<str>>,
    /// Outboxes that have to be flushed.
    pub(crate) touched: Vec<Arc<Outbox>>,
    /// More of it is sure to come at once, so that they may be flushed a little later.
    pub(crate) lively: bool,
    /// The id of a stop that went out without its content.
    pub(crate) shortened: Option<Option<u64>>,
    /// Receivers that were too slow for what may not be dropped.
    pub(crate) too_slow: Vec<Arc<Outbox>>,
    /// Devices that did not get what needs no token, as its sender or others have too much waiting for them.
    pub(crate) spared: Vec<Arc<str>>,
}

impl Channel {
    pub(crate) fn new(
        route: Arc<Route>,
        encoder: Encoder,
        outbox: impl Fn(PeerId) -> Option<Arc<Outbox>>,
    ) -> Channel {
        let outboxes: Vec<_> = route.members.iter().map(|member| outbox(member.peer)).collect();
        note_devices(&route, &outboxes);
        let gate = Arc::new(AtomicU64::new(fence_open(&route)));
        let statistics = Statistics::new(&route);
        let history = route.keep.map(History::new);
        Channel {
            keeps: AtomicBool::new(history.is_some()),
            state: Mutex::new(State {
                thins: thins(&route),
                route,
                binary: all_binary(&outboxes),
                pace: BatchPace::default(),
                outboxes,
                gate,
                encoder,
                statistics,
                history,
                used: HashMap::new(),
            }),
        }
    }

    /// Swaps in a new route. From here on nothing of an old owner leaves any outbox. Who is new gets what is kept;
    /// the outboxes that have to be flushed for that.
    pub(crate) fn swap(
        &self,
        route: Arc<Route>,
        clock: &Clock,
        outbox: impl Fn(PeerId) -> Option<Arc<Outbox>>,
    ) -> Vec<Arc<Outbox>> {
        let mut state = self.state.lock();
        if halts(&route) != halts(&state.route) {
            // The safe state has gone out, and what waits of before does not follow it.
            state.gate.store(0, Ordering::Release);
            state.gate = Arc::default();
        }
        state.gate.store(fence_open(&route), Ordering::Release);
        state.settle_thinning(&route);
        // What they wait for may be gone, or not allowed any more.
        state.call_waiting();
        // Both lists are sorted, so most outboxes are found without a look-up, and those in front of the first change stay
        // where they are.
        let mut outboxes = std::mem::take(&mut state.outboxes);
        let same = route.same_front(&state.route).min(outboxes.len());
        let rest = outboxes.split_off(same);
        let old = state.route.members[same..].iter().map(|member| member.peer);
        let mut known = old.zip(rest).peekable();
        outboxes.extend(route.members[same..].iter().map(|member| {
            while known.next_if(|(peer, _)| *peer < member.peer).is_some() {}
            match known.next_if(|(peer, _)| *peer == member.peer) {
                Some((_, found)) => found,
                None => outbox(member.peer),
            }
        }));
        outboxes.shrink_to(2 * route.members.len());
        note_devices(&route, &outboxes);
        state.binary = all_binary(&outboxes);
        state.thins = thins(&route);
        state.outboxes = outboxes;
        // Who leaves and comes back has used what it has used.
        state
            .used
            .retain(|peer, _| route.member(*peer).is_some() || outbox(*peer).is_some());
        let state = &mut *state;
        state.statistics.follow(&state.route, &route);
        self.keeps.store(route.keep.is_some(), Ordering::Relaxed);
        let old = std::mem::replace(&mut state.route, route);
        state.follow_history(&old, clock)
    }

    /// Empties the route of a deleted channel: nobody sends there, and no guarded message that still
    /// waits leaves any outbox, because nobody will tell this channel when its token changes hands. Gives its path.
    pub(crate) fn end(&self) -> Path {
        let mut state = self.state.lock();
        let state = &mut *state;
        state.gate.store(0, Ordering::Release);
        let route = Route {
            members: Vec::new(),
            ..(*state.route).clone()
        };
        state.settle_thinning(&route);
        state.call_waiting();
        state.outboxes.clear();
        state.statistics.follow(&state.route, &route);
        let path = route.path.clone();
        state.route = Arc::new(route);
        path
    }

    /// The present route.
    pub(crate) fn route(&self) -> Arc<Route> {
        Arc::clone(&self.state.lock().route)
    }

    /// Forgets what is kept of an account.
    pub(crate) fn forget(&self, account: &Arc<Account>) {
        if let Some(history) = &mut self.state.lock().history {
            history.forget_of(account);
        }
    }

    /// Counts what a receiver did not get after all; gives the channel's path.
    pub(crate) fn note_dropped(&self, receiver: PeerId, dropped: Dropped, count: u64) -> Path {
        let mut state = self.state.lock();
        let at = state.route.position(receiver);
        state.statistics.dropped(at, dropped.reason, dropped.class, count);
        state.route.path.clone()
    }
}

impl State {
    /// Ends the thinning that another route does not know: a member that has left hears nothing more, and one that wants
    /// something else than before hears at once what was held back.
    fn settle_thinning(&self, route: &Route) {
        if !self.thins {
            return;
        }
        let members = self.route.members.iter().zip(&self.outboxes);
        for (member, outbox) in members.filter(|(member, _)| member.thinning.rate.is_some()) {
            let Some(outbox) = outbox else { continue };
            let now = route.member(member.peer).map(|member| member.thinning);
            if now != Some(member.thinning) {
                outbox.end_thinning(route.number, now.is_some());
            }
        }
    }

    /// The receivers among the members of another route, by their position among the members of this one; a peer that is not a
    /// member any more is left out.
    fn translate(&self, other: &Route, receivers: Receivers) -> Receivers {
        let here = |place: usize| self.route.position(other.members.get(place)?.peer);
        match receivers {
            Receivers::All => Receivers::All,
            Receivers::AllBut(own) => here(own).map_or(Receivers::All, Receivers::AllBut),
            Receivers::These(places) => Receivers::These(places.into_iter().filter_map(here).collect()),
        }
    }

    /// Puts a packet into the outboxes of the members at these positions.
    fn put(&mut self, packet: &Arc<Packet>, places: &Positions<'_>, now: u64) -> Delivered {
        let mut result = Delivered {
            lively: self.pace.is_lively(packet.count, now) && packet.can_wait(),
            ..Delivered::default()
        };
        let thins = self.thins && packet.may_be_thinned();
        let mut latest: Option<Arc<Packet>> = None;
        for place in places.iter() {
            let name = || Arc::clone(&self.route.members[place].facts.name);
            let Some(outbox) = &self.outboxes[place] else {
                result.dropped.push(name());
                let count = u64::from(packet.count);
                self.statistics
                    .dropped(Some(place), DropReason::Closed, packet.delivery, count);
                continue;
            };
            let member = &self.route.members[place];
            // Its own messages are what it waits for itself.
            let (taken, first) = if thins && member.thinning.thins() && member.peer != packet.origin.sender {
                let latest = latest.get_or_insert_with(|| Arc::new(packet.as_latest()));
                outbox.push_thinned(Arc::clone(latest), member.thinning.interval())
            } else {
                let (taken, first) = outbox.push(Arc::clone(packet));
                (Some(taken), first)
            };
            match taken {
                None | Some(Taken::Yes) => {
                    result.delivered += u64::from(packet.count);
                    self.statistics.delivered(place, u64::from(packet.count));
                }
                Some(Taken::Dropped) => result.dropped.push(name()),
                Some(Taken::Overflow) => {
                    result.dropped.push(name());
                    let count = u64::from(packet.count);
                    self.statistics
                        .dropped(Some(place), DropReason::Full, packet.delivery, count);
                    match packet.gate.is_none() && outbox.is_device() {
                        true => result.spared.push(name()),
                        false => result.too_slow.push(Arc::clone(outbox)),
                    }
                }
            }
            if first {
                result.touched.push(Arc::clone(outbox));
            }
        }
        result
    }
}

fn thins(route: &Route) -> bool {
    route.members.iter().any(|member| member.thinning.thins())
}

/// A device's outbox is filled by nobody but the owner of its token.
fn note_devices(route: &Route, outboxes: &[Option<Arc<Outbox>>]) {
    for (member, outbox) in route.members.iter().zip(outboxes) {
        if let Some(outbox) = outbox.as_ref().filter(|_| member.device) {
            outbox.note_device(route.pace);
        }
    }
}

fn all_binary(outboxes: &[Option<Arc<Outbox>>]) -> bool {
    outboxes
        .iter()
        .flatten()
        .all(|outbox| outbox.form().is_some_and(Form::is_binary))
}

/// By so much what the owner of a token says goes before all that needs none: more than any two priorities are apart.
const GUARDED: i32 = 1000;

/// The lane of a message; `guarded` = a token guards it.
pub(crate) fn lane_of(parcel: &Parcel, guarded: bool) -> Lane {
    match Verb::of(parcel.family, &parcel.name) {
        Ok(Verb::Stop) => Lane::Stop,
        Ok(Verb::Unstop) => Lane::Control,
        _ => {
            let priority = parcel.priority.unwrap_or_default();
            Lane::Data(priority + if guarded { GUARDED } else { 0 })
        }
    }
}

/// The receivers of a message by their position among the members.
struct Positions<'a> {
    receivers: &'a Receivers,
    count: usize,
}

impl Positions<'_> {
    fn iter(&self) -> impl Iterator<Item = usize> {
        let (listed, all, but) = match self.receivers {
            Receivers::All => (&[][..], self.count, None),
            Receivers::AllBut(own) => (&[][..], self.count, Some(*own)),
            Receivers::These(places) => (&places[..], 0, None),
        };
        (0..all)
            .filter(move |place| Some(*place) != but)
            .chain(listed.iter().copied())
    }
}

/// When a parcel is over: `expires` counts from its creation, of which `age` has passed at ingress.
pub(crate) fn expires_at(parcel: &Parcel, now: u64) -> Option<u64> {
    let life = parcel.expires?.saturating_mul(1000);
    let age = parcel
        .age
        .and_then(|age| u64::try_from(age).ok())
        .unwrap_or_default();
    Some(now.saturating_add(life.saturating_sub(age)))
}

/// How often the owner has lost its connection since it has the token.
fn halts(route: &Route) -> Option<u64> {
    let guard = route.guard.as_ref()?;
    guard.owner.as_ref().map(|owner| owner.halts)
}

fn fence_open(route: &Route) -> u64 {
    route
        .guard
        .as_ref()
        .filter(|guard| guard.owner.is_some())
        .map_or(0, |guard| guard.fence)
}

/// The number of no peer: what the hub itself says.
pub(crate) const HUB_PEER: PeerId = PeerId(0);

/// The origin of what the hub itself says.
pub(crate) fn hub_origin(parcel: &Parcel) -> Origin {
    let context = parcel.number.unwrap_or(ContextNumber(0));
    Origin {
        context,
        sender: HUB_PEER,
        name: Arc::clone(&parcel.name),
    }
}

/// What the hub says: by the control lane, but for a stop that holds, which goes as any stop does.
pub(crate) fn by_hub(parcel: &Parcel, encodings: Encodings, account: Option<&Arc<Account>>) -> Arc<Packet> {
    let mut packet = control(parcel.family, encodings, hub_origin(parcel), account);
    if let (Lane::Stop, Some(packet)) = (lane_of(parcel, false), Arc::get_mut(&mut packet)) {
        packet.lane = Lane::Stop;
    }
    packet
}

/// What a device can do without for a moment, and of which class it is then: what others do, which they can do often and at length.
/// What has to do with its own tokens and stops is none of it.
pub(crate) fn news_of(parcel: &Parcel) -> Option<Delivery> {
    match (parcel.family, parcel.name()) {
        (
            Family::Event,
            event::JOINED | event::LEFT | event::LOST | event::RESUMED | event::EXPELLED | event::DROPPED,
        )
        | (Family::Manager, CONSULT) => Some(Delivery::Fleeting),
        (
            Family::Event,
            event::CREATED
            | event::DELETED
            | event::INVITED
            | event::REQUESTED
            | event::OFFER
            | event::LAPSED
            | event::QUEUED
            | event::NOTICE,
        ) => Some(Delivery::Reliable),
        _ => None,
    }
}

/// A question to a peer that manages a context.
const CONSULT: &str = "consult";

/// What goes by the control lane.
pub(crate) fn control(
    family: Family,
    encodings: Encodings,
    origin: Origin,
    account: Option<&Arc<Account>>,
) -> Arc<Packet> {
    Arc::new(Packet {
        charged: Charged::to(account, &encodings),
        encodings,
        lane: Lane::Control,
        delivery: Delivery::Reliable,
        origin,
        expires_at: None,
        gate: None,
        count: 1,
        counts: family != Family::Time,
        outlives_loss: true,
    })
}

/// Stamps what the broker says by itself.
pub(crate) fn stamped(mut parcel: Parcel, wall: Time) -> Parcel {
    parcel.sender = Some(mom_proto::HUB.into());
    parcel.timestamp = Some(wall);
    parcel
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::traffic::encodings::Bounds;
    use mom_hub::Member;
    use mom_managers::PeerFacts;

    /// Of a channel with these peers and nothing else.
    pub(crate) fn route(peers: &[u64]) -> Route {
        let member = |peer: &u64| {
            let facts = PeerFacts {
                name: peer.to_string().into(),
                user: "user".into(),
                level: 0,
                groups: Arc::from([]),
            };
            Arc::new(Member::new(PeerId(*peer), Arc::new(facts)))
        };
        Route {
            number: ContextNumber(1),
            path: mom_proto::Path::root(),
            members: peers.iter().map(member).collect(),
            guard: None,
            delivery: Delivery::default(),
            overflow: mom_proto::Overflow::default(),
            pace: None,
            keep: None,
            awaited: false,
            lifted: None,
        }
    }

    /// One input admits a message and then takes members out; the route of the end is swapped in before all else.
    #[test]
    fn receivers_are_who_they_were() {
        let channel = Channel::new(
            Arc::new(route(&[1, 3, 4])),
            Encoder::new(
                Bounds {
                    depth: 32,
                    parcel: mom_proto::Limit::At(1 << 20),
                },
                Arc::default(),
            ),
            |_| None,
        );
        let then = route(&[1, 2, 3, 4]);
        let state = channel.state.lock();
        let now = |receivers| state.translate(&then, receivers);
        assert_eq!(now(Receivers::These(vec![3, 1, 0])), Receivers::These(vec![2, 0]));
        assert_eq!(now(Receivers::AllBut(3)), Receivers::AllBut(2));
        assert_eq!(now(Receivers::AllBut(1)), Receivers::All, "it is gone anyhow");
        assert_eq!(now(Receivers::All), Receivers::All);
    }
}
