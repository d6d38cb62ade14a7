//! Whether a message may pass, and to whom: one truth for the hub and for the broker's fast path.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::sync::Arc;
use std::time::Duration;

use mom_managers::{Answer, Denial, PeerFacts, Rate};
use mom_proto::nearest::nearest;
use mom_proto::{Code, Family, Fence, HISTORY, Micros, PRIORITY, Parcel, Time, WireError, event};

use super::age::{Aged, age_of, aged, check_age, check_life, is_ahead, is_before, is_within, unknown_age};
use super::route::{Guard, GuardOwner, Route};
use crate::{Member, PeerClock, PeerId};

/// When a message came, and by which clock its sender stamps.
#[derive(Clone, Copy, Debug)]
pub struct Ingress {
    /// Monotonic time.
    pub now: Micros,
    /// The hub's wall time.
    pub wall: Time,
    /// The sender's clock; none = not known, and neither is the message's age.
    pub clock: Option<PeerClock>,
    /// How long it has waited since it came, until a receiver had room: it is at least that old.
    pub waited: Micros,
}

/// The outcome of an admission.
#[derive(Clone, Debug, PartialEq)]
pub enum Admission {
    /// It may pass, stamped, to these, if its sender has not used up this rate.
    Pass(Receivers, Option<Rate>),
    /// The hub has to decide: no verdict stands for a message of this name and age, a deadline has come on which it has
    /// not acted yet, or it is from or for a peer that the route does not know.
    Consult,
}

/// Members of a route by their place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Receivers {
    /// All.
    All,
    /// All but this one.
    AllBut(usize),
    /// These, as addressed.
    These(Vec<usize>),
}

impl Receivers {
    /// Their places in a route of so many members.
    pub(crate) fn places(&self, members: usize) -> Vec<usize> {
        match self {
            Receivers::All => (0..members).collect(),
            Receivers::AllBut(own) => (0..members).filter(|place| place != own).collect(),
            Receivers::These(places) => places.clone(),
        }
    }

    /// Who they are.
    pub(crate) fn peers(&self, route: &Route) -> BTreeSet<PeerId> {
        let places = self.places(route.members.len()).into_iter();
        places.map(|place| route.members[place].peer).collect()
    }
}

/// Admits a message of a peer to a channel and stamps it: sender, context, hub time, age, fence.
///
/// # Errors
/// `not-member`, the standing denial, `not-owner`, `older-fence`, `bad-fence`, `bad-slot` for a timestamp of the future,
/// `expired`, `unknown-peer`. The parcel is of no use then.
pub fn admit(
    route: &Route,
    peer: PeerId,
    parcel: &mut Parcel,
    ingress: &Ingress,
) -> Result<Admission, WireError> {
    let now = ingress.now;
    // The hub knows whether a peer that is not a member may know of the channel.
    let Some(member) = route.member(peer) else {
        return Ok(Admission::Consult);
    };
    // What a device says of itself may be awaited at the hub.
    if route.awaited && member.device {
        return Ok(Admission::Consult);
    }
    let owner = route.guard.as_ref().and_then(|guard| guard.owner.as_ref());
    let overdue = owner
        .and_then(|owner| owner.lost_at)
        .is_some_and(|lost| now >= lost);
    // The commands of a delegate with a number of them are counted by the hub.
    let counted = owner.is_some_and(|owner| owner.peer == peer && owner.commands.is_some())
        && route
            .guard
            .as_ref()
            .is_some_and(|guard| guard.covers(&parcel.name));
    let young = |most: Micros| is_within(age_of(parcel, ingress.wall, ingress.clock.as_ref()), most);
    match member
        .standing(&parcel.name, now)
        .filter(|standing| !overdue && !counted && !standing.by_hub)
        .filter(|standing| standing.max_age.is_none_or(young))
    {
        None => Ok(Admission::Consult),
        Some(standing) => match admit_with(route, peer, &standing.answer, parcel, ingress) {
            Ok(receivers) => Ok(Admission::Pass(receivers, standing.rate)),
            // Others are told of who joins a moment before the route has it: what one of them says to it then is for the hub, which
            // knows all. Many names would keep the hub busy.
            Err(error) if error.code == Code::UNKNOWN_PEER && addressees(parcel) <= FEW_NAMES => {
                Ok(Admission::Consult)
            }
            Err(error) => Err(error),
        },
    }
}

/// Admits further messages of the same sender and the same slots as one that was admitted: only their stamps are
/// looked at.
#[derive(Clone, Copy, Debug)]
pub struct Alike {
    wall: Time,
    clock: Option<PeerClock>,
    max_age: Option<Micros>,
    lifted: Option<Time>,
}

impl Alike {
    /// For messages of this name that come with the one that was admitted at `ingress`.
    pub fn new(route: &Route, peer: PeerId, name: &str, ingress: &Ingress) -> Alike {
        let standing = route
            .member(peer)
            .and_then(|member| member.standing(name, ingress.now));
        Alike {
            wall: ingress.wall,
            clock: ingress.clock,
            max_age: standing.and_then(|standing| standing.max_age),
            lifted: route.lifted_before(name),
        }
    }

