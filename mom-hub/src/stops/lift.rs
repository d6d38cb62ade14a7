//! An unstop: it lifts what its user has seen and nothing newer, and is kept before any device hears it.

use std::collections::BTreeSet;
use std::sync::Arc;

use mom_proto::{Code, ContextNumber, Fence, Map, Parcel, Path, STOP, Value, WireError, event};

use crate::messages::admit::receivers;
use crate::tree::latch::Newer;
use crate::world::World;
use crate::world::stops::{Kept, Storing, Unstop};
use crate::{Audit, Effect, PeerId, Receivers, Route};

/// Begins to carry out an unstop whose message may pass.
///
/// # Errors
/// `bad-slot` without the number of a stop, or with one that was never given out; `newer-stop` if it lifts nothing.
pub(crate) fn unstop(
    world: &mut World,
    peer: PeerId,
    channel: ContextNumber,
    parcel: Parcel,
    out: &mut Vec<Effect>,
) -> Result<(), WireError> {
    let Some(path) = world.tree.get(channel).map(|context| context.path.clone()) else {
        return Err(world.faulted("unstopping a channel that does not exist"));
    };
    let up_to = named(&parcel)?;
    let mut latch = world.stops.latch(&path);
    if up_to > latch.newest {
        let text = format!(
            "{path} has no stop with this number; its newest is {}",
            latch.newest
        );
        return Err(WireError::new(Code::BAD_SLOT, text)
            .slot(STOP)
            .detail(STOP, latch.newest));
    }
    let newer = latch.lift(up_to, parcel.address.as_deref());
    if lifts_nothing(&newer, parcel.address.as_deref()) {
        return Err(newer_stop(&path, latch.newest, &newer));
    }
    world.count_unstop(peer, channel)?;
    let unstop = Unstop {
        peer,
        channel,
        up_to,
        parcel,
        call: None,
    };
    keep_or_finish(world, unstop, out);
    Ok(())
}

/// Keeps what will hold after an unstop; where nothing is kept, it takes effect at once.
pub(super) fn keep_or_finish(world: &mut World, unstop: Unstop, out: &mut Vec<Effect>) {
    let path = world.tree.get(unstop.channel).map(|context| context.path.clone());
    match path.filter(|_| world.keeps_stops()) {
        Some(path) => {
            let mut record = world.stops.record(&path);
            record.latch.lift(unstop.up_to, unstop.parcel.address.as_deref());
            world.keep_record(record, Some(Storing::Unstop(Box::new(unstop))), out);
        }
        None => finish(world, &unstop, true, out),
    }
}

/// Hands an unstop out that is kept. What was stopped meanwhile stays so.
pub(super) fn finish(world: &mut World, unstop: &Unstop, kept: bool, out: &mut Vec<Effect>) {
    let channel = unstop.channel;
    let ended = lift(world, unstop, kept, out);
    // What was kept may say more than what holds: a stop has come meanwhile, or it was called off.
    // Also where the channel is gone: by its path, or a restart would take it for free.
    if let Some(path) = unstop.parcel.context.as_ref() {
        world.keep_record(world.stops.record(path), None, out);
    }
    match (unstop.call, ended) {
        (Some(call), ended) => {
            let (newer, failed) = match ended {
                Ok(newer) => (newer, None),
                Err(error) => (Vec::new(), Some(error.code)),
            };
            let kept = if kept { Kept::Yes } else { Kept::No };
            let note = |called: &mut crate::world::stops::Called| {
                if failed.is_some() || lifts_nothing(&newer, None) {
                    called.devices.clear();
                }
                (called.newer, called.kept, called.failed) = (newer, kept, failed);
                for (name, _) in &called.newer {
                    name.as_ref().and_then(|name| called.devices.remove(name));
                }
            };
            world.note_call(call, channel, note, out);
        }
        (None, Err(error)) => refuse(world, unstop, &error, out),
        (None, Ok(newer)) if !newer.is_empty() => {
            let path = world.tree.get(channel).map(|context| context.path.clone());
            if let Some(path) = path {
                let newest = world.stops.latch(&path).newest;
                refuse(world, unstop, &newer_stop(&path, newest, &newer), out);
            }
        }
        (None, Ok(_)) => {}
    }
}

