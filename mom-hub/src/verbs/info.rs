//! `context info` and `token info`: all about one context (M33).

use mom_proto::Map;

use super::Request;
use crate::asking::questions::Refusal;
use crate::ownership::change::expiry_word;
use crate::tree::context::{Presence, Role};
use crate::{Effect, Hub};

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.allowed(request)?;
    let Some(context) = hub.tree.get(number) else {
        return Err(hub.unknown_path(&request.path, None).into());
    };
    let mut info = context.summary().with(
        "members",
        i64::try_from(context.members.len()).unwrap_or(i64::MAX),
    );
    let managing = hub.managing(number).and_then(|number| hub.tree.get(number));
    if let Some(managing) = managing {
        let word = managing.manager_word.as_deref().unwrap_or_default();
        info.set("manager", word);
        info.set("managed-at", managing.path.as_str());
    }
    info.set("presence", presence_word(context.presence));
    info.set("transient", context.transient);
    info.set("permanent", context.permanent);
    match &context.role {
        Role::Session => info.set(
            "children",
            i64::try_from(context.children.len()).unwrap_or(i64::MAX),
        ),
        Role::Channel(channel) => {
            info.set("delivery", channel.delivery.word());
            info.set("overflow", channel.overflow.word());
            if let Some(member) = context.members.get(&request.peer) {
                member.thinning.describe(&mut info);
            }
            if let Some(keep) = channel.keep {
                info.set("keep", keep.to_map());
            }
            if let Some(guard) = &channel.guard {
                info.set("guard", guard.describe(Map::new()));
            }
        }
        Role::Token(token) => {
            info.set("lease", hub.lease_value(token));
            info.set("expiry", expiry_word(token.terms.expiry));
            for (key, value) in hub.token_map(token).into_iter().chain(hub.waiting_map(number)) {
                info.set(&key, value);
            }
        }
    }
    hub.push_ok(request.peer, request.parcel.id, &request.path, Some(info), out);
    Ok(())
}

fn presence_word(presence: Presence) -> &'static str {
    match presence {
        Presence::All => "all",
        Presence::Counts => "counts",
        Presence::None => "none",
    }
}
