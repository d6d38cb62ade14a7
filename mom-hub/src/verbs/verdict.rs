//! `manager verdict`: a managing peer or a chair answers a `consult`.

use std::sync::Arc;

use mom_managers::GivenAnswer;
use mom_proto::{Code, WireError};
use serde::Deserialize;

use super::checks::Request;
use crate::Effect;
use crate::asking::questions::Questions;
use crate::asking::refusal::Refusal;
use crate::content;
use crate::world::World;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// The number of the question.
    consult: u64,
    allow: bool,
    /// Plain words for a no.
    #[serde(default)]
    text: String,
    /// Whether it holds for later questions of the same kind.
    #[serde(default)]
    stands: bool,
}

pub(crate) fn on(
    world: &mut World,
    questions: &mut Questions,
    request: &Request,
    out: &mut Vec<Effect>,
) -> Result<(), Refusal> {
    let args: Args = content::read(&request.parcel)?;
    let by = world
        .peers
        .get(request.peer)
        .map(|peer| Arc::clone(&peer.facts.name));
    let given = GivenAnswer {
        label: Arc::from(""),
        by,
        allow: args.allow,
        stands: args.stands,
        text: args.text,
    };
    let Some(due) = questions.answer(world, args.consult, (given, request.peer), out) else {
        let text = format!(
            "question {} is no longer open, or was never asked of this peer",
            args.consult
        );
        return Err(WireError::new(Code::TOO_LATE, text)
            .slot("content/consult")
            .into());
    };
    super::run_all(world, questions, due, out);
    request.push_ok(world, None, out);
    Ok(())
}