/// Lifts, hands out, and tells of it; gives what is newer and holds on.
fn lift(
    world: &mut World,
    unstop: &Unstop,
    kept: bool,
    out: &mut Vec<Effect>,
) -> Result<Vec<Newer>, WireError> {
    if !kept {
        let text = "the unstop could not be stored, so the devices stay stopped";
        return Err(WireError::new(Code::STORAGE_FAILED, text));
    }
    let Some(route) = world
        .route(unstop.channel)
        .filter(|_| world.peers.get(unstop.peer).is_some())
    else {
        return Err(WireError::new(
            Code::UNKNOWN_PATH,
            "the channel was deleted meanwhile",
        ));
    };
    let only = unstop.parcel.address.as_deref();
    let all = match only.filter(|_| unstop.call.is_some()) {
        None => receivers(&route, unstop.peer, &unstop.parcel)?,
        // A device that is away finds that it may move.
        Some(only) => {
            let members = route.members.iter().enumerate();
            let meant = members.filter(|(_, member)| only.contains(&member.facts.name));
            Receivers::These(meant.map(|(place, _)| place).collect())
        }
    };
    let latch = world.stops.latch_mut(&route.path);
    let was_stopped = latch.is_stopped();
    let newer = latch.lift(unstop.up_to, only);
    if lifts_nothing(&newer, only) {
        return Ok(newer);
    }
    let told = latch.describe();
    let receivers = without(&route, all, &newer);
    let (path, heard) = (route.path.clone(), receivers.peers(&route));
    world.note_lifted(unstop.channel);
    out.push(Effect::Send {
        from: unstop.peer,
        parcel: Box::new(unstop.parcel.clone()),
        receivers,
        route: Arc::new(route),
        rate: None,
    });
    if was_stopped {
        tell(world, unstop, (&path, told), &heard, out);
    }
    Ok(newer)
}

/// Tells those of it that the message does not reach, and the audit log.
fn tell(
    world: &World,
    unstop: &Unstop,
    (path, mut told): (&Path, Map),
    heard: &BTreeSet<PeerId>,
    out: &mut Vec<Effect>,
) {
    told.set("unstopped-by", world.name_of(unstop.peer));
    let to = world.told_of_stops(unstop.channel, heard);
    world.push_event(event::UNSTOPPED, path, to, told, out);
    let fact = Audit {
        context: Some(path.clone()),
        stop: Some(unstop.up_to.into()),
        ..world.fact("unstopped", unstop.peer)
    };
    world.audit(fact, out);
}

/// The receivers of an unstop but those that a newer stop holds.
fn without(route: &Route, all: Receivers, newer: &[Newer]) -> Receivers {
    if newer.is_empty() {
        return all;
    }
    let held = |place: &usize| {
        let name = &route.members[*place].facts.name;
        newer.iter().any(|(held, _)| held.as_ref() == Some(name))
    };
    let places = all.places(route.members.len()).into_iter();
    Receivers::These(places.filter(|place| !held(place)).collect())
}

fn lifts_nothing(newer: &[Newer], only: Option<&[Arc<str>]>) -> bool {
    let all = newer.iter().any(|(name, _)| name.is_none());
    all || only.is_some_and(|only| newer.len() >= only.len())
}

/// The number that an unstop names.
fn named(parcel: &Parcel) -> Result<Fence, WireError> {
    let number = match parcel.extra.get(STOP) {
        Some(Value::Int(number)) => u64::try_from(*number).ok(),
        _ => None,
    };
    number.map(Fence::from).ok_or_else(|| {
        let text = "an unstop names the newest stop that its user has seen: add the slot stop, an int, with the \
                    number that join, info, stopped and state tell";
        WireError::new(Code::BAD_SLOT, text).slot(STOP)
    })
}

/// What is said of stops that an unstop does not lift.
fn newer_stop(path: &Path, newest: Fence, newer: &[Newer]) -> WireError {
    let by = newer.iter().map(|(_, stop)| stop).max_by_key(|stop| stop.number);
    let text = match by {
        Some(stop) => format!(
            "{} stopped {path} again since; check it before you unstop it",
            stop.by
        ),
        None => format!("{path} was stopped again since"),
    };
    WireError::new(Code::NEWER_STOP, text)
        .detail(STOP, newest)
        .detail("newer", newer_value(newer))
}

/// `[{number, device, by, user, since, reason}]`
pub(super) fn newer_value(newer: &[Newer]) -> Value {
    let one = |(name, stop): &Newer| {
        let map = Map::new().with("number", stop.number);
        let map = match name {
            Some(name) => map.with("device", &**name),
            None => map,
        };
        Value::Map(stop.describe(map))
    };
    Value::List(newer.iter().map(one).collect())
}

fn refuse(world: &World, unstop: &Unstop, error: &WireError, out: &mut Vec<Effect>) {
    if world.peers.get(unstop.peer).is_some() {
        world.push_refusal(unstop.peer, &unstop.parcel, error, out);
    }
}
