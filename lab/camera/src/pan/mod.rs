//! The camera on a mount that turns and tilts, by commands of the owner of its own token (M62).
//!
//! [`Mount`] is the machine, which [`mom_device`] has carry out commands and answer for them. What it is doing reaches the images
//! as a [`Slew`].

mod aim;
mod mount;
pub(crate) mod peer;
#[cfg(test)]
mod script_tests;
#[cfg(test)]
mod server_tests;
mod slew;

pub use aim::{Aim, HOME, PANS, TILTS};
pub(crate) use aim::{MOUNT, direction};
pub use mount::{Mount, MountAction};
pub use slew::{CameraTime, PAN_SPEED, Slew, TILT_SPEED};
