//! A stop takes hold.

use std::collections::BTreeSet;
use std::sync::Arc;

use mom_proto::event::{self, Reason};
use mom_proto::{ContextNumber, Fence, Parcel, Path, Value};

use super::read;
use crate::tree::latch::Stop;
use crate::world::World;
use crate::world::stops::Storing;
use crate::{Audit, Effect, PeerId};

/// The longest words for people that are remembered, or that others are told, in characters.
const REASON: usize = 256;

/// A stop of one channel.
pub(crate) struct Stopping<'a> {
    pub(crate) channel: ContextNumber,
    pub(crate) peer: PeerId,
    /// For these devices; none = for all.
    pub(crate) only: Option<&'a [Arc<str>]>,
    pub(crate) reason: Option<Arc<str>>,
    /// Whom the message itself reaches.
    pub(crate) heard: BTreeSet<PeerId>,
}

impl World {
    /// The number of the next stop of a channel.
    pub(crate) fn next_stop(&self, channel: ContextNumber) -> Fence {
        let path = self.tree.get(channel).map(|context| &context.path);
        path.map(|path| self.stops.next(path, self.settings.epoch))
            .unwrap_or_default()
    }

    /// Remembers a stop that goes out with this number, and tells of it; `storing` waits until it is kept.
    pub(crate) fn take_hold(
        &mut self,
        stopping: &Stopping<'_>,
        number: Fence,
        storing: Option<Storing>,
        out: &mut Vec<Effect>,
    ) {
        let Stopping {
            channel, peer, only, ..
        } = *stopping;
        let path = self.tree.get(channel).map(|context| context.path.clone());
        let stop = self.stop_by(peer, number, stopping.reason.clone());
        let (Some(path), Some(stop)) = (path, stop) else {
            return self.fault("a stop by a peer or for a channel that does not exist");
        };
        let latch = self.stops.latch_mut(&path);
        let new = latch.issue(stop, only);
        let told = latch.describe();
        self.keep(channel, storing, out);
        if new {
            let to = self.told_of_stops(channel, &stopping.heard);
            self.push_event(event::STOPPED, &path, to, told, out);
        }
        if self.stops.is_noteworthy(&path, new, self.now) {
            self.audit_stop(peer, path, (number, stopping.reason.as_deref()), out);
        }
        self.end_stopped_grant(channel, peer, out);
        self.bound_stops(out);
    }

    /// A stop of this number that a peer says now; none if it is not there.
    pub(super) fn stop_by(&self, peer: PeerId, number: Fence, reason: Option<Arc<str>>) -> Option<Stop> {
        let facts = &self.peers.get(peer)?.facts;
        Some(Stop {
            number,
            by: Arc::clone(&facts.name),
            user: Arc::clone(&facts.user),
            since: self.wall(),
            reason,
        })
    }

    pub(super) fn audit_stop(
        &self,
        peer: PeerId,
        path: Path,
        (number, reason): (Fence, Option<&str>),
        out: &mut Vec<Effect>,
    ) {
        let fact = Audit {
            context: Some(path),
            stop: Some(number.into()),
            text: reason.map(str::to_owned),
            ..self.fact("stopped", peer)
        };
        self.audit(fact, out);
    }

    /// Takes the token of a stopped channel from its owner, if the token says so.
    fn end_stopped_grant(&mut self, channel: ContextNumber, by: PeerId, out: &mut Vec<Effect>) {
        let context = self.tree.get(channel);
        let guard = context.and_then(|context| context.channel()?.guard.as_ref());
        let token = guard.and_then(|guard| self.tree.token_at(&guard.token));
        let ends = token.filter(|(_, token)| token.stop_ends_grant);
        if let Some(number) = ends.map(|(number, _)| number) {
            self.lose(number, Reason::Stopped, Some(by), out);
        }
    }

    pub(super) fn bound_stops(&mut self, out: &mut Vec<Effect>) {
        let tree = &self.tree;
        let forgotten = self.stops.bound(tree.len(), |path| tree.find(path).is_some());
        for path in forgotten {
            let record = crate::StopRecord {
                path,
                latch: crate::Latch::default(),
            };
            self.keep_record(record, None, out);
        }
    }
}

/// The reason for a stop, as the content of a `stop` gives it: a string, or a map with `reason`.
pub(crate) fn reason_of(parcel: &Parcel) -> Option<Arc<str>> {
    let content = read(parcel)?;
    let reason = match &content {
        Value::String(reason) => Some(&**reason),
        other => other.get("reason").and_then(Value::as_str),
    };
    reason.and_then(shortened)
}

/// A reason that is not too long to be remembered.
pub(crate) fn shortened(reason: &str) -> Option<Arc<str>> {
    let reason: String = reason.chars().take(REASON).collect();
    (!reason.is_empty()).then(|| reason.into())
}
