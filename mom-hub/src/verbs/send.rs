//! Any message (M27), where no verdict stands yet: the channel's manager is asked, and its answer kept.

use std::sync::Arc;

use mom_managers::{Scope, Standing, Verdict};
use mom_proto::{Content, ContextKind, ContextNumber, Parcel, Verb, WireError};

use super::{Request, of_kind};
use crate::admit::admit_with;
use crate::consult::Wish;
use crate::member::has_own_right;
use crate::{Effect, Hub, PeerId, StandingVerdict};

pub(crate) fn on(hub: &mut Hub, request: Request, out: &mut Vec<Effect>) -> Result<(), WireError> {
    let Request {
        peer,
        verb,
        path,
        mut parcel,
    } = request;
    let Some(context) = hub.tree.find(&path) else {
        let lookup = Request {
            peer,
            verb,
            path,
            parcel,
        };
        return hub.allowed(&lookup).map(|_| ());
    };
    of_kind(context, ContextKind::Channel, verb)?;
    let number = context.number;
    let verdict = verdict(hub, peer, verb, number, &parcel);
    hub.keep_standing(peer, number, &parcel, &verdict);
    let Some(route) = hub.route(number) else {
        return Err(hub.unknown_path(&path, Some(ContextKind::Channel)));
    };
    let receivers = admit_with(&route, peer, &verdict.answer, &mut parcel, hub.now, hub.wall())?;
    out.push(Effect::Send {
        from: peer,
        parcel: Box::new(parcel),
        receivers,
        route: Arc::new(route),
        rate: verdict.standing.rate(),
    });
    Ok(())
}

fn verdict(hub: &mut Hub, peer: PeerId, verb: Verb, number: ContextNumber, parcel: &Parcel) -> Verdict {
    let size = parcel.content.as_ref().map_or(0, Content::size);
    let wish = Wish {
        message: Some(&parcel.name),
        size,
        ..Wish::new(verb, number)
    };
    hub.consult(peer, &wish)
}

impl Hub {
    /// Puts a verdict that stands into the route, so that the broker need not ask again.
    fn keep_standing(&mut self, peer: PeerId, number: ContextNumber, parcel: &Parcel, verdict: &Verdict) {
        let Standing::Stands { scope, until, rate } = verdict.standing else {
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
