//! The robot arm of the demonstration lab: a pure model, and the peer that connects it to the hub.
//!
//! Nothing but [`peer`] does IO or reads a clock. Time is an argument ([`ArmTime`]), so the same calls give
//! the same motion to the bit, and a program that wants a live arm calls [`Arm::advance`] whenever
//! [`Arm::next_wake`] is due.
//!
//! What happens to one command, from text to motion:
//!
//! 1. [`script`] reads the text into statements (M47);
//! 2. [`path`] turns each `move` into straight legs by the path rule (M52), and [`workspace`] (M50)
//!    and [`reach`] (the joints of an ABB IRB 1400, M49) check every leg of the whole script before anything moves;
//!    [`rapid`] is what a real controller would be told (M51);
//! 3. the queue of `mom-device`, which every device has, begins its statements one after the other, and [`machine`] gives the
//!    [`controller`] one instruction after the other; [`arm`] is both without a hub;
//! 4. the controller carries them out: a real one, or the simulated one, for which [`motion`] gives the hand's posture at a time (150 mm/s,
//!    M49), [`contact`] what it meets, and [`blocks`] how blocks are pushed, taken, fall and topple.
//!
//! `mom-device`'s server decides how the arm reacts to the parcels and events of its channel, as for every device; [`peer::run`] connects
//! it to the hub, in a program of its own (`mom-arm`) or in another one, and keeps it out of closed [`zones`].
//!
//! Lengths are millimetres and angles degrees everywhere, in the table's frame: the origin is the
//! middle of the table's surface and z points up. Times are int microseconds.
//!
//! # Examples
//!
//! ```
//! use mom_arm::{Arm, ArmEvent, CommandState};
//!
//! let mut arm = Arm::new(0);
//! let mut events = Vec::new();
//! arm.submit(1, "move 100 50 200 0 0; grip close", 0, &mut events)?;
//! while let Some(due) = arm.next_wake() {
//!     arm.advance(due, &mut events);
//! }
//! assert!(events.iter().any(|event| matches!(
//!     event,
//!     ArmEvent::Command { id: 1, state: CommandState::Finished, .. }
//! )));
//! assert_eq!(arm.state().pose.x, 100.0);
//! # Ok::<(), mom_device::DeviceError>(())
//! ```

pub mod action;
pub mod arm;
pub mod blocks;
pub mod contact;
pub mod controller;
#[cfg(test)]
mod dialogues;
pub mod jog;
pub mod machine;
pub mod motion;
pub mod path;
pub mod peer;
pub mod pose;
pub mod program;
pub mod rapid;
pub mod reach;
pub mod script;
pub mod state;
pub mod status;
mod upright_box;
pub mod workspace;
pub mod zone_keeper;
mod zone_watch;
pub mod zones;

pub use action::Action;
pub use arm::Arm;
pub use blocks::Block;
pub use controller::Grip;
pub use jog::Velocity;
pub use machine::ArmMachine;
pub use motion::ArmTime;
pub use peer::ArmOptions;
pub use pose::Pose;
pub use script::{Script, Statement};
pub use state::{ArmEvent, ArmState, CommandState, Executing, Gripper, ScriptProgress};
pub use status::Status;
pub use zones::{Mount, Zones};
