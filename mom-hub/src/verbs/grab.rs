//! `token grab`: exclusive control, decided by the token's manager (M28, M29), now or when it is one's turn.

use mom_managers::{Answer, Micros, Verdict};
use mom_proto::event::Reason;
use mom_proto::{Code, ContextNumber, Value, WireError};
use serde::Deserialize;

use super::Request;
use crate::asking::consult::Wish;
use crate::asking::questions::Refusal;
use crate::ownership::grant::Change;
use crate::ownership::queue::Wait;
use crate::tree::spec as args;
use crate::{Effect, Hub};

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Args {
    /// ms, or `unlimited`; absent or 0 = not at all.
    wait: Option<Value>,
}

/// How long a grab wants to wait.
#[derive(Clone, Copy)]
enum Patience {
    Not,
    For(Micros),
    Ever,
}

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let patience = patience(&args::read_or_default::<Args>(&request.parcel)?)?;
    let number = hub.find_token(request)?;
    hub.check_near(request, number)?;
    grab(hub, request, number, patience, out)
}

/// As a grab that does not wait, for a request to an owner that there is not.
pub(super) fn at_once(
    hub: &mut Hub,
    request: &Request,
    number: ContextNumber,
    out: &mut Vec<Effect>,
) -> Result<(), Refusal> {
    grab(hub, request, number, Patience::Not, out)
}

fn grab(
    hub: &mut Hub,
    request: &Request,
    number: ContextNumber,
    patience: Patience,
    out: &mut Vec<Effect>,
) -> Result<(), Refusal> {
    let peer = request.peer;
    let wish = Wish::new(mom_proto::Verb::Grab, number);
    let verdict = hub.consult(peer, &wish);
    let owner = hub.owner_of(number);
    let token = hub.token(number);
    let lapsed = token.is_some_and(|token| token.lapsed(hub.now));
    let kept = token.and_then(|token| hub.kept_by_restart(token, peer)).is_some();
    let shared = token.is_some_and(|token| token.holders.keys().any(|holder| *holder != peer));
    let Verdict { answer, rule, .. } = verdict;
    let grant = match answer {
        Answer::Allow(grant) => grant,
        Answer::Defer(defer) => return Err(hub.defer(peer, &wish, defer, rule)),
        Answer::Queue(wait) => {
            let error = hub.explain(peer, &wish, &wait.denial);
            return wait_or(hub, request, number, patience, error, out);
        }
        Answer::Deny(denial) => {
            let held = denial.code == Code::HELD;
            let error = hub.explain(peer, &wish, &denial);
            return match held {
                true => wait_or(hub, request, number, patience, error, out),
                false => Err(error.into()),
            };
        }
    };
    let reason = match owner {
        _ if kept || shared => None,
        None => Some(Reason::Released),
        // Asking again for what one has is a renewal (M29).
        Some(owner) if owner == peer => {
            if let Some(owner) = hub.token_mut(number).and_then(|token| token.owner.as_mut()) {
                owner.until = grant.until;
            }
            hub.renew_lease(number);
            let content = hub.granted(number);
            hub.push_ok(peer, request.parcel.id, &request.path, Some(content), out);
            return Ok(());
        }
        Some(_) if lapsed => Some(Reason::Expired),
        Some(_) if grant.displace => Some(Reason::Preempted),
        Some(_) => None,
    };
    let Some(reason) = reason else {
        let error = hub.held(peer, number);
        return wait_or(hub, request, number, patience, error, out);
    };
    // Its own part of a shared hold becomes ownership, before anybody of the queue could have the token.
    hub.end_hold(number, peer, "grabbed", out);
    let change = Change {
        until: grant.until,
        rule,
        answers: vec![(peer, request.parcel.id)],
        ..Change::to(peer, reason)
    };
    hub.hand(number, change, out);
    Ok(())
}

fn wait_or(
    hub: &mut Hub,
    request: &Request,
    number: ContextNumber,
    patience: Patience,
    error: WireError,
    out: &mut Vec<Effect>,
) -> Result<(), Refusal> {
    let time = match patience {
        Patience::Not => return Err(error.into()),
        Patience::For(time) => Some(time),
        Patience::Ever => None,
    };
    let wait = Wait {
        peer: request.peer,
        id: request.parcel.id,
        time,
        answers: hub.answers.clone(),
    };
    hub.wait(number, wait, out)?;
    Ok(())
}

fn patience(args: &Args) -> Result<Patience, WireError> {
    match &args.wait {
        None | Some(Value::Int(0)) => Ok(Patience::Not),
        Some(Value::String(word)) if word == "unlimited" => Ok(Patience::Ever),
        Some(Value::Int(millis)) if *millis > 0 => {
            let millis = u64::try_from(*millis).unwrap_or_default();
            args::micros(millis, "wait").map(Patience::For)
        }
        Some(_) => Err(args::bad(
            "wait",
            "wait is a number of ms, or unlimited".to_owned(),
        )),
    }
}
