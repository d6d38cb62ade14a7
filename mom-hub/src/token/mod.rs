//! One token (M28, M29, design §6): its state, and the steps that change it.
//!
//! Everything here works on a `&mut Token` alone. The time, the fence below which no grant may be and what managers
//! have answered are arguments; who hears of a step, and which routes change with it, is the business of the room
//! `ownership`.

mod durable;
pub(crate) mod grant;
pub(crate) mod handover;
pub(crate) mod queue;
pub(crate) mod record;
pub(crate) mod state;
#[cfg(test)]
mod tests;
