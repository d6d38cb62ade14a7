//! The configuration: its keys and their defaults.

mod check;
mod config;
mod error;
mod explain;
mod faults;
mod journal;
mod listen;
mod load;
mod locate;
mod login;
mod managers;
mod replace;
mod review;
mod schema;
mod shape;
mod source;
mod tls;
mod users;
mod variant;
mod web;

pub use config::{Config, ConnectionCaps, ReloadOn};
pub use error::{ConfigError, ConfigErrors};
pub use explain::{Asked, Asking, Explanation, Supposed, message_of};
pub use listen::{ListenConfig, Network, check_address};
pub use schema::{config_schema, users_schema};
pub use source::Location;
pub use tls::TlsConfig;
pub use web::WebConfig;
