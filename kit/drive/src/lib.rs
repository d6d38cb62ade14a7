//! What programs share that drive a device of the lab: they join its channel, ask it ([`DeviceChannel`]), hold its token
//! ([`Holding`]), and have it carry out one command after the other ([`Robot`]).
//!
//! The work ends with its scope and with who lent the token ([`Holding::during`]); a command that runs then is halted,
//! and heard to have ended ([`Holding::end`], [`halt`]).
//!
//! [`VerbFailure`] says why they did not do their work, as the command line tells it.

mod age;
mod asking;
mod ending;
mod failure;
mod holding;
mod pose;
mod robot;
mod scope;

pub use age::believed;
pub use asking::{ANSWER, DeviceChannel, closed, refusal};
pub use ending::{HALTED, Halt, REPEATED, TIMES, halt, insist};
pub use failure::{Doing, Tell, VerbFailure, both};
pub use holding::{Holding, WorkEnd, lost_words};
pub use pose::Pose;
pub use robot::{CommandEnd, Robot, RobotState, gone};
pub use scope::{beyond_scope, scope_end_words};
