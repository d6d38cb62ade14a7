//! What robots of a fleet have alike at a hub, whoever drives their motors: a gateway, or the robot itself.
//!
//! [`Action`] is the language of their scripts, [`enter`] makes the contexts of one robot, and [`StatusTeller`] tells of it in the channel
//! of all states; [`come_back`] and [`stay`] keep it where it belongs.

mod action;
mod back;
mod contexts;
mod status;

pub use action::{Action, PLACES};
pub use back::{come_back, stay};
pub use contexts::{ensure_session, enter, enter_status};
pub use status::StatusTeller;
