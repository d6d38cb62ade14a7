//! Any message (M27), where no verdict stands yet: the channel's manager is asked, and its answer kept.

use std::sync::Arc;

use mom_managers::{Answer, Grant, Scope, Standing, Verdict};
use mom_proto::{ContextKind, ContextNumber, Micros, Parcel, STOP, Verb, WireError};

use super::checks::{Request, of_kind};
use crate::asking::questions::{Questions, take_parcel};
use crate::asking::refusal::Refusal;
use crate::asking::wish::Wish;
use crate::messages::admit::admit_with;
use crate::messages::age::{Aged, age_of, is_within};
use crate::stops::{Stopping, reason_of, unstop};
use crate::tree::member::has_own_right;
use crate::world::World;
use crate::{Effect, Ingress, PeerClock, PeerId, Receivers, Route, StandingVerdict};

pub(crate) fn on(
    world: &mut World,
    questions: &mut Questions,
    request: &mut Request,
    out: &mut Vec<Effect>,
) -> Result<(), Refusal> {
    let Some(context) = world.tree.find(&request.path) else {
        return world.allowed(request).map(|_| ());
    };
    of_kind(context, ContextKind::Channel, request.verb)?;
    let (number, peer) = (context.number, request.peer);
    if request.answers.is_empty() && request.verb == Verb::Send {
        // Messages of one sender stay in their order, also where one has to be asked about.
        if questions.waits_behind(peer, number) {
            world.check_admissible(peer, number, &request.parcel)?;
            return Ok(questions.wait_behind(world, (peer, number), &mut request.parcel)?);
        }
    }
    let wish = Wish {
        message: Some(&request.parcel.name),
        size: request.parcel.size(),
        age: age_of(&request.parcel, world.wall(), world.clock_of(peer).as_ref()),
        ..Wish::new(request.verb, number)
    };
    let (answer, rate) = match standing(world, request, number, wish.age) {
        _ if request.verb == Verb::Stop && world.is_own_stop(peer, number, &request.parcel) => {
            (Answer::Allow(Grant::default()), None)
        }
        Some(standing) => (standing.answer, standing.rate),
        None => {
            let verdict = world.consult(peer, &wish, &request.answers);
            if let Answer::Defer(defer) = verdict.answer {
                // Nobody is asked about a message that would be refused in any case.
                world.check_admissible(peer, number, &request.parcel)?;
                return Err(world.defer(peer, &wish, defer, verdict.rule));
            }
            world.keep_standing(peer, number, &request.parcel, &verdict);
            (verdict.answer, verdict.standing.rate())
        }
    };
    let Some(route) = world.route(number) else {
        return Err(world
            .faulted("admitting a message to a channel that does not exist")
            .into());
    };
    let ingress = world.ingress(peer);
    let receivers = admit_with(&route, peer, &answer, &mut request.parcel, &ingress)?;
    match request.verb {
        Verb::Stop => {
            let parcel = take_parcel(&mut request.parcel);
            push_stop(world, peer, parcel, (route, receivers), out);
            return Ok(());
        }
        Verb::Unstop => {
            let parcel = take_parcel(&mut request.parcel);
            return match unstop(world, peer, number, parcel.clone(), out) {
                Ok(()) => Ok(()),
                Err(error) => {
                    request.parcel = parcel;
                    Err(error.into())
                }
            };
        }
        _ => world.note_word(number, peer, &request.parcel, out),
    }
    let parcel = take_parcel(&mut request.parcel);
    let route = match world.count_command(peer, &route, &parcel) {
        true => world.route(number).unwrap_or(route),
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

/// Hands out a stop under the next number of its channel, and remembers it.
fn push_stop(
    world: &mut World,
    peer: PeerId,
    mut parcel: Parcel,
    (route, receivers): (Route, Receivers),
    out: &mut Vec<Effect>,
) {
    let (channel, number) = (route.number, world.next_stop(route.number));
    parcel.extra.set(STOP, number);
    let only = parcel.address.clone();
    let (reason, heard) = (reason_of(&parcel), receivers.peers(&route));
    out.push(Effect::Send {
        from: peer,
        parcel: Box::new(parcel),
        receivers,
        route: Arc::new(route),
        rate: None,
    });
    let stopping = Stopping {
        channel,
        peer,
        only: only.as_deref(),
        reason,
        heard,
    };
    world.take_hold(&stopping, number, None, out);
}

/// The verdict that stands for a message. A request with answers of its own is decided by them alone; sends that have
/// waited behind it are decided by what stands, so that nobody is asked about each of them.
fn standing(
    world: &World,
    request: &Request,
    number: ContextNumber,
    age: Option<Aged>,
) -> Option<StandingVerdict> {
    let member = world.tree.get(number)?.members.get(&request.peer)?;
    let standing = member.standing(&request.parcel.name, world.now);
    let young = |most: Micros| is_within(age, most);
    standing
        .filter(|standing| request.answers.is_empty() && standing.max_age.is_none_or(young))
        .cloned()
}

/// How long a token that was given for a number of commands stays after the last one, µs: a change of owner at once
/// would overtake that command and take it back.
const AFTER_LAST: Micros = 1_000_000;

impl World {
    fn clock_of(&self, peer: PeerId) -> Option<PeerClock> {
        let (clock, at) = self.peers.get(peer)?.clock?;
        Some(PeerClock {
            offset: clock.offset.later(self.now.saturating_sub(at)),
            ..clock
        })
    }

    /// The ingress of a message that is carried out now.
    fn ingress(&self, peer: PeerId) -> Ingress {
        Ingress {
            now: self.now,
            wall: self.wall(),
            clock: self.clock_of(peer),
            waited: 0,
        }
    }

    /// Checks what has to hold for a message besides its manager's verdict.
    fn check_admissible(
        &self,
        peer: PeerId,
        number: ContextNumber,
        parcel: &Parcel,
    ) -> Result<(), WireError> {
        let Some(route) = self.route(number) else {
            return Err(self.faulted("checking a message to a channel that does not exist"));
        };
        // Everything that decides; the content does not.
        let mut trial = Parcel {
            address: parcel.address.clone(),
            fence: parcel.fence,
            timestamp: parcel.timestamp,
            expires: parcel.expires,
            ..Parcel::new(parcel.family, Arc::clone(&parcel.name))
        };
        let answer = Answer::Allow(Grant::default());
        admit_with(&route, peer, &answer, &mut trial, &self.ingress(peer)).map(|_| ())
    }

    /// Counts a command of an owner that has only so many; whether the message was one.
    fn count_command(&mut self, peer: PeerId, route: &Route, parcel: &Parcel) -> bool {
        let guard = route.guard.as_ref().filter(|guard| guard.covers(&parcel.name));
        let counted = guard.and_then(|guard| guard.owner.as_ref());
        let counted = counted.is_some_and(|owner| owner.peer == peer && owner.commands.is_some());
        let token = guard.filter(|_| counted && !has_own_right(&parcel.name));
        let token = token.and_then(|guard| self.tree.token_at(&guard.token));
        let Some(number) = token.map(|(number, _)| number) else {
            return false;
        };
        let return_at = self.after(AFTER_LAST);
        if let Some(token) = self.token_mut(number) {
            token.count_command(return_at);
        }
        self.retime(number);
        self.change_guarded_routes(number);
        true
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
        // Stop has rights of its own, so its verdict stands for no other message.
        let name = match scope {
            Scope::AnyName if !has_own_right(&parcel.name) => None,
            _ => Some(Arc::clone(&parcel.name)),
        };
        let standing = StandingVerdict {
            by_hub: has_own_right(&parcel.name),
            name,
            until,
            rate,
            max_age,
            answer: verdict.answer.clone(),
        };
        let context = self.tree.get_mut(number);
        let member = context.and_then(|context| context.members.get_mut(&peer));
        // The manager may allow a message whose sender is not a member, which is refused next; a sender of very many names
        // is asked about each time.
        if let Some(member) = member
            && let Some(kept) = member.with(standing)
        {
            *member = Arc::new(kept);
            self.grown.insert(number);
        }
    }
}
