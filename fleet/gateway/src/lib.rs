//! Robots of the base station's wire as devices at a hub: one arbitration over their protocol and others.
//!
//! [`Unit`] is one robot as its gateway knows it: what statements become on the wire, and what its replies say of it.
//! [`mom_device`] queues the commands, obeys the token's owner, and answers; [`run`] makes the contexts of each robot and connects
//! it to the hub.

mod crew;
mod editor;
mod peer;
pub mod program;
mod robot;
mod site;
mod station;
mod unit;
pub mod verb;

pub use crew::Changes;
pub use editor::{FleetFile, Taking};
pub use peer::run;
pub use site::{GatewayOptions, connections};
pub use station::{RobotWire, lines, settings};
pub use unit::Unit;
