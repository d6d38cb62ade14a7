//! One token.

pub(crate) mod record;
pub(crate) mod state;
