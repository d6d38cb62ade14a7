//! What programs share that drive a device of the lab: they join its channel, ask it ([`DeviceChannel`]), hold its token
//! ([`Holding`]), and have it carry out one command after the other ([`Robot`]).
//!
//! [`VerbFailure`] says why they did not do their work, as the command line tells it.

mod asking;
mod failure;
mod holding;
mod pose;
mod robot;

pub use asking::{ANSWER, DeviceChannel, closed, refusal};
pub use failure::{Doing, Tell, VerbFailure, both};
pub use holding::{Holding, WorkEnd, lost_words};
pub use pose::Pose;
pub use robot::{CommandEnd, Robot, RobotState};
