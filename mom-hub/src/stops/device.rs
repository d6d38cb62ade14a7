//! What a device says of itself, and what it hears when it comes: a device moves nothing before it knows.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use mom_proto::{Code, ContextNumber, Family, Fence, Map, Parcel, STOP, Value, WireError, event};

use super::map_of;
use crate::tree::installation;
use crate::world::World;
use crate::world::stops::{Called, Kept, Rest, Standing, Word};
use crate::{Effect, PeerId};

/// The message by which a device says how it stands.
const STATE: &str = "state";

/// Seconds by which the epoch of a device's number may be ahead of the hub's: clocks of hubs differ.
const AHEAD: u64 = 1 << 20;

/// What a device says when it joins: the newest stop that it has heard of, and whether it stands for it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct DeviceWord {
    pub(crate) number: Fence,
    pub(crate) stopped: bool,
}

impl DeviceWord {
    /// From the content of a join: `true`, or `{stop, stopped}`; none = it is not a device.
    ///
    /// # Errors
    /// `bad-content`.
    pub(crate) fn read(value: &Value) -> Result<Option<DeviceWord>, WireError> {
        let bad = |key: &str, text: &str| WireError::new(Code::BAD_CONTENT, text).slot(key);
        let map = match value {
            Value::Bool(device) => return Ok(device.then(DeviceWord::default)),
            Value::Map(map) => map,
            _ => {
                return Err(bad("content/device", "device must be a boolean or a map"));
            }
        };
        let is_known =
            |key: &str| [STOP, "stopped", "card"].contains(&key) || installation::KEYS.contains(&key);
        if let Some((key, _)) = map.iter().find(|(key, _)| !is_known(key)) {
            return Err(bad(
                &format!("content/device/{key}"),
                "device may have only the keys stop, stopped, installation, begun and card",
            ));
        }
        let number = match map.get(STOP) {
            None => 0,
            Some(Value::Int(number)) => u64::try_from(*number)
                .map_err(|_| bad("content/device/stop", "the number of a stop must not be negative"))?,
            Some(_) => return Err(bad("content/device/stop", "the number of a stop must be an int")),
        };
        let stopped = match map.get("stopped") {
            None => false,
            Some(Value::Bool(stopped)) => *stopped,
            Some(_) => return Err(bad("content/device/stopped", "stopped must be a boolean")),
        };
        Ok(Some(DeviceWord {
            number: number.into(),
            stopped,
        }))
    }

    /// Checks that a hub can have given out the number.
    pub(crate) fn check(&self, epoch: u64) -> Result<(), WireError> {
        if self.number < Fence::floor(epoch.saturating_add(AHEAD)) {
            return Ok(());
        }
        let text = format!(
            "no hub has assigned the stop number {}; check that this machine's clock is right, or start the device without its stored state",
            self.number
        );
        Err(WireError::new(Code::BAD_CONTENT, text).slot("content/device/stop"))
    }
}

impl World {
    /// Whether a peer is a member of a channel that obeys stops there.
    pub(crate) fn is_device(&self, peer: PeerId, channel: ContextNumber) -> bool {
        let context = self.tree.get(channel);
        let member = context.and_then(|context| context.members.get(&peer));
        member.is_some_and(|member| member.device)
    }

    /// Notes that a device is there, and has a stop for one device by name hold for one that is new here and has its
    /// name but for what the hub added: it may be the same one, started again while its old connection keeps the name.
    fn welcome_device(&mut self, channel: ContextNumber, peer: PeerId, out: &mut Vec<Effect>) {
        let name = self.peers.get(peer).map(|peer| Arc::clone(&peer.facts.name));
        let path = self.tree.get(channel).map(|context| context.path.clone());
        let (Some(name), Some(path)) = (name, path) else {
            return self.fault("welcoming a device that does not exist");
        };
        if !self.stops.latch(&path).device {
            self.stops.latch_mut(&path).device = true;
            self.keep(channel, None, out);
            self.bound_stops(out);
        }
        let Some(stop) = self.stops.latch(&path).of_namesake(&name) else {
            return;
        };
        let latch = self.stops.latch_mut(&path);
        latch.stop(stop, Some(&[name]));
        let told = latch.describe();
        let to = self.told_of_stops(channel, &BTreeSet::from([peer]));
        self.push_event(event::STOPPED, &path, to, told, out);
        self.keep(channel, None, out);
    }

