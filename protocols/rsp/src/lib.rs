//! The robot simulacrum protocol (S14 to S24): a thin robot and the computer that thinks for it exchange what differs, in packets
//! whose format follows from a model of the robot.

#![no_std]

#[cfg(any(test, feature = "middle"))]
extern crate std;

mod layout;

pub use layout::{Element, Kind, Layout, Motion, Number, Payload};
