//! Stops of devices: numbered in the order of their causes, remembered over absence and restarts, told to all that are
//! concerned (M43).
//!
//! A stop is handed out before it is kept, an unstop is kept before it is handed out: whatever is lost on the way, the
//! device stands.

mod away;
mod call;
mod device;
mod lift;
mod stopping;

pub(crate) use call::{begin, end_call};
pub(crate) use device::DeviceWord;
pub(crate) use lift::unstop;
pub(crate) use stopping::shortened;
pub(crate) use stopping::{Stopping, reason_of};

use std::collections::BTreeSet;

use mom_proto::{Content, ContextNumber, Parcel, Value, Verb};

use crate::token::state::Token;
use crate::world::World;
use crate::world::stops::{Kept, Storing};
use crate::{Effect, PeerId, Ticket};

impl World {
    /// A stop that was handed out, or an unstop that is to be, is kept now, or will never be.
    pub(crate) fn take_kept(&mut self, storing: Storing, ok: bool, out: &mut Vec<Effect>) {
        match storing {
            Storing::Unstop(unstop) => lift::finish(self, &unstop, ok, out),
            Storing::Stop { call, channel } => {
                let kept = if ok { Kept::Yes } else { Kept::No };
                self.note_call(call, channel, |called| called.kept = kept, out);
            }
            Storing::Away { call, channel } => {
                let kept = if ok { Kept::Yes } else { Kept::No };
                self.note_away(call, &channel, kept, out);
            }
        }
    }

    /// Whether anything outlives this hub.
    fn keeps_stops(&self) -> bool {
        self.settings.keeps_stops
    }

    /// Keeps what holds in a channel, if anything is kept; `what` waits for it.
    fn keep(&mut self, channel: ContextNumber, what: Option<Storing>, out: &mut Vec<Effect>) {
        let Some(path) = self.tree.get(channel).map(|context| context.path.clone()) else {
            return;
        };
        self.keep_record(self.stops.record(&path), what, out);
    }

    fn keep_record(&mut self, record: crate::StopRecord, what: Option<Storing>, out: &mut Vec<Effect>) {
        if !self.keeps_stops() {
            return;
        }
        let ticket = what.map(|what| {
            self.last_ticket += 1;
            let ticket = Ticket(self.last_ticket);
            self.stops.storing.insert(ticket, what);
            ticket
        });
        out.push(Effect::Keep { record, ticket });
    }

    /// The stopped channels that a token guards: `[{path, number, stopped, by, …}]`; none = there are none.
    pub(crate) fn stops_guarded_by(&self, token: &Token) -> Option<Vec<Value>> {
        let guarded = token.guarded.iter().filter_map(|channel| self.tree.get(*channel));
        let stopped = guarded.filter_map(|channel| {
            let latch = self.stops.latch(&channel.path);
            let stop = latch.describe();
            latch
                .is_stopped()
                .then(|| Value::Map(stop.with("path", channel.path.as_str())))
        });
        let stopped: Vec<Value> = stopped.collect();
        (!stopped.is_empty()).then_some(stopped)
    }

    /// Who is told of a channel's stops: its members, and those of the token that guards it, but who has heard it.
    fn told_of_stops(&self, channel: ContextNumber, heard: &BTreeSet<PeerId>) -> Vec<PeerId> {
        let Some(context) = self.tree.get(channel) else {
            return Vec::new();
        };
        let guard = context.channel().and_then(|channel| channel.guard.as_ref());
        let token = guard.and_then(|guard| self.tree.find(&guard.token));
        let members = context.members.keys();
        let members = members.chain(token.into_iter().flat_map(|token| token.members.keys()));
        let members: BTreeSet<PeerId> = members.copied().collect();
        members.difference(heard).copied().collect()
    }
}

/// The content of a message as a map, if it is one of a size that is looked at.
fn map_of(parcel: &Parcel) -> Option<mom_proto::Map> {
    match read(parcel)? {
        Value::Map(map) => Some(map),
        _ => None,
    }
}

fn read(parcel: &Parcel) -> Option<Value> {
    let content = parcel.content.as_ref();
    content
        .filter(|content| content.size() <= Verb::OPENED)
        .and_then(|content: &Content| content.to_value().ok())
}