    /// The age in µs of a message of this timestamp, 0 where it is not known; none if the message has to be
    /// admitted by itself, for it may be refused.
    pub fn age(&self, timestamp: Option<Time>) -> Option<i64> {
        let (Some(clock), Some(timestamp)) = (self.clock, timestamp) else {
            return self.max_age.is_none().then_some(0);
        };
        let age = aged(timestamp, self.wall, &clock);
        let young = self.max_age.is_none_or(|most| is_within(Some(age), most));
        let late = self
            .lifted
            .is_some_and(|lifted| is_before(age, lifted, self.wall));
        (young && !late && !is_ahead(age, &clock)).then_some(age.0)
    }
}

/// Admits a message for which the channel's manager gave this answer.
///
/// # Errors
/// As [`admit`].
pub fn admit_with(
    route: &Route,
    peer: PeerId,
    answer: &Answer,
    parcel: &mut Parcel,
    ingress: &Ingress,
) -> Result<Receivers, WireError> {
    let &Ingress { now, wall, .. } = ingress;
    let member = sender(route, peer)?;
    let grant = match answer {
        Answer::Allow(grant) => grant,
        Answer::Deny(denial) => return Err(refusal(denial, &member.facts, now)),
        // A message waits in no queue.
        Answer::Queue(wait) => return Err(refusal(&wait.denial, &member.facts, now)),
        Answer::Defer(defer) => {
            let text = "this channel's manager was not asked yet";
            return Err(WireError::new(Code::TRY_LATER, text).rule(&defer.label));
        }
    };
    debug_assert_eq!(
        parcel.family,
        Family::Message,
        "only messages are admitted to channels"
    );
    let fence = check_guard(route, member, parcel, now)?;
    let age = check_age(parcel, wall, ingress.clock.as_ref())?;
    if age.is_none() && parcel.expires.is_some() {
        if fence.is_some() {
            return Err(unknown_age(parcel));
        }
        if ingress.waited > 0 {
            check_life(parcel, ingress.waited)?;
        }
    }
    if route.lifted.is_some() {
        check_lifted(route, parcel, age, wall)?;
    }
    let receivers = receivers(route, peer, parcel)?;
    // The hub's own mark.
    parcel.extra.remove(HISTORY);
    parcel.sender = Some(member.facts.name.clone());
    parcel.context = Some(route.path.clone());
    parcel.number = Some(route.number);
    parcel.fence = fence;
    parcel.received = Some(wall);
    // Without an estimate of the sender's clock the age is counted from ingress; no error bound says so.
    parcel.age = Some(age.map_or(i64::try_from(ingress.waited).unwrap_or(i64::MAX), |(age, _)| age));
    parcel.age_error = age.map(|(_, error)| error);
    // The owner of a token orders what it guards among its own.
    let highest = grant
        .priority
        .filter(|_| fence.is_none())
        .unwrap_or(*PRIORITY.end());
    parcel.priority = parcel
        .priority
        .map(|priority| priority.clamp(*PRIORITY.start(), highest));
    Ok(receivers)
}

/// A denial in the words of the wire.
pub(crate) fn refusal(denial: &Denial, asked: &PeerFacts, now: Micros) -> WireError {
    let error = WireError::new(denial.code.clone(), denial.text.as_str())
        .rule(&denial.rule)
        .level(asked.level);
    match denial.earliest.filter(|earliest| *earliest > now) {
        Some(earliest) => error.retry_after(Duration::from_micros(earliest - now)),
        None => error,
    }
}

fn sender(route: &Route, peer: PeerId) -> Result<&Member, WireError> {
    route.member(peer).map(|member| &**member).ok_or_else(|| {
        WireError::new(
            Code::NOT_MEMBER,
            format!("join {} before sending to it", route.path),
        )
        .slot("context")
    })
}

/// Checks that what moves a device was not said before a stop was lifted: who said it did not see what has become of
/// the device since. It may come so late where an uplink stood still and was not lost.
#[cold]
fn check_lifted(route: &Route, parcel: &Parcel, age: Option<Aged>, wall: Time) -> Result<(), WireError> {
    let late = route
        .lifted_before(&parcel.name)
        .zip(age)
        .is_some_and(|(lifted, age)| is_before(age, lifted, wall));
    if !late {
        return Ok(());
    }
    let text = "a stop was lifted after this was sent; check the device's state, then send it again";
    Err(WireError::new(Code::TOO_LATE, text))
}

