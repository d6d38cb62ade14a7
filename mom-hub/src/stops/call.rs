//! `context stop` and `context unstop`: one channel, or all of a session in one request, answered when each device has said
//! that it obeys, or when the time for that is over.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use mom_proto::{
    Code, ContextKind, ContextNumber, Family, Fence, Map, Micros, Parcel, Path, STOP, Value, Verb, WireError,
    event,
};
use serde::Deserialize;

use super::lift::{keep_or_finish, newer_value};
use super::stopping::{Stopping, shortened};
use crate::asking::wish::Wish;
use crate::content;
use crate::tree::context::Context;
use crate::values::count;
use crate::world::steps::{Job, STEP, Sweep, TOLD, told};
use crate::world::stops::{Call, Called, Kept, Order, Standing, Storing, Unstop, Word};
use crate::world::{Timer, World};
use crate::{Effect, PeerId, Receivers};

/// For how long devices are waited for, ms: at most, and if the request does not say.
const LONGEST: u64 = 10_000;
const USUAL: u64 = 1_000;

/// Requests of one peer that wait for devices; further ones are carried out and answered at once.
const CALLS: usize = 8;

/// Sessions that one peer stops at once: each is a question to a manager for every channel.
const SWEEPS: usize = 2;

/// Channels and refused paths that one reply names.
pub(super) const NAMED: usize = 1024;
const DENIED: usize = 64;

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// ms.
    within: Option<u64>,
    /// Of `stop`: why.
    reason: Option<String>,
    /// For these devices of a channel only.
    only: Option<Vec<String>>,
    /// Of `unstop`: the newest stop of the channel that its user has seen.
    stop: Option<u64>,
    /// Of `unstop` of a session: the same for each channel, by path.
    stops: Option<BTreeMap<String, u64>>,
}

/// Carries out a request about a channel that the peer may stop, or about all below a session that it may know of.
///
/// # Errors
/// `bad-content`, `wrong-kind`.
pub(crate) fn begin(
    world: &mut World,
    (peer, id): (PeerId, Option<u64>),
    verb: Verb,
    top: ContextNumber,
    parcel: &Parcel,
    out: &mut Vec<Effect>,
) -> Result<(), WireError> {
    let args: Args = content::read_or_default(parcel)?;
    let Some((path, kind)) = world.tree.get(top).map(|top| (top.path.clone(), top.kind())) else {
        return Err(world.faulted("stopping a context that does not exist"));
    };
    let within = args.within.unwrap_or(USUAL).min(LONGEST);
    if kind == ContextKind::Session {
        world.check_sweeps(peer)?;
    }
    let order = order(world, peer, verb, (&path, kind), args)?;
    if verb == Verb::Unstop {
        world.count_unstop(peer, top)?;
    }
    let waits = world
        .stops
        .calls
        .values()
        .filter(|call| call.peer == peer)
        .count()
        < CALLS;
    let until = world.after(if waits { within.saturating_mul(1000) } else { 0 });
    let call = Call {
        peer,
        id,
        path: path.clone(),
        verb,
        until,
        walks: kind == ContextKind::Session,
        order: (kind == ContextKind::Session && verb == Verb::Stop).then(|| order.clone()),
        channels: BTreeMap::new(),
        away: BTreeMap::new(),
        others: 0,
        denied: Vec::new(),
    };
    let number = order.call;
    world.stops.last_call = number;
    world.stops.calls.insert(number, call);
    world.timers.insert((until, Timer::Call(number)));
    if kind == ContextKind::Channel {
        world.tell_channel(&order, top, out);
        world.settle_call(number, out);
        return Ok(());
    }
    let mut sweep = Sweep {
        order,
        top: path,
        after: None,
        newest: world.tree.newest(),
        again: None,
        away: None,
    };
    if !world.sweep_step(&mut sweep, out) {
        world.begin_job(Job::Stop(Box::new(sweep)));
    }
    Ok(())
}

