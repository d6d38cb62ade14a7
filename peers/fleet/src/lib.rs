//! What robots of a fleet have alike at a hub, whoever drives their motors: a gateway, or the robot itself.
//!
//! [`Action`] is the language of their scripts, [`enter`] makes the contexts of one robot, and [`StatusTeller`] tells of it in the channel
//! of all states; [`come_back`] and [`stay`] keep it where it belongs.

mod action;
mod contexts;
mod status;

pub use action::{Action, PLACES};
pub use contexts::{enter, enter_status};
pub use mom_device::{come_back, ensure_session, stay};
pub use status::StatusTeller;
