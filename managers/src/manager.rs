//! What every manager can do.

use mom_proto::{Map, Path};

use crate::{Question, Terms, Verdict};

/// Decides who may do what in the contexts it manages; consulted on all requests (M24).
pub trait Manager: Send + std::fmt::Debug {
    /// Answers one question. It denies everything that it does not know to be allowed.
    fn decide(&mut self, question: &Question<'_>) -> Verdict;

    /// The lease and other terms of its tokens, unless their creator names them.
    fn terms(&self) -> Terms {
        Terms::default()
    }

    /// What it knows of a context that a peer with a right to its `info` should know as well, such as where a zone is.
    fn facts(&self, _context: &Path) -> Map {
        Map::new()
    }

    /// The tokens whose waiters are asked about again when this one becomes free.
    fn neighbours(&self, _token: &Path) -> Vec<Path> {
        Vec::new()
    }
}
