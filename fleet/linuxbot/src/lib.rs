//! The robot server of the fleet (W1, W9): a wheeled robot that a base station drives over TCP by the wire of [`mom_brs`].
//!
//! [`Robot`] decides, without a connection and without a clock: it carries out frames and says what is to be replied. [`serve`]
//! listens, and connects one base station at a time to it. What moves is behind [`mom_wheels::Driver`]. [`serve_page`] serves the
//! robot's own page and what it sees beside that (W21, W22).

mod access;
mod eye;
mod glance;
mod hearing;
mod listen;
mod login;
mod page;
pub mod program;
mod refusals;
mod robot;
mod status;

pub use access::Access;
pub use eye::Eye;
pub use glance::{Glance, Observed, Observer};
pub use listen::{Options, serve, serve_observed};
pub use login::Login;
pub use page::{Page, serve_page};
pub use robot::{Robot, Rules};
pub use status::Status;