fn order(
    world: &World,
    peer: PeerId,
    verb: Verb,
    (path, kind): (&Path, ContextKind),
    args: Args,
) -> Result<Order, WireError> {
    let bad = |key: &str, text: &str| Err(content::bad(key, text.to_owned()));
    if kind == ContextKind::Session && args.only.is_some() {
        return bad(
            "only",
            "a session has no devices of its own: name a channel, or leave out `only`",
        );
    }
    if args.only.as_ref().is_some_and(Vec::is_empty) {
        return bad(
            "only",
            "the list `only` is empty; leave it out to address all devices",
        );
    }
    let stops: BTreeMap<Path, Fence> = match (verb, kind, args.stop, args.stops) {
        (Verb::Unstop, ContextKind::Channel, Some(number), None) => {
            BTreeMap::from([(path.clone(), number.into())])
        }
        (Verb::Unstop, ContextKind::Channel, ..) => {
            return bad(
                "stop",
                "unstop requires stop: the number, from info, of the newest stop that its user has seen",
            );
        }
        (Verb::Unstop, _, None, Some(stops)) => {
            let read = |(path, number): (String, u64)| Ok((content::path(&path, "stops")?, number.into()));
            stops.into_iter().map(read).collect::<Result<_, WireError>>()?
        }
        (Verb::Unstop, ..) => {
            return bad(
                "stops",
                "an unstop of a session names for each channel the newest stop that its user has seen: a map of paths \
                 to numbers",
            );
        }
        (_, _, None, None) => BTreeMap::new(),
        _ => return bad("stop", "the hub assigns the number of a stop"),
    };
    Ok(Order {
        call: world.stops.last_call + 1,
        peer,
        verb,
        reason: args.reason.as_deref().and_then(shortened),
        only: args
            .only
            .map(|only| only.iter().map(|name| Arc::from(name.as_str())).collect()),
        stops: Arc::new(stops),
    })
}

impl World {
    /// Checks that a peer goes through no more sessions at once than others can bear.
    fn check_sweeps(&self, peer: PeerId) -> Result<(), WireError> {
        let calls = self.stops.calls.values();
        let walking = calls.filter(|call| call.walks && call.peer == peer);
        if walking.count() < SWEEPS {
            return Ok(());
        }
        let text = "this peer's earlier stops of whole sessions are still pending";
        Err(WireError::new(Code::TRY_LATER, text).retry_after(Duration::from_micros(WALKS)))
    }

    /// One step through a session; true with the last. What was made meanwhile is looked at at the end.
    pub(crate) fn sweep_step(&mut self, sweep: &mut Sweep, out: &mut Vec<Effect>) -> bool {
        let start = out.len();
        for _ in 0..STEP {
            let next = match sweep.again {
                None => self.tree.below(&sweep.top, sweep.after.as_ref()).next(),
                Some(after) => self.tree.made_after(after),
            };
            let Some(next) = next else {
                if sweep.again.is_none() {
                    sweep.again = Some(sweep.newest);
                    continue;
                }
                if let Some(away) = self.next_away(sweep) {
                    self.stop_away(&sweep.order, away, out);
                    continue;
                }
                self.end_sweep(sweep.order.call, out);
                return true;
            };
            let path = self.tree.get(next).map(|context| context.path.clone());
            let inside = path.as_ref().is_some_and(|path| path.is_within(&sweep.top));
            match &mut sweep.again {
                None => sweep.after = path,
                Some(after) => *after = next,
            }
            if inside {
                self.tell_below(&sweep.order, next, out);
            }
            if told(&out[start..]) >= TOLD {
                return false;
            }
        }
        false
    }

    /// Stops a channel that was made below a session whose stop has passed its place and is not answered yet.
    pub(crate) fn stop_made(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        let Some(path) = self.tree.get(number).map(|context| context.path.clone()) else {
            return;
        };
        let calls = self.stops.calls.values();
        let passed = calls.filter(|call| !call.walks && path.is_within(&call.path));
        let orders: Vec<Order> = passed.filter_map(|call| call.order.clone()).collect();
        for order in orders {
            self.tell_below(&order, number, out);
        }
    }

    fn end_sweep(&mut self, call: u64, out: &mut Vec<Effect>) {
        if let Some(known) = self.stops.calls.get_mut(&call) {
            known.walks = false;
        }
        self.settle_call(call, out);
    }

    /// Tells a channel of a session, where its peer has the right to.
    fn tell_below(&mut self, order: &Order, number: ContextNumber, out: &mut Vec<Effect>) {
        let Some(context) = self.tree.get(number) else {
            return;
        };
        let is_meant = context.channel().is_some()
            && (order.verb == Verb::Stop || order.stops.contains_key(&context.path));
        if !is_meant || self.peers.get(order.peer).is_none() {
            return;
        }
        let path = context.path.clone();
        let guard = context.channel().and_then(|channel| channel.guard.as_ref());
        let matters = guard.is_some() || context.members.values().any(|member| member.device);
        let wish = Wish {
            message: Some(order.verb.word()),
            ..Wish::new(order.verb, number)
        };
        if self.ask(order.peer, &wish, &[]).is_ok() {
            return self.tell_channel(order, number, out);
        }
        if matters
            && !self.is_hidden(order.peer, number)
            && let Some(call) = self.stops.calls.get_mut(&order.call)
            && call.denied.len() < DENIED
        {
            call.denied.push(path);
        }
    }