    /// Takes in what a device says that joins: where it knows of a stop that this hub does not, the stop holds.
    pub(crate) fn meet_device(
        &mut self,
        channel: ContextNumber,
        peer: PeerId,
        (word, is_new): (DeviceWord, bool),
        out: &mut Vec<Effect>,
    ) {
        if is_new {
            self.welcome_device(channel, peer, out);
        }
        let stop = self.stop_by(peer, word.number, Some("it was stopped when it joined".into()));
        let path = self.tree.get(channel).map(|context| context.path.clone());
        let (Some(stop), Some(path)) = (stop, path) else {
            return self.fault("welcoming a device that does not exist");
        };
        let before = self.stops.latch(&path);
        let latch = self.stops.latch_mut(&path);
        let device = Arc::clone(&stop.by);
        let holds = latch.meet(&device, word.number, word.stopped);
        if *latch == before && !holds {
            return;
        }
        if holds {
            latch.stop(stop, Some(&[device]));
            let told = latch.describe();
            let to = self.told_of_stops(channel, &BTreeSet::from([peer]));
            self.push_event(event::STOPPED, &path, to, told, out);
            self.audit_stop(peer, path, (word.number, None), out);
        }
        self.keep(channel, None, out);
    }

    /// Tells a device, and nobody else, how it stands: it has joined, or come back.
    pub(crate) fn tell_device(
        &self,
        channel: ContextNumber,
        peer: PeerId,
        came_back: bool,
        out: &mut Vec<Effect>,
    ) {
        let context = self.tree.get(channel);
        let member = context.and_then(|context| Some((context, context.members.get(&peer)?)));
        let Some((context, member)) = member.filter(|(_, member)| member.device) else {
            return;
        };
        let latch = self.stops.latch(&context.path);
        let name = &member.facts.name;
        match latch.holding(name) {
            Some(stop) => {
                let mut parcel = self.hub_parcel(Family::Message, event::STOP, &context.path);
                parcel.received = parcel.timestamp;
                parcel.address = Some(vec![Arc::clone(name)]);
                parcel.extra.set(STOP, stop.number);
                parcel.content = Some(stop.describe(Map::new()).into());
                out.push(Effect::Deliver {
                    to: vec![peer],
                    parcel: Arc::new(parcel),
                });
            }
            // Who joins is told by the reply.
            None if came_back => {
                let content = latch.describe_for(name);
                self.push_event(event::UNSTOPPED, &context.path, vec![peer], content, out);
            }
            None => {}
        }
    }

    /// Has those who wait for the stop of a session wait for a device, too, that has joined below it meanwhile and stands for it.
    pub(crate) fn await_device(&mut self, channel: ContextNumber, peer: PeerId) {
        let Some(context) = self.tree.get(channel) else {
            return;
        };
        let latch = self.stops.latch(&context.path);
        let member = context.members.get(&peer).filter(|member| member.device);
        let Some(name) = member.map(|member| Arc::clone(&member.facts.name)) else {
            return;
        };
        if latch.holding(&name).is_none() {
            return;
        }
        let guard = context.channel().and_then(|channel| channel.guard.as_ref());
        let called = Called {
            path: context.path.clone(),
            number: latch.newest,
            guarded: guard.is_some(),
            devices: BTreeMap::from([(Arc::clone(&name), Word::Silent)]),
            // Its record was asked for when the channel was told, and is not waited for again.
            kept: if self.settings.keeps_stops {
                Kept::Yes
            } else {
                Kept::No
            },
            newer: Vec::new(),
            failed: None,
        };
        for call in self.stops.calls.values_mut() {
            let only = call.order.as_ref().and_then(|order| order.only.as_ref());
            let is_meant = call.verb == mom_proto::Verb::Stop
                && called.path.is_within(&call.path)
                && only.is_none_or(|only| only.contains(&name));
            match call.channels.get_mut(&channel) {
                _ if !is_meant => continue,
                Some(known) => drop(known.devices.entry(Arc::clone(&name)).or_insert(Word::Silent)),
                None => {
                    call.others = call.others.saturating_sub(1);
                    call.channels.insert(channel, called.clone());
                }
            }
            self.changed.insert(channel);
        }
    }

