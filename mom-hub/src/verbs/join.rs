//! `context join`: entered through its parent (M23). Joining again is answered, and changes only what the member is
//! to be spared and whether it is a device, if the content says so.

use std::sync::Arc;

use mom_proto::{
    Card, Code, ContextNumber, Fence, Map, MessageRate, Overflow, Thinning, Value, Verb, WireError,
};
use serde::Deserialize;

use super::checks::Request;
use super::expel::{check_not_expelled, put_out};
use crate::asking::questions::Questions;
use crate::asking::refusal::Refusal;
use crate::asking::wish::Wish;
use crate::content;
use crate::ownership::{describe_owner, lease_value};
use crate::stops::DeviceWord;
use crate::tree::context::Role;
use crate::tree::installation::Installation;
use crate::world::World;
use crate::{Effect, PeerId};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    #[serde(default)]
    newest: bool,
    #[serde(default)]
    rate: Option<Value>,
    #[serde(default)]
    device: Option<Value>,
}

impl Args {
    /// What the member is to be spared, checked.
    fn thinning(&self) -> Result<Thinning, WireError> {
        let rate = self.rate.as_ref().map(MessageRate::from_value).transpose()?;
        Ok(Thinning {
            newest: self.newest,
            rate,
        })
    }
}

pub(crate) fn on(
    world: &mut World,
    questions: &mut Questions,
    request: &Request,
    out: &mut Vec<Effect>,
) -> Result<(), Refusal> {
    let number = world.allowed(request)?;
    world.check_parent_joined(request.peer, number)?;
    let terms = terms(world, request, number)?;
    let device = terms.as_ref().and_then(|terms| terms.device);
    let mut displaced = Vec::new();
    if device.is_some() {
        // Others rely on what a device says, so it takes a right to be one.
        world.ask(request.peer, &Wish::new(Verb::Device, number), &request.answers)?;
        let installation = terms.as_ref().and_then(|terms| terms.installation.as_ref());
        displaced = world.displaced(number, request.peer, installation)?;
        let card = terms.as_ref().and_then(|terms| terms.card.as_deref());
        world.check_card(number, request.peer, card)?;
    }
    let is_member = world.tree.is_member(request.peer, number);
    if !is_member {
        check_not_expelled(world, request.peer, number)?;
        let joined = world.peers.get(request.peer).map_or(0, |peer| peer.joined.len());
        if !world.settings.limits.joined.allows(joined + 1) {
            let text = format!(
                "a peer can join at most {} contexts",
                world.settings.limits.joined
            );
            return Err(WireError::new(Code::FULL, text).into());
        }
    }
    replace(world, questions, (number, &displaced, request.peer), out);
    if !is_member {
        world.add_member(number, request.peer, out);
    }
    let is_new = !world.is_device(request.peer, number);
    if let Some(terms) = terms {
        world.set_terms(number, request.peer, terms.thinning, device.is_some());
        world.set_device(number, request.peer, (terms.installation, terms.card));
    }
    if let Some(word) = device {
        world.meet_device(number, request.peer, (word, is_new), out);
    }
    let content = describe(world, request.peer, number, device.is_some())?;
    request.push_ok(world, Some(content), out);
    if device.is_some() {
        world.tell_device(number, request.peer, false, out);
        world.await_device(number, request.peer);
    }
    Ok(())
}

/// What the reply says of the context.
fn describe(world: &World, peer: PeerId, number: ContextNumber, is_device: bool) -> Result<Map, Refusal> {
    let Some(context) = world.tree.get(number) else {
        return Err(world
            .faulted("a manager allowed a verb on a context that does not exist")
            .into());
    };
    let mut content = context.summary();
    match &context.role {
        Role::Session => {}
        Role::Token(token) => {
            content.set("lease", lease_value(token));
            for (key, value) in describe_owner(world, token) {
                content.set(&key, value);
            }
        }
        Role::Channel(channel) => {
            content.set("delivery", channel.delivery.word());
            if channel.overflow == Overflow::Wait {
                content.set("overflow", channel.overflow.word());
            }
            if let Some(member) = context.members.get(&peer) {
                member.describe_terms(&mut content);
            }
            if let Some(keep) = channel.keep {
                content.set("keep", keep.to_map());
            }
            let latch = world.stops.latch(&context.path);
            let name = context.members.get(&peer).filter(|_| is_device);
            match name.map(|member| &member.facts.name) {
                Some(name) => content.set("stop", latch.describe_for(name)),
                None if latch.newest > Fence::default() => content.set("stop", latch.describe()),
                None => {}
            }
            if let Some(guard) = &channel.guard {
                // The owner and fence now: a late joiner has to know them to check what comes (M33).
                let token = world.tree.token_at(&guard.token);
                let known = token.map(|(_, token)| describe_owner(world, token));
                let known = known.unwrap_or_default();
                content.set("guard", guard.describe(known));
            }
        }
    }
    Ok(content)
}

/// Puts the devices out whose place this one takes.
fn replace(
    world: &mut World,
    questions: &mut Questions,
    (number, displaced, by): (ContextNumber, &[PeerId], PeerId),
    out: &mut Vec<Effect>,
) {
    if displaced.is_empty() {
        return;
    }
    let text = format!("{} is the device here now", world.name_of(by));
    for peer in displaced {
        put_out(world, questions, (number, *peer, None), Some(&text), out);
    }
}

/// What a peer says with its join.
struct Terms {
    thinning: Thinning,
    device: Option<DeviceWord>,
    installation: Option<Installation>,
    card: Option<Arc<Value>>,
}

/// What the peer asks to be spared, and what it says as a device; none if it says nothing of that.
fn terms(world: &World, request: &Request, number: ContextNumber) -> Result<Option<Terms>, WireError> {
    if request.parcel.content.is_none() {
        return Ok(None);
    }
    let args = content::read::<Args>(&request.parcel)?;
    let thinning = args.thinning()?;
    let is_channel = world
        .tree
        .get(number)
        .is_some_and(|context| context.channel().is_some());
    let device = args.device.as_ref().map(DeviceWord::read).transpose()?.flatten();
    let (mut installation, mut card) = (None, None);
    if let (Some(word), Some(said)) = (&device, &args.device) {
        word.check(world.settings.epoch)?;
        installation = Installation::read(said)?;
        card = said.as_map().and_then(|map| map.get("card"));
        card.map(Card::read).transpose()?;
    }
    if (thinning.thins() || device.is_some()) && !is_channel {
        let text = format!(
            "{} is not a channel: newest, rate and device are for channels only",
            request.path
        );
        return Err(WireError::new(Code::WRONG_KIND, text).slot("content"));
    }
    Ok(Some(Terms {
        thinning,
        device,
        installation,
        card: card.cloned().map(Arc::new),
    }))
}
