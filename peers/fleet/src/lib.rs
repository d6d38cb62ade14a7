//! What robots of a fleet have alike at a hub, whoever drives their motors: a gateway, or the robot itself.
//!
//! [`Action`] is the language of their scripts, [`enter`] makes the contexts of one robot, and [`StatusTeller`] tells of it in the channel
//! of all states.

mod action;
mod contexts;
mod status;

pub use action::{Action, PLACES};
pub use contexts::{ensure_session, enter, enter_status};
pub use status::StatusTeller;
