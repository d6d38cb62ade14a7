//! Why a request was not carried out.

use std::sync::Arc;

use mom_managers::Defer;
use mom_proto::{ContextNumber, Path, Verb, WireError};

use crate::PeerId;
use crate::messages::age::Aged;

#[derive(Debug)]
pub(crate) enum Refusal {
    /// For good.
    Error(WireError),
    /// Not before a peer was asked.
    Defer(Box<Deferred>),
}

impl From<WireError> for Refusal {
    fn from(error: WireError) -> Refusal {
        Refusal::Error(error)
    }
}

/// What is to be asked.
#[derive(Debug)]
pub(crate) struct Deferred {
    pub(crate) defer: Defer,
    /// The rule that asks, for people.
    pub(crate) rule: Arc<str>,
    /// The peer that the question is about: mostly the one that made the request.
    pub(crate) peer: PeerId,
    pub(crate) verb: Verb,
    /// The context whose manager asks.
    pub(crate) managing: ContextNumber,
    /// The context acted on, or the nearest above it.
    pub(crate) at: ContextNumber,
    pub(crate) path: Path,
    pub(crate) message: Option<String>,
    pub(crate) size: usize,
    pub(crate) age: Option<Aged>,
    pub(crate) kind: &'static str,
}