    /// Tells a device that has come back how it stands in each of its channels.
    pub(crate) fn tell_device_everywhere(&self, peer: PeerId, out: &mut Vec<Effect>) {
        let joined = self.peers.get(peer).map(|peer| &peer.joined);
        for channel in joined.into_iter().flatten() {
            self.tell_device(*channel, peer, true, out);
        }
    }

    /// Whether a message is a device's stop of itself, which needs no right.
    pub(crate) fn is_own_stop(&self, peer: PeerId, channel: ContextNumber, parcel: &Parcel) -> bool {
        let context = self.tree.get(channel);
        let member = context.and_then(|context| context.members.get(&peer));
        let own = member
            .filter(|member| member.device)
            .map(|member| &member.facts.name);
        own.is_some()
            && parcel
                .address
                .as_deref()
                .is_some_and(|only| only.iter().all(|name| Some(name) == own))
    }

    /// Takes in how a device says that it stands, if a peer waits for that.
    pub(crate) fn note_word(
        &mut self,
        channel: ContextNumber,
        peer: PeerId,
        parcel: &Parcel,
        out: &mut Vec<Effect>,
    ) {
        if parcel.name() != STATE || !self.stops.is_awaited(channel) {
            return;
        }
        let context = self.tree.get(channel);
        let member = context.and_then(|context| context.members.get(&peer));
        let Some(name) = member
            .filter(|member| member.device)
            .map(|member| Arc::clone(&member.facts.name))
        else {
            return;
        };
        let Some(map) = map_of(parcel) else { return };
        let Some(stopped) = map.get("stopped").and_then(Value::as_bool) else {
            return;
        };
        let standing = standing_of(&map);
        let newest = context.map_or(Fence::default(), |context| self.stops.latch(&context.path).newest);
        let number = match map.get(STOP) {
            // A device of protocol 1.1 names no number, and says nothing of its rest: what it says now is what it does.
            None if standing.reached.is_none() && standing.rest.is_none() => None,
            // A number that was never given out is not a word.
            Some(Value::Int(number)) => {
                let number = Fence::from(u64::try_from(*number).unwrap_or_default());
                Some(number)
                    .filter(|number| *number <= newest)
                    .or(Some(Fence::default()))
            }
            _ => Some(Fence::default()),
        };
        let calls: Vec<u64> = self.stops.calls.keys().copied().collect();
        for call in calls {
            let wants = self.stops.calls.get(&call).map(|call| call.verb);
            let obeys = stopped == (wants == Some(mom_proto::Verb::Stop));
            // Nobody waits for the rest of what may move again.
            let standing = match stopped {
                true => standing,
                false => Standing {
                    estop: standing.estop,
                    ..Standing::default()
                },
            };
            let note = |called: &mut Called| {
                // Who may move need not have heard of the stop that was lifted.
                let heard = !stopped || number.is_none_or(|number| number >= called.number);
                if let Some(word) = called.devices.get_mut(&name).filter(|_| obeys && heard) {
                    *word = Word::Obeys(standing.after(*word));
                }
            };
            self.note_call(call, channel, note, out);
        }
    }
}

/// What the content of a device's `state` says of its rest. What is not a boolean does not say that it stands, nor that it is reached.
fn standing_of(state: &Map) -> Standing {
    let flag = |key: &str, otherwise: bool| state.get(key).map(|said| said.as_bool().unwrap_or(otherwise));
    let rest = state.get("rest").and_then(Value::as_str);
    Standing {
        moving: flag("moving", true) == Some(true),
        reached: flag("reached", false),
        rest: [Rest::Measured, Rest::NotMeasured]
            .into_iter()
            .find(|known| rest == Some(known.word())),
        estop: flag("estop", false) == Some(true),
    }
}
