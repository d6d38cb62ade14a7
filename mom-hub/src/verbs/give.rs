//! `token give`: the owner offers the token to another peer, for good or for a while (M41).

use mom_managers::Micros;
use mom_proto::{Code, ContextNumber, Map, Verb, WireError};
use serde::Deserialize;

use super::Request;
use crate::asking::questions::Refusal;
use crate::ownership::change::millis;
use crate::token::state::Offer;
use crate::tree::spec as args;
use crate::{Effect, Hub, PeerId};

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

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.allowed_token(request)?;
    let peer = request.peer;
    hub.check_owner(request, number)?;
    let args: Args = args::read(&request.parcel)?;
    let within = args::micros(args.within, "within")?;
    let time: Option<Micros> = args.r#for.map(|time| args::micros(time, "for")).transpose()?;
    if args.commands == Some(0) || args.commands.is_some_and(|commands| commands >= 1 << 53) {
        return Err(args::bad("commands", "commands is a number from 1".to_owned()).into());
    }
    hub.check_not_lent(number, "given on")?;
    let to = hub.neighbour(number, &args.to, "to")?;
    if to == peer {
        return Err(args::bad("to", "this peer has it already".to_owned()).into());
    }
    hub.check_again(number, (Verb::Give, peer, to))?;
    let offer = Offer {
        by: peer,
        to,
        until: hub.after(within),
        time,
        commands: args.commands,
    };
    hub.push_offer(number, offer, out);
    let content = Map::new().with("within", millis(within));
    hub.push_ok(peer, request.parcel.id, &request.path, Some(content), out);
    Ok(())
}

impl Hub {
    /// Checks that the owner has the token for good, and not for a while from somebody else.
    pub(crate) fn check_not_lent(&self, number: ContextNumber, what: &str) -> Result<(), WireError> {
        let owner = self.token(number).and_then(|token| token.owner.as_ref());
        if owner.is_some_and(|owner| owner.delegation.is_some()) {
            let text = format!("what was given for a while cannot be {what}; release it, and it returns");
            return Err(WireError::new(Code::DENIED, text).rule("delegation"));
        }
        Ok(())
    }

    /// The peer of this name among those who could own a token.
    pub(crate) fn neighbour(
        &self,
        number: ContextNumber,
        name: &str,
        slot: &str,
    ) -> Result<PeerId, WireError> {
        let parent = self.tree.get(number).and_then(|context| context.parent);
        let parent = parent.and_then(|parent| self.tree.get(parent));
        let found = self
            .peers
            .id_of(name)
            .filter(|peer| parent.is_some_and(|parent| parent.members.contains_key(peer)));
        found.ok_or_else(|| {
            let place = parent.map(|parent| parent.path.to_string()).unwrap_or_default();
            let members = parent
                .into_iter()
                .flat_map(|parent| parent.members.values().take(1000));
            let names = members.map(|member| &*member.facts.name);
            WireError::new(
                Code::UNKNOWN_PEER,
                format!("there is no member {name:?} in {place}"),
            )
            .slot(&format!("content/{slot}"))
            .nearest_opt(mom_proto::nearest::nearest(name, names))
        })
    }
}
