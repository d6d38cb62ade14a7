//! A wheeled robot that is a peer of the hub itself, without a base station and without a gateway (W22).
//!
//! [`mom_wheeled::Rover`] is the machine on any [`mom_wheels::Driver`]; [`mom_device`] queues its commands, obeys the token's owner, and
//! answers. [`run`] connects it to the hub, where it tells others where it is, and may follow one of them.

mod peer;
pub mod program;

pub use peer::{POSE, RoverOptions, run};
