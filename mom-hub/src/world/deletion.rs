//! What is being deleted in steps.

use mom_proto::{ContextNumber, Path};

use crate::{Audit, PeerId};

/// A deletion that goes on. What it concerns is closed to all requests.
#[derive(Debug)]
pub(crate) struct Deletion {
    pub(crate) top: ContextNumber,
    pub(crate) path: Path,
    pub(crate) by: Deleter,
    pub(crate) phase: Phase,
    /// Who waits for it, and the id of its request.
    pub(crate) answer: Option<(PeerId, Option<u64>)>,
}

/// Who deletes; its name outlives it.
#[derive(Clone, Debug)]
pub(crate) struct Deleter {
    pub(crate) peer: Option<PeerId>,
    pub(crate) fact: Audit,
}

/// How far a deletion has come.
#[derive(Clone, Debug)]
pub(crate) enum Phase {
    /// Tokens are lost, those after this path next.
    Tokens(Option<Path>),
    /// Contexts are removed, the last one next.
    Contexts,
}
