//! `context stats`: what a channel, or the channels of a session, have counted. Who may ask is decided here; the figures
//! belong to the channels in the broker, which puts them in (design §4).

use std::sync::Arc;

use mom_proto::{Code, ContextKind, ContextNumber, Family, Verb, WireError};

use super::checks::Request;
use crate::Effect;
use crate::asking::refusal::Refusal;
use crate::asking::wish::Wish;
use crate::values::count;
use crate::world::World;

/// Channels of which one reply tells at most.
const MOST: usize = 256;

/// Contexts below a session at which it looks at most: each is a question to its manager.
const LOOKS: usize = 1024;

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.allowed(request)?;
    let Some(context) = world.tree.get(number) else {
        return Err(world
            .faulted("a manager allowed a verb on a context that does not exist")
            .into());
    };
    let (kind, mut content) = (context.kind(), context.summary());
    content.set("members", count(context.members.len()));
    let channels = match kind {
        ContextKind::Channel => vec![number],
        ContextKind::Session => {
            let (channels, more) = channels_below(world, request);
            if more {
                content.set("more", true);
            }
            channels
        }
        ContextKind::Token => {
            let text = format!("{} is a token; only channels have statistics", request.path);
            return Err(WireError::new(Code::WRONG_KIND, text).slot("context").into());
        }
    };
    let mut parcel = world.hub_parcel(Family::Reply, "ok", &request.path);
    parcel.reference = request.parcel.id;
    parcel.content = Some(content.into());
    out.push(Effect::Stats {
        to: request.peer,
        parcel: Arc::new(parcel),
        channels,
        peers: kind == ContextKind::Channel,
    });
    Ok(())
}

/// The channels below a session whose figures the peer may see, and whether there may be more.
fn channels_below(world: &mut World, request: &Request) -> (Vec<ContextNumber>, bool) {
    let below = world.tree.below(&request.path, None);
    let below: Vec<ContextNumber> = below.take(LOOKS + 1).collect();
    let mut more = below.len() > LOOKS;
    let mut channels = Vec::new();
    for channel in below.into_iter().take(LOOKS) {
        let context = world.tree.get(channel);
        if context.is_none_or(|context| context.kind() != ContextKind::Channel) {
            continue;
        }
        if channels.len() == MOST {
            more = true;
            break;
        }
        if world
            .ask(request.peer, &Wish::new(Verb::Stats, channel), &request.answers)
            .is_ok()
        {
            channels.push(channel);
        }
    }
    (channels, more)
}
