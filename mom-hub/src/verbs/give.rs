//! `token give`: the owner offers the token to another peer, for good or for a while (M41).

use mom_proto::nearest::nearest;
use mom_proto::{Code, ContextNumber, Map, Micros, Verb, WireError};
use serde::Deserialize;

use super::checks::Request;
use crate::asking::refusal::Refusal;
use crate::content;
use crate::token::state::Offer;
use crate::values::millis;
use crate::world::World;
use crate::{Effect, PeerId};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// The peer's name.
    to: String,
    /// How long the offer stands, ms.
    #[serde(default = "default_within")]
    within: u64,
    /// For how long the token is given, ms.
    #[serde(default)]
    r#for: Option<u64>,
    /// For how many guarded messages.
    #[serde(default)]
    commands: Option<u64>,
}

fn default_within() -> u64 {
    10_000
}

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = world.allowed_token(request)?;
    let peer = request.peer;
    world.check_owner(request, number)?;
    let args: Args = content::read(&request.parcel)?;
    let within = content::micros(args.within, "within")?;
    let time: Option<Micros> = args.r#for.map(|time| content::micros(time, "for")).transpose()?;
    if args.commands == Some(0) || args.commands.is_some_and(|commands| commands >= 1 << 53) {
        return Err(content::bad("commands", "commands must be a number, at least 1".to_owned()).into());
    }
    world.check_not_lent(number, "given on")?;
    let to = neighbour(world, number, &args.to)?;
    if to == peer {
        return Err(content::bad("to", "this peer already owns it".to_owned()).into());
    }
    world.check_again(number, (Verb::Give, peer, to))?;
    // The receiver hears of each, also of those that have lapsed.
    world.count_wish(peer, to)?;
    let offer = Offer {
        by: peer,
        to,
        until: world.after(within),
        time,
        commands: args.commands,
    };
    world.push_offer(number, offer, out);
    let content = Map::new().with("within", millis(within));
    request.push_ok(world, Some(content), out);
    Ok(())
}

/// The peer of this name among those who could own the token: the members of its parent.
fn neighbour(world: &World, token: ContextNumber, name: &str) -> Result<PeerId, WireError> {
    let parent = world.tree.get(token).and_then(|context| context.parent);
    let Some(parent) = parent.and_then(|parent| world.tree.get(parent)) else {
        return Err(world.faulted("a token has no parent"));
    };
    let found = world.peers.id_of(name);
    found
        .filter(|peer| parent.members.contains_key(peer))
        .ok_or_else(|| {
            let names = parent.members.values().take(1000);
            let names = names.map(|member| &*member.facts.name);
            let text = format!("there is no member {name:?} in {}", parent.path);
            WireError::new(Code::UNKNOWN_PEER, text)
                .slot("content/to")
                .nearest_opt(nearest(name, names))
        })
}
