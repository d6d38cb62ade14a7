//! One verb per file: what it needs, what it changes, what it answers.
//!
//! A verb that fails has changed nothing and had no effect. What several verbs look at is in `checks`.

mod accept;
mod audit;
mod breaking;
mod checks;
mod create;
mod decline;
mod delete;
mod expel;
mod explain;
mod give;
mod grab;
mod held_back;
mod info;
mod inhibit;
mod invite;
mod join;
mod leave;
mod list;
mod logout;
mod lookup;
mod lost;
mod members;
mod release;
mod renew;
mod request;
mod send;
mod stats;
mod stop;
mod uninhibit;
mod verdict;
mod what_if;

use mom_proto::{Code, Family, Parcel, Path, Verb, WireError};

use crate::asking::questions::{Due, Questions};
use crate::asking::refusal::Refusal;
use crate::world::World;
use crate::{Effect, PeerId};
use checks::{Request, no_context};

pub(crate) use checks::of_kind;
pub(crate) use expel::{kept_out, put_out};
pub(crate) use held_back::run_held_back;
pub(crate) use logout::{depart, follow};
pub(crate) use lost::{end_grace, lose, resume};

/// Carries out a request, and answers it if it is refused.
pub(crate) fn run(world: &mut World, questions: &mut Questions, request: Due, out: &mut Vec<Effect>) {
    let mut next = Some(request);
    while let Some(request) = next.take() {
        next = run_once(world, questions, request, out);
    }
}

/// Carries out requests one after the other.
pub(crate) fn run_all(
    world: &mut World,
    questions: &mut Questions,
    requests: Vec<Due>,
    out: &mut Vec<Effect>,
) {
    for request in requests {
        run(world, questions, request, out);
    }
}

/// Looks at the queues that something has stirred, and asks about the waiting grabs whose turn it is.
pub(crate) fn run_waiting(world: &mut World, questions: &mut Questions, out: &mut Vec<Effect>) {
    loop {
        if let Some(number) = world.stirred.pop_first() {
            world.advance_queue(number, out);
            continue;
        }
        let Some((number, ticket)) = world.to_ask.pop() else {
            return;
        };
        if let Some(due) = world.due_grab(number, ticket) {
            run(world, questions, due, out);
        }
    }
}

/// Returns the request if it is to be carried out once more, with an answer that it has got at once.
fn run_once(
    world: &mut World,
    questions: &mut Questions,
    request: Due,
    out: &mut Vec<Effect>,
) -> Option<Due> {
    let start = out.len();
    if let Some((number, ticket)) = request.waiter
        && !world.waits(number, ticket)
    {
        // It was answered when it left the queue.
        return None;
    }
    let (verb, path) = match read(world, request.peer, &request.parcel) {
        Ok(read) => read,
        Err(error) => {
            request.refuse(world, (&error, None), out);
            return None;
        }
    };
    let Due {
        peer,
        parcel,
        answers,
        waiter,
    } = request;
    let mut request = Request {
        peer,
        verb,
        path,
        parcel,
        answers,
        waiter,
    };
    match carry_out(world, questions, &mut request, out) {
        Ok(()) => None,
        Err(Refusal::Error(error)) => {
            debug_assert_eq!(out.len(), start, "a refused request has no effects: {error}");
            let told = world.veil(&request);
            request.into_due().refuse(world, (&error, told.as_ref()), out);
            None
        }
        Err(Refusal::Defer(deferred)) => {
            debug_assert_eq!(out.len(), start, "a deferred request has no effects");
            questions.postpone(world, request.into_due(), &deferred, out)
        }
    }
}

fn read(world: &World, peer: PeerId, parcel: &Parcel) -> Result<(Verb, Path), WireError> {
    if world.peers.get(peer).is_none() {
        let text = "log in first: family login, name login";
        return Err(WireError::new(Code::NOT_LOGGED_IN, text));
    }
    let verb = Verb::of(parcel.family, &parcel.name)?;
    let path = world.path_of(parcel, verb)?;
    if world.is_doomed(&path) {
        // It is being deleted.
        return Err(no_context(&path));
    }
    if world.is_leaving(peer, &path) {
        let text = "this peer is already leaving that context; wait for the answer";
        return Err(WireError::new(Code::TRY_LATER, text).slot("context"));
    }
    Ok((verb, path))
}

/// Carries out a request once. A refusal has changed nothing and has had no effect.
fn carry_out(
    world: &mut World,
    questions: &mut Questions,
    request: &mut Request,
    out: &mut Vec<Effect>,
) -> Result<(), Refusal> {
    if held_back::hold_back(world, request)? {
        return Ok(());
    }
    match request.verb {
        Verb::Create => create::on(world, request, out),
        Verb::Lookup => lookup::on(world, request, out),
        Verb::List => list::on(world, request, out),
        Verb::Info => info::on(world, request, out),
        Verb::Join => join::on(world, questions, request, out),
        Verb::Leave => leave::on(world, questions, request, out),
        Verb::Delete => delete::on(world, request, out),
        Verb::Members => members::on(world, request, out),
        Verb::Stats => stats::on(world, request, out),
        Verb::Audit => audit::on(world, request, out),
        Verb::Explain => explain::on(world, request, out),
        Verb::WhatIf => what_if::on(world, request, out),
        Verb::Invite => invite::on(world, request, out),
        Verb::Expel => expel::on(world, questions, request, out),
        Verb::Grab => grab::on(world, request, out),
        Verb::Release => release::on(world, request, out),
        Verb::Renew => renew::on(world, request, out),
        Verb::Give => give::on(world, request, out),
        Verb::Accept => accept::on(world, request, out),
        Verb::Decline => decline::on(world, request, out),
        Verb::Request => request::on(world, request, out),
        Verb::Break => breaking::on(world, request, out),
        Verb::Inhibit => inhibit::on(world, request, out),
        Verb::Uninhibit => uninhibit::on(world, request, out),
        Verb::Stop | Verb::Unstop if request.parcel.family == Family::Context => stop::on(world, request, out),
        Verb::Send | Verb::Stop | Verb::Unstop => send::on(world, questions, request, out),
        Verb::Verdict => verdict::on(world, questions, request, out),
        Verb::Logout => {
            logout::on(world, questions, request, out);
            Ok(())
        }
        // Those need what the hub does not have: passwords, keys and clocks. The broker answers them.
        verb @ (Verb::Login
        | Verb::Answer
        | Verb::Resume
        | Verb::Ping
        | Verb::Pong
        | Verb::Ack
        | Verb::Resent
        // A right, and no request.
        | Verb::Device) => {
            let text = format!("{verb} is not answered here");
            Err(WireError::new(Code::UNKNOWN_VERB, text).into())
        }
    }
}