/// Checks the guard; gives the fence to stamp.
fn check_guard(
    route: &Route,
    member: &Member,
    parcel: &Parcel,
    now: Micros,
) -> Result<Option<u64>, WireError> {
    let name = &*parcel.name;
    if name == event::HALT {
        let text = "only the hub may send halt; send stop to stop a device";
        return Err(WireError::new(Code::DENIED, text).slot("name"));
    }
    let Some(guard) = route.guard.as_ref().filter(|guard| guard.covers(name)) else {
        return Ok(None);
    };
    let given = parcel.fence;
    if given.is_some_and(|fence| fence > guard.fence) {
        let text = format!(
            "the fence of {} is {}, a higher one was never given out",
            guard.token, guard.fence
        );
        return Err(WireError::new(Code::BAD_FENCE, text)
            .slot("fence")
            .detail("fence", Fence::from(guard.fence)));
    }
    if given.is_some_and(|fence| fence < guard.fence) {
        let text = format!(
            "{} has changed hands since that fence; it is {} now",
            guard.token, guard.fence
        );
        let error = WireError::new(Code::OLDER_FENCE, text).slot("fence");
        let own = guard
            .owner
            .as_ref()
            .is_some_and(|owner| owner.peer == member.peer);
        let error = if own { error } else { with_owner(error, guard, now) };
        return Err(error.detail("fence", Fence::from(guard.fence)));
    }
    match &guard.owner {
        Some(owner) if owner.peer == member.peer && owner.commands != Some(0) => Ok(Some(guard.fence)),
        owner => Err(not_owner(route, guard, owner.as_ref(), member, name, now)),
    }
}

fn not_owner(
    route: &Route,
    guard: &Guard,
    owner: Option<&GuardOwner>,
    member: &Member,
    name: &str,
    now: Micros,
) -> WireError {
    let (path, token) = (&route.path, &guard.token);
    let text = match owner {
        None => format!("{name} on {path} needs {token}, which nobody holds: grab it first"),
        Some(owner) if owner.peer == member.peer => {
            format!("the commands granted with {token} are used up; it is returned")
        }
        Some(owner) => format!(
            "{name} on {path} needs {token}, which {} (level {}) holds",
            owner.name, owner.level
        ),
    };
    let error = WireError::new(Code::NOT_OWNER, text)
        .rule(&format!("guard of {path}"))
        .level(member.facts.level);
    with_owner(error, guard, now)
}

fn with_owner(error: WireError, guard: &Guard, now: Micros) -> WireError {
    let Some(owner) = &guard.owner else {
        return error;
    };
    let error = error.owner(&owner.name, owner.level);
    match owner.lease_end {
        Some(end) => error.retry_after(Duration::from_micros(end.saturating_sub(now))),
        None => error,
    }
}

/// The members that a message is for, as its sender has addressed it.
///
/// # Errors
/// `unknown-peer`.
#[inline]
pub fn receivers(route: &Route, peer: PeerId, parcel: &Parcel) -> Result<Receivers, WireError> {
    match &parcel.address {
        Some(address) => addressed(route, address, parcel.name()),
        None => Ok(match (parcel.echo, route.position(peer)) {
            (Some(false), Some(own)) => Receivers::AllBut(own),
            _ => Receivers::All,
        }),
    }
}

/// Addressees that are looked for one by one.
const FEW_NAMES: usize = 4;

fn addressees(parcel: &Parcel) -> usize {
    parcel.address.as_ref().map_or(0, Vec::len)
}

fn places_by_name(route: &Route) -> HashMap<&str, usize> {
    let members = route.members.iter().enumerate();
    members
        .map(|(place, member)| (&*member.facts.name, place))
        .collect()
}

/// The members of these names. A stop is for those that are there: who has left does not keep the others moving.
#[inline(never)]
fn addressed(route: &Route, address: &[Arc<str>], message: &str) -> Result<Receivers, WireError> {
    let is_stop = message == event::STOP;
    let mut places = Vec::new();
    let mut unknown = None;
    // A parcel may hold thousands of names, and this runs in the channel's critical section: each is looked up once,
    // and where there are many the members are walked over once.
    let mut seen = HashSet::new();
    let all = match address.len() > FEW_NAMES {
        true => places_by_name(route),
        false => HashMap::new(),
    };
    for name in address.iter().filter(|name| seen.insert(&***name)) {
        let one_by_one = || {
            let mut members = route.members.iter();
            members.position(|member| member.facts.name == *name)
        };
        let place = match all.is_empty() {
            true => one_by_one(),
            false => all.get(&**name).copied(),
        };
        match place {
            Some(place) => places.push(place),
            None if is_stop && unknown.is_some() => {}
            None => {
                let names = route.members.iter().map(|member| &*member.facts.name);
                let error = WireError::new(
                    Code::UNKNOWN_PEER,
                    format!("there is no member {name:?} in {}", route.path),
                );
                let error = error.slot("address").nearest_opt(nearest(name, names));
                if !is_stop {
                    return Err(error);
                }
                unknown = Some(error);
            }
        }
    }
    match unknown.filter(|_| places.is_empty()) {
        Some(error) => Err(error),
        None => Ok(Receivers::These(places)),
    }
}
