//! `token renew`: the owner begins a new lease (M29); commands do not renew.

use std::time::Duration;

use mom_proto::{Code, ContextNumber, WireError};

use super::Request;
use crate::asking::questions::Refusal;
use crate::{Effect, Hub};

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.allowed_token(request)?;
    hub.check_owner(request, number)?;
    hub.renew_lease(number);
    let content = hub.granted(number);
    hub.push_ok(request.peer, request.parcel.id, &request.path, Some(content), out);
    Ok(())
}

impl Hub {
    /// Checks that the asking peer owns the token.
    pub(crate) fn check_owner(&self, request: &Request, number: ContextNumber) -> Result<(), WireError> {
        let owner = self
            .token(number)
            .and_then(|token| token.owner.as_ref())
            .map(|owner| owner.peer);
        if owner == Some(request.peer) {
            return Ok(());
        }
        let text = match owner {
            None => format!("{} has no owner", request.path),
            Some(owner) => format!("{} is held by {}", request.path, self.name_of(owner)),
        };
        let error = WireError::new(Code::NOT_OWNER, text).rule("one owner at most");
        let error = match self.peers.get(request.peer) {
            Some(asked) => error.level(asked.facts.level),
            None => error,
        };
        let level = self.token(number).and_then(|token| self.owner_level(token));
        let error = match owner {
            Some(owner) => error.owner(&self.name_of(owner), level.unwrap_or_default()),
            None => error,
        };
        let end = self
            .token(number)
            .and_then(|token| token.owner.as_ref()?.lease_end);
        Err(match end.filter(|end| *end > self.now) {
            Some(end) => error.retry_after(Duration::from_micros(end - self.now)),
            None => error,
        })
    }
}
