//! `token grab`: exclusive control, decided by the token's manager (M28, M29), now or when it is one's turn.

use mom_managers::{Answer, Verdict};
use mom_proto::event::Reason;
use mom_proto::{Code, ContextNumber, Micros, Value, Verb, WireError};
use serde::Deserialize;

use super::checks::Request;
use crate::Effect;
use crate::asking::refusal::Refusal;
use crate::asking::wish::Wish;
use crate::content;
use crate::ownership::granted;
use crate::token::state::{Change, QueuedGrab};
use crate::world::World;

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
    /// It waits already, under this ticket.
    InQueue(u64),
}

impl Patience {
    /// What waited has what it waited for.
    fn leave_queue(self, world: &mut World, number: ContextNumber) {
        if let Patience::InQueue(ticket) = self {
            world.take_waiter(number, ticket);
        }
    }
}

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let patience = match request.waiter {
        Some((_, ticket)) => Patience::InQueue(ticket),
        None => patience(&content::read_or_default::<Args>(&request.parcel)?)?,
    };
    let number = world.find_token(request)?;
    world.check_near(request, number)?;
    grab(world, request, number, patience, out)
}

/// As a grab that does not wait, for a request to an owner that there is not.
pub(super) fn at_once(
    world: &mut World,
    request: &Request,
    number: ContextNumber,
    out: &mut Vec<Effect>,
) -> Result<(), Refusal> {
    grab(world, request, number, Patience::Not, out)
}

fn grab(
    world: &mut World,
    request: &Request,
    number: ContextNumber,
    patience: Patience,
    out: &mut Vec<Effect>,
) -> Result<(), Refusal> {
    let peer = request.peer;
    if request.waiter.is_none() {
        world.check_tell_pace(peer, number)?;
    }
    let wish = Wish::new(Verb::Grab, number);
    let verdict = world.consult(peer, &wish, &request.answers);
    let owner = world.owner_of(number);
    let token = world.token(number);
    let lapsed = token.is_some_and(|token| token.lapsed(world.now));
    let kept = token
        .and_then(|token| world.kept_by_restart(token, peer))
        .is_some();
    let shared = token.is_some_and(|token| token.holders.keys().any(|holder| *holder != peer));
    let Verdict { answer, rule, .. } = verdict;
    let grant = match answer {
        Answer::Allow(grant) => grant,
        Answer::Defer(defer) => return Err(world.defer(peer, &wish, defer, rule)),
        Answer::Queue(wait) => {
            let error = world.explain(peer, &wish, &wait.denial);
            return wait_or(world, request, number, patience, error, out);
        }
        Answer::Deny(denial) => {
            let held = denial.code == Code::HELD;
            let error = world.explain(peer, &wish, &denial);
            return match held {
                true => wait_or(world, request, number, patience, error, out),
                false => Err(error.into()),
            };
        }
    };
    let reason = match owner {
        _ if kept || shared => None,
        None => Some(Reason::Released),
        // An owner that grabs renews (M29).
        Some(owner) if owner == peer => {
            if let Some(owner) = world.token_mut(number).and_then(|token| token.owner.as_mut()) {
                owner.until = grant.until;
            }
            patience.leave_queue(world, number);
            world.renew_lease(number);
            let content = granted(world, number);
            request.push_ok(world, Some(content), out);
            return Ok(());
        }
        Some(_) if lapsed => Some(Reason::Expired),
        Some(_) if grant.displace => Some(Reason::Preempted),
        Some(_) => None,
    };
    let Some(reason) = reason else {
        let error = world.held(peer, number);
        return wait_or(world, request, number, patience, error, out);
    };
    patience.leave_queue(world, number);
    // Its own part of a shared hold becomes ownership, before anybody of the queue could have the token.
    world.end_hold(number, peer, "grabbed", out);
    let change = Change {
        until: grant.until,
        rule,
        answers: vec![(peer, request.parcel.id)],
        ..Change::to(peer, reason)
    };
    world.begin_grant(number, change, out);
    Ok(())
}

fn wait_or(
    world: &mut World,
    request: &Request,
    number: ContextNumber,
    patience: Patience,
    error: WireError,
    out: &mut Vec<Effect>,
) -> Result<(), Refusal> {
    let until = match patience {
        Patience::Not => return Err(error.into()),
        Patience::For(time) => Some(world.after(time)),
        Patience::Ever => None,
        Patience::InQueue(ticket) => {
            world.wait_on(number, ticket, &request.answers);
            return Ok(());
        }
    };
    let ticket = world.last_waiter + 1;
    let waiter = QueuedGrab {
        peer: request.peer,
        ticket,
        id: request.parcel.id,
        level: world.level_of(request.peer).unwrap_or_default(),
        since: world.now,
        until,
        answers: request.answers.clone(),
        asking: false,
        told: 0,
    };
    world.wait(number, waiter, out)?;
    world.last_waiter = ticket;
    Ok(())
}

fn patience(args: &Args) -> Result<Patience, WireError> {
    match &args.wait {
        None | Some(Value::Int(0)) => Ok(Patience::Not),
        Some(Value::String(word)) if word == "unlimited" => Ok(Patience::Ever),
        Some(Value::Int(millis)) => {
            let millis = u64::try_from(*millis).unwrap_or_default();
            content::micros(millis, "wait").map(Patience::For)
        }
        Some(_) => Err(content::bad(
            "wait",
            "wait must be a number of ms, or unlimited".to_owned(),
        )),
    }
}
