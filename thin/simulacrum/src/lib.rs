//! The computer that thinks for thin robots (S1 to S10): it mirrors each of them over RSP, and makes it a device of the hub.
//!
//! [`Simulacrum`] is the Robot API (S7, S8): what a program writes is on its way within a period, what it reads is what the robot said
//! last, and since when. [`Mirror`] is the robot as a machine of the hub: the owner of its token commands it in the terms of its model.
//! [`run`] connects both.

mod action;
mod generator;
mod link;
mod peer;
mod playing;
pub mod program;
mod teller;
mod unit;
mod values;
mod wheels;

pub use action::{Action, Attached, Setting};
pub use generator::{GENERATE, GENERATED};
pub use link::{Listener, Simulacrum, serve};
pub use peer::{RobotLine, SimulacrumOptions, run};
pub use teller::{PACKET, Teller};
pub use unit::Mirror;
pub use values::{ValueFault, from_wire, to_wire};
pub use wheels::{Wheels, chassis};
