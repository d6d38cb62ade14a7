//! What wheeled robots have alike at a hub, whatever drives their motors: a gateway, the computer that thinks for a thin robot, or the
//! robot itself.
//!
//! [`Action`] is the language of their scripts, [`enter`] makes the contexts of one robot, and [`StatusTeller`] tells of it in the channel
//! of all states; [`come_back`] and [`stay`] keep it where it belongs. [`Rover`] is a robot as a machine of [`mom_device`] on any
//! [`mom_wheels::Driver`], [`Follower`] drives it behind another one, and [`Model`] is what it is like, by a file.

mod action;
mod contexts;
mod follow;
mod machine;
mod model;
mod stand;
mod status;

pub use action::{Action, PLACES, card_of};
pub use contexts::{enter, enter_status};
pub use follow::{Follower, LIMIT, Strayed};
pub use machine::Rover;
pub use model::{Model, ModelError};
pub use mom_device::{come_back, ensure_session, stay};
pub use stand::stand;
pub use status::StatusTeller;
