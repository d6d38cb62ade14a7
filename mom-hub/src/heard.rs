//! What was answered to a manager that had to ask.

use mom_managers::GivenAnswer;
use mom_proto::{ContextNumber, Verb};

use crate::PeerId;

/// An answer and its question. Managers of the same label in other contexts do not see it.
#[derive(Clone, Debug)]
pub(crate) struct Heard {
    pub(crate) peer: PeerId,
    pub(crate) verb: Verb,
    pub(crate) at: ContextNumber,
    /// What [`World::grants_at`](crate::world::World::grants_at) was when it was asked: an answer about a token holds
    /// no longer than until the next grant.
    pub(crate) grants: u64,
    pub(crate) given: GivenAnswer,
}
