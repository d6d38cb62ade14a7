//! Any message (M27), where no verdict stands yet: the channel's manager is asked, and its answer kept.

use std::sync::Arc;

use mom_managers::{Answer, Grant, Micros, Scope, Standing, Verdict};
use mom_proto::{Content, ContextKind, ContextNumber, Parcel, Verb, WireError};

use super::{Request, of_kind};
use crate::asking::consult::Wish;
use crate::asking::questions::{Refusal, take_parcel};
use crate::messages::admit::admit_with;
use crate::messages::age::{Aged, age_of, is_within};
use crate::tree::member::has_own_right;
use crate::{Effect, Hub, Ingress, PeerClock, PeerId, Route, StandingVerdict};

pub(crate) fn on(hub: &mut Hub, request: &mut Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let Some(context) = hub.tree.find(&request.path) else {
        return hub.allowed(request).map(|_| ());
    };
    of_kind(context, ContextKind::Channel, request.verb)?;
    let (number, peer) = (context.number, request.peer);
    if hub.answers.is_empty() && request.verb == Verb::Send {
        // Messages of one sender stay in their order, also where one has to be asked about.
        if hub.waits_behind(peer, number) {
            hub.check_admissible(peer, number, &request.parcel)?;
            return Ok(hub.wait_behind(peer, number, &mut request.parcel)?);
        }
    }
    let wish = Wish {
        message: Some(&request.parcel.name),
        size: request.parcel.content.as_ref().map_or(0, Content::size),
        age: age_of(&request.parcel, hub.wall(), hub.clock_of(peer).as_ref()),
        ..Wish::new(request.verb, number)
    };
    let (answer, rate) = match hub.standing(peer, number, &request.parcel.name, wish.age) {
        Some(standing) => (standing.answer, standing.rate),
        None => {
            let verdict = hub.consult(peer, &wish);
            if let Answer::Defer(defer) = verdict.answer {
                // Nobody is asked about what would be refused in any case.
                hub.check_admissible(peer, number, &request.parcel)?;
                return Err(hub.defer(peer, &wish, defer, verdict.rule));
            }
            hub.keep_standing(peer, number, &request.parcel, &verdict);
            (verdict.answer, verdict.standing.rate())
        }
    };
    let Some(route) = hub.route(number) else {
        return Err(hub.unknown_path(&request.path, Some(ContextKind::Channel)).into());
    };
    let ingress = hub.ingress(peer);
    let receivers = admit_with(&route, peer, &answer, &mut request.parcel, &ingress)?;
    let parcel = take_parcel(&mut request.parcel);
    let route = match hub.count_command(peer, &route, &parcel) {
        true => hub.route(number).unwrap_or(route),
        false => route,
    };
    out.push(Effect::Send {
        from: peer,
        parcel: Box::new(parcel),
        receivers,
        route: Arc::new(route),
        rate,
    });
    Ok(())
}

/// How long a token that was given for a number of commands stays after the last one, µs: a change of owner at once
/// would overtake that command and take it back.
const AFTER_LAST: Micros = 1_000_000;

impl Hub {
    fn clock_of(&self, peer: PeerId) -> Option<PeerClock> {
        let (clock, at) = self.peers.get(peer)?.clock?;
        Some(PeerClock {
            offset: clock.offset.later(self.now.saturating_sub(at)),
            ..clock
        })
    }

    /// For what a peer sends, or sent before and is carried out now.
    fn ingress(&self, peer: PeerId) -> Ingress {
        Ingress {
            now: self.now,
            wall: self.wall(),
            clock: self.clock_of(peer),
            waited: 0,
        }
    }

    /// Checks what has to hold for a message besides its manager's word.
    fn check_admissible(
        &self,
        peer: PeerId,
        number: ContextNumber,
        parcel: &Parcel,
    ) -> Result<(), WireError> {
        let Some(route) = self.route(number) else {
            return Ok(());
        };
        // All that decides, which the content does not.
        let mut trial = Parcel {
            address: parcel.address.clone(),
            fence: parcel.fence,
            echo: parcel.echo,
            timestamp: parcel.timestamp,
            expires: parcel.expires,
            ..Parcel::new(parcel.family, Arc::clone(&parcel.name))
        };
        let answer = Answer::Allow(Grant::default());
        admit_with(&route, peer, &answer, &mut trial, &self.ingress(peer)).map(|_| ())
    }

    /// Counts a command of an owner that has only so many; whether it was one.
    fn count_command(&mut self, peer: PeerId, route: &Route, parcel: &Parcel) -> bool {
        let guard = route.guard.as_ref().filter(|guard| guard.covers(&parcel.name));
        let counted = guard.and_then(|guard| guard.owner.as_ref());
        let counted = counted.is_some_and(|owner| owner.peer == peer && owner.commands.is_some());
        let token = guard.filter(|_| counted && !has_own_right(&parcel.name));
        let Some(number) = token
            .and_then(|guard| self.tree.find(&guard.token))
            .map(|context| context.number)
        else {
            return false;
        };
        let return_at = self.after(AFTER_LAST);
        let owner = self.token_mut(number).and_then(|token| token.owner.as_mut());
        if let Some(delegation) = owner.and_then(|owner| owner.delegation.as_mut()) {
            let left = delegation.commands.map(|left| left.saturating_sub(1));
            delegation.commands = left;
            if left == Some(0) {
                delegation.return_at = Some(return_at);
            }
        }
        self.retime(number);
        self.change_guarded_routes(number);
        true
    }

    /// What stands for a message: who was asked about an earlier one, and said that this holds, is not asked again
    /// about those that have waited behind it.
    fn standing(
        &self,
        peer: PeerId,
        number: ContextNumber,
        name: &str,
        age: Option<Aged>,
    ) -> Option<StandingVerdict> {
        let member = self.tree.get(number)?.members.get(&peer)?;
        let standing = member.standing(name, self.now);
        let young = |most: Micros| is_within(age, most);
        standing
            .filter(|standing| self.answers.is_empty() && standing.max_age.is_none_or(young))
            .cloned()
    }

    /// Puts a verdict that stands into the route, so that the broker need not ask again.
    fn keep_standing(&mut self, peer: PeerId, number: ContextNumber, parcel: &Parcel, verdict: &Verdict) {
        let Standing::Stands {
            scope,
            until,
            rate,
            max_age,
        } = verdict.standing
        else {
            return;
        };
        // Stop has rights of its own, so what stands for it stands for no other message.
        let name = match scope {
            Scope::AnyName if !has_own_right(&parcel.name) => None,
            _ => Some(Arc::clone(&parcel.name)),
        };
        let standing = StandingVerdict {
            name,
            until,
            rate,
            max_age,
            answer: verdict.answer.clone(),
        };
        let Some(context) = self.tree.get_mut(number) else {
            return;
        };
        let Some(member) = context
            .members
            .get(&peer)
            .and_then(|member| member.with(standing))
        else {
            return;
        };
        context.members.insert(peer, Arc::new(member));
        self.grown.insert(number);
    }
}
