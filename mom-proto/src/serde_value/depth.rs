//! The nesting of values and types: reading and writing recurse, and stacks are finite.

use crate::HARD_DEPTH;

use super::error::SerdeError;

// Options and newtypes recurse as well but leave no trace in the value, so that a type such as
// `struct Chain(Option<Box<Chain>>)` would never come to an end.
const STEPS: usize = 4 * HARD_DEPTH;

/// The way down to a place.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Depth {
    levels: usize,
    steps: usize,
}

impl Depth {
    /// One list or map further down.
    pub(super) fn level(self) -> Result<Depth, SerdeError> {
        let levels = self.levels + 1;
        match levels <= HARD_DEPTH {
            true => Depth { levels, ..self }.step(),
            false => Err(SerdeError::too_deep(format!(
                "lists and maps are nested deeper than {HARD_DEPTH}"
            ))),
        }
    }

    /// One recursion further down without a list or map.
    pub(super) fn step(self) -> Result<Depth, SerdeError> {
        let steps = self.steps + 1;
        match steps <= STEPS {
            true => Ok(Depth { steps, ..self }),
            false => Err(SerdeError::too_deep(format!(
                "the type nests itself more than {STEPS} times"
            ))),
        }
    }
}
