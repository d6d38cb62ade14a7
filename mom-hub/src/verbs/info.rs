//! `context info` and `token info`: all about one context (M33).

use mom_managers::Expiry;
use mom_proto::Map;
use serde::Deserialize;

use super::checks::Request;
use crate::asking::refusal::Refusal;
use crate::content;
use crate::ownership::{describe_owner, describe_waiting, lease_value};
use crate::tree::context::{Context, Presence, Role};
use crate::values::count;
use crate::world::World;
use crate::{Effect, Member};

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// Of a channel: the card of its device.
    #[serde(default)]
    card: bool,
    /// Of which device, where there are several.
    #[serde(default)]
    device: Option<String>,
}

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.allowed(request)?;
    let args: Args = content::read_or_default(&request.parcel)?;
    let Some(context) = world.tree.get(number) else {
        return Err(world
            .faulted("a manager allowed a verb on a context that does not exist")
            .into());
    };
    let mut info = context.summary().with("members", count(context.members.len()));
    let managing = world.tree.managing(number);
    if let Some(managing) = managing {
        let word = managing.manager_word.as_deref().unwrap_or_default();
        info.set("manager", word);
        info.set("managed-at", managing.path.as_str());
        for (key, value) in world.facts(number) {
            info.set(&key, value);
        }
    }
    info.set("presence", presence_word(context.presence));
    info.set("transient", context.transient);
    info.set("permanent", context.permanent);
    match &context.role {
        Role::Session => info.set("children", count(context.children.len())),
        Role::Channel(channel) => {
            info.set("delivery", channel.delivery.word());
            info.set("overflow", channel.overflow.word());
            if let Some(pace) = context.pace {
                info.set("pace", pace);
            }
            info.set(
                "devices",
                if context.has_one_device() {
                    "one"
                } else {
                    "several"
                },
            );
            if let Some(member) = context.members.get(&request.peer) {
                member.describe_terms(&mut info);
            }
            if let Some(keep) = channel.keep {
                info.set("keep", keep.to_map());
            }
            if let Some(guard) = &channel.guard {
                info.set("guard", guard.describe(Map::new()));
            }
            info.set("stop", world.stops.latch(&context.path).describe());
            if args.card {
                describe_card(context, args.device.as_deref(), &mut info);
            }
        }
        Role::Token(token) => {
            info.set("lease", lease_value(token));
            info.set("expiry", expiry_word(token.terms.expiry));
            if let Some(stops) = world.stops_guarded_by(token) {
                info.set("stopped", stops);
            }
            for (key, value) in describe_owner(world, token)
                .into_iter()
                .chain(describe_waiting(world, token))
            {
                info.set(&key, value);
            }
        }
    }
    request.push_ok(world, Some(info), out);
    Ok(())
}

/// The card of a channel's device, the first of those that have one, and whose it is.
fn describe_card(context: &Context, device: Option<&str>, info: &mut Map) {
    let is_meant = |member: &Member| device.is_none_or(|device| *member.facts.name == *device);
    let devices = context
        .members
        .values()
        .filter(|member| member.device && is_meant(member));
    let card = devices
        .filter_map(|member| Some((member, member.card.as_deref()?)))
        .next();
    if let Some((member, card)) = card {
        info.set("device", &*member.facts.name);
        info.set("card", card.clone());
    }
}

fn presence_word(presence: Presence) -> &'static str {
    match presence {
        Presence::All => "all",
        Presence::Counts => "counts",
        Presence::None => "none",
    }
}

fn expiry_word(expiry: Expiry) -> &'static str {
    match expiry {
        Expiry::Lazy => "lazy",
        Expiry::Eager => "eager",
    }
}