    /// Says it to one channel, and notes whose word is waited for.
    fn tell_channel(&mut self, order: &Order, number: ContextNumber, out: &mut Vec<Effect>) {
        let Some(context) = self.tree.get(number) else {
            return;
        };
        let called = self.called(order, context);
        let awaited = !called.devices.is_empty();
        let matters = awaited || called.guarded;
        if let Some(call) = self.stops.calls.get_mut(&order.call) {
            match matters && call.channels.len() < NAMED {
                true => drop(call.channels.insert(number, called)),
                false => call.others += 1,
            }
        }
        if awaited {
            self.changed.insert(number);
        }
        match order.verb {
            Verb::Stop => self.hand_out_stop(order, number, matters, out),
            _ => self.hand_out_unstop(order, number, out),
        }
    }

    fn called(&self, order: &Order, context: &Context) -> Called {
        let meant = |name: &Arc<str>| order.only.as_ref().is_none_or(|only| only.contains(name));
        let devices = context.members.values().filter(|member| member.device);
        let devices = devices.filter(|member| meant(&member.facts.name)).map(|member| {
            let lost = self.lost_until(member.peer).is_some();
            let word = if lost { Word::Lost } else { Word::Silent };
            (Arc::clone(&member.facts.name), word)
        });
        let channel = context.channel();
        Called {
            path: context.path.clone(),
            number: match order.verb {
                Verb::Stop => self.next_stop(context.number),
                _ => order.stops.get(&context.path).copied().unwrap_or_default(),
            },
            guarded: channel.is_some_and(|channel| channel.guard.is_some()),
            devices: devices.collect(),
            kept: if self.settings.keeps_stops {
                Kept::Waits
            } else {
                Kept::No
            },
            newer: Vec::new(),
            failed: None,
        }
    }

    fn hand_out_stop(&mut self, order: &Order, channel: ContextNumber, matters: bool, out: &mut Vec<Effect>) {
        let number = self.next_stop(channel);
        let reason = order.reason.as_deref();
        let content = reason.map(|reason| Map::new().with("reason", reason));
        let heard = self.hand_out(order, (channel, number), content, out);
        let stopping = Stopping {
            channel,
            peer: order.peer,
            only: order.only.as_deref(),
            reason: order.reason.clone(),
            heard: heard.unwrap_or_default(),
        };
        let storing = matters.then_some(Storing::Stop {
            call: order.call,
            channel,
        });
        self.take_hold(&stopping, number, storing, out);
    }

    fn hand_out_unstop(&mut self, order: &Order, channel: ContextNumber, out: &mut Vec<Effect>) {
        let Some(parcel) = self.said(order, channel, None) else {
            return;
        };
        let up_to = order
            .stops
            .get(parcel.context.as_ref().unwrap_or(&Path::root()))
            .copied();
        let up_to = up_to.unwrap_or_default();
        // A device that took such a number for one of a stop would hold none of the stops below it.
        if up_to
            > self
                .stops
                .latch(parcel.context.as_ref().unwrap_or(&Path::root()))
                .newest
        {
            let note = |called: &mut Called| {
                called.failed = Some(Code::BAD_SLOT);
                called.devices.clear();
                called.kept = Kept::No;
            };
            return self.note_call(order.call, channel, note, out);
        }
        let mut parcel = parcel;
        parcel.extra.set(STOP, up_to);
        let unstop = Unstop {
            peer: order.peer,
            channel,
            up_to,
            parcel,
            call: Some(order.call),
        };
        keep_or_finish(self, unstop, out);
    }

    /// Hands a stop out to whom it is for, and gives who they are; who is not there finds it later.
    fn hand_out(
        &self,
        order: &Order,
        (channel, number): (ContextNumber, Fence),
        content: Option<Map>,
        out: &mut Vec<Effect>,
    ) -> Option<BTreeSet<PeerId>> {
        let mut parcel = self.said(order, channel, content)?;
        let route = self.route(channel)?;
        parcel.extra.set(STOP, number);
        let receivers = match &order.only {
            None => Receivers::All,
            Some(only) => {
                let members = route.members.iter().enumerate();
                let meant = members.filter(|(_, member)| only.contains(&member.facts.name));
                Receivers::These(meant.map(|(place, _)| place).collect())
            }
        };
        let heard = receivers.peers(&route);
        out.push(Effect::Send {
            from: order.peer,
            parcel: Box::new(parcel),
            receivers,
            route: Arc::new(route),
            rate: None,
        });
        Some(heard)
    }

    /// The message of an order, stamped as the peer's own.
    fn said(&self, order: &Order, channel: ContextNumber, content: Option<Map>) -> Option<Parcel> {
        let facts = &self.peers.get(order.peer)?.facts;
        let path = &self.tree.get(channel)?.path;
        let name = match order.verb {
            Verb::Stop => event::STOP,
            _ => event::UNSTOP,
        };
        let mut parcel = self.hub_parcel(Family::Message, name, path);
        parcel.sender = Some(Arc::clone(&facts.name));
        parcel.received = parcel.timestamp;
        parcel.age = Some(0);
        parcel.address = order.only.as_ref().map(|only| only.to_vec());
        parcel.content = content.map(Into::into);
        Some(parcel)
    }

