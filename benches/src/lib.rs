//! The measurements of MOM: what the hub decides, what the codecs carry, and the broker from end to end
//! beside a relay that parses length prefixes.
//!
//! A [`Driver`] speaks one protocol as raw bytes. A [`Hub`] is a running program under measurement and its
//! driver. [`Stream`] and [`RoundTrips`] load any hub in the same way: the same flush policy, a closed window
//! of outstanding parcels, and every parcel numbered, so that a loss or a changed order is an [`Error`] and
//! never a better figure. [`scenario`] puts hubs beside each other in one run, [`report`] makes the table.
//!
//! Other brokers are measured by the package `mom-rivals`, which has their drivers and starts their programs; what the papers measured by
//! `mom-experiments`.

pub mod codecs;
pub mod control;
pub mod decisions;
pub mod doors;
mod driver;
mod error;
pub mod hot_path;
mod hub;
pub mod isolation;
pub mod listen;
pub mod machine;
mod one_core;
mod pace;
mod process;
pub mod report;
mod round_trip;
pub mod scenario;
mod stream;
mod window;

pub use driver::{
    Batching, Driver, Link, Message, MomDriver, NUMBER, PATIENCE, RelayDriver, Scan, Scanner, Template,
    Topic, decimal,
};
pub use error::Error;
pub use hub::{Hub, USER, broker_folder, start_broker, start_relay};
pub use pace::{Pace, Rate, measure, median};
pub use process::Process;
pub use round_trip::{Delays, RoundTrips};
pub use stream::{Stream, Streamed, connect_all};
