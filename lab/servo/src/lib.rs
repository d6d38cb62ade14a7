//! The visual-servoing agent (M41): a user names two blocks and gives it the robot's token; it works until they are
//! aligned, and the token returns.
//!
//! It works from camera images alone. [`eyes`] tells what an image shows, [`memory`] keeps the blocks that lie still, [`track`]
//! the hand; [`aim`] makes of the errors in the images a motion, [`motion`] predicts what has been commanded, [`plan`] says how a
//! task is carried out, and [`control::Servo`] carries it out. None of these does any IO or reads a clock: times are
//! arguments.
//!
//! [`peer::run`] is the agent, in a program of its own (`mom-servo`) or in another one; [`verb`] is `mom servo`, which asks it.
//!
//! *Aligned* means: the first block stands on the table at the chosen side of the second, the middles of both on a line that is
//! perpendicular to the second block's face there, the given gap between the faces, and the faces parallel. The *error* is the
//! distance of the first block's middle from the place where that is so, on the level; up to
//! [`control::ALIGNED`] mm, and [`control::PARALLEL`] degrees, they are aligned.

pub mod aim;
pub mod control;
pub mod eyes;
pub mod memory;
pub mod motion;
pub mod peer;
pub mod plan;
pub mod program;
pub mod task;
pub mod track;
pub mod verb;

/// A time in int microseconds, of any beginning.
pub type Micros = i64;
