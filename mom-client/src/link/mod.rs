//! One connection after another: finding a door, logging in, reading, writing, and going on after a loss.

mod arrivals;
mod connection;
pub(crate) mod doors;
pub(crate) mod driver;
pub(crate) mod login;
pub(crate) mod probe;
pub(crate) mod reconnect;
pub(crate) mod report;
mod sending;
mod survive;
