//! A wheeled robot that is a peer of the hub itself, without a base station and without a gateway (W22).
//!
//! [`Rover`] is the machine on any [`mom_wheels::Driver`]; [`mom_device`] queues its commands, obeys the token's owner, and answers.
//! [`Model`] is what it is like, by a file. [`Follower`] drives behind another robot by what that says of itself in a channel of their own; [`run`] connects all of it to the hub.

mod follow;
mod model;
mod peer;
mod rover;

pub use follow::{Follower, LIMIT, Strayed};
pub use model::{Model, ModelError};
pub use peer::{POSE, RoverOptions, run};
pub use rover::Rover;
