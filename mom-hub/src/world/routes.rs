//! The routes of channels as the tree stands, and which of them an input has changed.

use std::sync::Arc;

use mom_proto::{ContextNumber, Parcel};

use super::World;
use crate::tree::context::GuardSpec;
use crate::{Effect, Guard, GuardOwner, Route};

impl World {
    /// The route of a channel; none if that is not a channel.
    pub(crate) fn route(&self, number: ContextNumber) -> Option<Route> {
        let context = self.tree.get(number)?;
        let channel = context.channel()?;
        Some(Route {
            number,
            path: context.path.clone(),
            members: context.members.values().cloned().collect(),
            guard: channel.guard.as_ref().map(|guard| self.guard(guard)),
            delivery: channel.delivery,
            overflow: channel.overflow,
            pace: context.pace,
            keep: channel.keep,
            awaited: self.stops.is_awaited(number),
            lifted: context.lifted,
        })
    }

    /// Notes that a stop is lifted in a channel now.
    pub(crate) fn note_lifted(&mut self, number: ContextNumber) {
        let now = self.wall();
        if let Some(context) = self.tree.get_mut(number) {
            context.lifted = Some(now);
            self.changed.insert(number);
        }
    }

    fn guard(&self, spec: &GuardSpec) -> Guard {
        // A guard whose token was deleted has no owner: it lets nobody pass.
        let token = self.tree.token_at(&spec.token).map(|(_, token)| token);
        let owner = token.and_then(|token| {
            let owner = token.owner.as_ref()?;
            let facts = &self.peers.get(owner.peer)?.facts;
            Some(GuardOwner {
                peer: owner.peer,
                name: Arc::clone(&facts.name),
                level: self.owner_level(token).unwrap_or(facts.level),
                lease_end: owner.lease_end,
                lost_at: token.deadline(),
                commands: owner.delegation.as_ref().and_then(|given| given.commands),
                halts: owner.halts,
            })
        });
        Guard {
            token: spec.token.clone(),
            names: Arc::clone(&spec.names),
            owner,
            fence: token.map_or(spec.lost_fence, |token| token.fence).into(),
        }
    }

    /// Whether a message needs a token.
    pub(crate) fn is_guarded(&self, parcel: &Parcel) -> bool {
        let channel = match (&parcel.context, parcel.number) {
            (Some(path), _) => self.tree.find(path),
            (None, Some(number)) => self.tree.get(number),
            (None, None) => None,
        };
        let guard = channel.and_then(|context| context.channel()?.guard.as_ref());
        guard.is_some_and(|guard| self.guard(guard).covers(&parcel.name))
    }

    /// The routes of all channels.
    pub(crate) fn routes(&self) -> Vec<Arc<Route>> {
        self.tree
            .iter()
            .filter_map(|context| self.route(context.number))
            .map(Arc::new)
            .collect()
    }

    /// Notes that the routes of all channels which a token guards have changed.
    pub(crate) fn change_guarded_routes(&mut self, number: ContextNumber) {
        match self.tree.token(number) {
            Some(token) => self.changed.extend(&token.guarded),
            None => self.fault("changing routes for a token that does not exist"),
        }
    }

    /// Puts the routes that an input has changed around its other effects: routes that lost something come first, so
    /// that no message of before follows the news; routes that only grew come last, so that a new member has its reply
    /// before the first message.
    pub(crate) fn push_changed_routes(&mut self, start: usize, out: &mut Vec<Effect>) {
        let changed = std::mem::take(&mut self.changed);
        let grown = std::mem::take(&mut self.grown);
        out.extend(
            grown
                .difference(&changed)
                .filter_map(|number| self.route_effect(*number)),
        );
        if !changed.is_empty() {
            let first: Vec<Effect> = changed
                .iter()
                .filter_map(|number| self.route_effect(*number))
                .collect();
            out.splice(start..start, first);
        }
    }

    fn route_effect(&self, number: ContextNumber) -> Option<Effect> {
        match self.route(number) {
            Some(route) => Some(Effect::Route(Arc::new(route))),
            None if self.tree.get(number).is_none() => Some(Effect::RouteGone(number)),
            None => None,
        }
    }
}
