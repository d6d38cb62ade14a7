//! What a request wants, for the manager's question.

use mom_proto::{ContextKind, ContextNumber, Path, Verb};

use crate::messages::age::Aged;

pub(crate) struct Wish<'a> {
    pub(crate) verb: Verb,
    /// The context whose manager is asked.
    pub(crate) at: ContextNumber,
    /// The path acted on, where it is not that context's own.
    pub(crate) path: Option<&'a Path>,
    pub(crate) kind: Option<ContextKind>,
    pub(crate) message: Option<&'a str>,
    pub(crate) size: usize,
    /// The age of the message and its error, µs, where they are known.
    pub(crate) age: Option<Aged>,
}

impl Wish<'_> {
    pub(crate) fn new(verb: Verb, at: ContextNumber) -> Wish<'static> {
        Wish {
            verb,
            at,
            path: None,
            kind: None,
            message: None,
            size: 0,
            age: None,
        }
    }
}
