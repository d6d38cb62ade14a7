//! What programs share that drive a device: they join its channel, ask it ([`DeviceChannel`]), hold its token
//! ([`Holding`]), and have it carry out one command after the other ([`Commander`]).
//!
//! What becomes of a command is the same everywhere, and in the same words ([`CommandEnd`]): `tests/cases/commander.txt`
//! has it as dialogues, which the clients in Python and JavaScript replay too.
//!
//! The work ends with its scope and with who lent the token ([`Holding::during`]); a command that runs then is halted,
//! and heard to have ended ([`Holding::end`], [`halt`]).
//!
//! [`VerbFailure`] says why they did not do their work, as the command line tells it.

mod age;
mod asking;
mod commander;
mod course;
mod end;
mod failure;
mod heard;
mod holding;
mod insist;
mod pose;
mod robot;
mod scope;
mod step;

pub use age::believed;
pub use asking::{ANSWER, DeviceChannel, closed, refusal};
pub use commander::{Command, Commander, Next, gone, halt};
pub use course::HALTED;
pub use end::{CommandEnd, Halt, How, loss_words, lost_words};
pub use failure::{Doing, Tell, VerbFailure, both};
pub use heard::{Report, StateNews, error_words};
pub use holding::{Holding, WorkEnd};
pub use insist::{REPEATED, TIMES, insist};
pub use pose::Pose;
pub use robot::RobotState;
pub use scope::{beyond_scope, scope_end_words};
pub use step::{Basis, Progress};