    /// Notes what has become known of one channel of a call, and answers the call if that was all.
    pub(super) fn note_call(
        &mut self,
        call: u64,
        channel: ContextNumber,
        note: impl FnOnce(&mut Called),
        out: &mut Vec<Effect>,
    ) {
        let was_awaited = self.stops.is_awaited(channel);
        let known = self.stops.calls.get_mut(&call);
        if let Some(called) = known.and_then(|known| known.channels.get_mut(&channel)) {
            note(called);
        }
        if was_awaited != self.stops.is_awaited(channel) {
            self.changed.insert(channel);
        }
        self.settle_call(call, out);
    }

    pub(super) fn settle_call(&mut self, call: u64, out: &mut Vec<Effect>) {
        if self.stops.calls.get(&call).is_some_and(Call::is_complete) {
            end_call(self, call, out);
        }
    }
}

/// Answers a call with what is known.
pub(crate) fn end_call(world: &mut World, number: u64, out: &mut Vec<Effect>) {
    // The walk goes on: what it comes to is not waited for, but told.
    if let Some(call) = world.stops.calls.get_mut(&number).filter(|call| call.walks) {
        call.until = world.now.saturating_add(WALKS);
        let again = (call.until, Timer::Call(number));
        world.timers.insert(again);
        return;
    }
    let Some(call) = world.stops.calls.remove(&number) else {
        return;
    };
    world.timers.remove(&(call.until, Timer::Call(number)));
    let awaited: BTreeSet<ContextNumber> = call.channels.keys().copied().collect();
    let there = awaited
        .into_iter()
        .filter(|channel| world.tree.get(*channel).is_some());
    let there: Vec<ContextNumber> = there.collect();
    world.changed.extend(there);
    if world.peers.get(call.peer).is_some() {
        let content = answer(&call, world.settings.keeps_stops);
        world.push_ok(call.peer, call.id, &call.path, Some(content), out);
    }
}

/// A call whose walk is longer than its time is answered when that is over, looked at so often.
const WALKS: Micros = 20_000;

/// `{channels: [{path, number, guard, kept, devices: [{peer, word, moving?, rest?, reached?, estop?}], newer, error}], others,
/// denied}`; `keeps` says whether anything outlives the hub.
fn answer(call: &Call, keeps: bool) -> Map {
    let fails = |kept| keeps && call.verb == Verb::Stop && kept == Kept::No;
    let obeys = match call.verb {
        Verb::Stop => "stopped",
        _ => "unstopped",
    };
    let channels = call.channels.values().map(|called| {
        let devices = called.devices.iter().map(|(name, word)| {
            let device = Map::new().with("peer", &**name);
            Value::Map(match word {
                Word::Silent => device.with("word", "silent"),
                Word::Obeys(standing) => standing.add_to(device.with("word", obeys)),
                Word::Lost => device.with("word", "lost"),
            })
        });
        let mut map = Map::new()
            .with("path", called.path.as_str())
            .with("number", called.number)
            .with("guard", called.guarded)
            .with("kept", called.kept == Kept::Yes)
            .with("devices", devices.collect::<Vec<_>>());
        if !called.newer.is_empty() {
            map.set("newer", newer_value(&called.newer));
        }
        let unkept = fails(called.kept).then_some(Code::STORAGE_FAILED);
        if let Some(code) = called.failed.clone().or(unkept) {
            map.set("error", code.word());
        }
        Value::Map(map)
    });
    let away = call.away.iter().map(|(path, (number, kept))| {
        let map = Map::new()
            .with("path", path.as_str())
            .with("number", *number)
            .with("guard", true)
            .with("kept", *kept == Kept::Yes)
            .with("devices", Vec::<Value>::new());
        Value::Map(match fails(*kept) {
            true => map.with("error", Code::STORAGE_FAILED.word()),
            false => map,
        })
    });
    let denied = call.denied.iter().map(|path| Value::from(path.as_str()));
    Map::new()
        .with("channels", channels.chain(away).collect::<Vec<_>>())
        .with("others", count(call.others))
        .with("denied", denied.collect::<Vec<_>>())
}

impl Standing {
    /// `{moving?, rest?, reached?, estop?}`: what matters to who wants it to stand.
    fn add_to(self, mut device: Map) -> Map {
        // What does not say that it rests, though it could, is not known to.
        if self.is_awaited() {
            device.set("moving", true);
        }
        if let Some(rest) = self.rest {
            device.set("rest", rest.word());
        }
        if self.reached == Some(false) {
            device.set("reached", false);
        }
        if self.estop {
            device.set("estop", true);
        }
        device
    }
}
