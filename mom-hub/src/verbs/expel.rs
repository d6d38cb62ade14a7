//! `context expel`: putting a peer out.

use std::sync::Arc;
use std::time::Duration;

use mom_managers::Micros;
use mom_proto::event::{self, Reason};
use mom_proto::{Code, ContextNumber, WireError};
use serde::Deserialize;

use super::Request;
use crate::asking::questions::Refusal;
use crate::tree::spec as args;
use crate::{Audit, Effect, Hub, PeerId};

/// Users that are kept out of one context.
const MOST: usize = 1000;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// The peer's name.
    peer: String,
    /// Plain words for it.
    #[serde(default)]
    text: Option<String>,
    /// For how long its user may not come back, ms.
    #[serde(default = "default_for")]
    r#for: u64,
}

fn default_for() -> u64 {
    60_000
}

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.allowed(request)?;
    let args: Args = args::read(&request.parcel)?;
    let time = match args.r#for {
        0 => 0,
        millis => args::micros(millis, "for")?,
    };
    let peer = hub
        .peers
        .id_of(&args.peer)
        .filter(|peer| hub.is_member(*peer, number));
    let peer = peer.ok_or_else(|| {
        let text = format!("there is no member {:?} in {}", args.peer, request.path);
        WireError::new(Code::UNKNOWN_PEER, text).slot("content/peer")
    })?;
    hub.keep_out(number, peer, time)?;
    hub.expel(number, peer, Some(request.peer), args.text.as_deref(), out);
    if hub.peers.get(request.peer).is_some() {
        hub.push_ok(request.peer, request.parcel.id, &request.path, None, out);
    }
    Ok(())
}

impl Hub {
    fn keep_out(&mut self, number: ContextNumber, peer: PeerId, time: Micros) -> Result<(), WireError> {
        let (now, until) = (self.now, self.after(time));
        let user = self.peers.get(peer).map(|peer| Arc::clone(&peer.facts.user));
        let (Some(user), Some(context)) = (user, self.tree.get_mut(number)) else {
            return Ok(());
        };
        context.expelled.retain(|_, until| now < *until);
        if time > 0 {
            if context.expelled.len() >= MOST {
                return Err(WireError::new(
                    Code::FULL,
                    format!("{MOST} users are kept out, as many as may be"),
                ));
            }
            context.expelled.insert(user, until);
        }
        Ok(())
    }

    /// Puts a peer out of a context and all below it; out of the root is out of the hub.
    pub(crate) fn expel(
        &mut self,
        number: ContextNumber,
        peer: PeerId,
        by: Option<PeerId>,
        text: Option<&str>,
        out: &mut Vec<Effect>,
    ) {
        let Some(context) = self.tree.get(number) else {
            return;
        };
        let (path, root) = (context.path.clone(), context.parent.is_none());
        let mut content = match self.peers.get(peer) {
            Some(known) => crate::world::events::peer_map(&known.facts),
            None => return,
        };
        if let Some(by) = by {
            content.set("by", self.name_of(by));
        }
        if let Some(text) = text {
            content.set("text", text);
        }
        let fact = Audit {
            context: Some(path.clone()),
            text: text.map(str::to_owned),
            by: by.map(|by| self.name_of(by).into()),
            ..self.fact("expelled", peer)
        };
        let told = self.members_of(number);
        self.audit(fact, out);
        self.leave(number, peer, Reason::Revoked, out);
        self.push_event(event::EXPELLED, &path, told, content, out);
        if root {
            let why = text.unwrap_or("this peer was put out of the hub");
            self.handle_gone(peer, out);
            out.push(Effect::Close {
                peer,
                error: Some(WireError::new(Code::REVOKED, why)),
            });
        }
    }

    /// Checks that a peer was not put out of a context a short while ago.
    pub(crate) fn check_not_expelled(&self, peer: PeerId, number: ContextNumber) -> Result<(), WireError> {
        let user = self.peers.get(peer).map(|peer| Arc::clone(&peer.facts.user));
        let context = self.tree.get(number);
        let until = context
            .zip(user)
            .and_then(|(context, user)| context.expelled.get(&user));
        match until.filter(|until| self.now < **until) {
            None => Ok(()),
            Some(until) => {
                let text = "this user was put out of it, and may come back later";
                let wait = Duration::from_micros(until - self.now);
                Err(WireError::new(Code::DENIED, text)
                    .rule("expelled")
                    .retry_after(wait))
            }
        }
    }

    /// Whether a user may not log in for now.
    pub(crate) fn kept_out(&self, user: &str) -> Option<WireError> {
        let root = self.tree.find(&mom_proto::Path::root())?;
        let until = root.expelled.get(user).filter(|until| self.now < **until)?;
        let text = "this user was put out of the hub, and may come back later";
        let wait = Duration::from_micros(until - self.now);
        Some(WireError::new(Code::REVOKED, text).retry_after(wait))
    }
}
