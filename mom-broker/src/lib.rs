//! Drives: the MOM broker service (design §3).
//!
//! [`Broker::start`] listens, logs peers in, reads their parcels, asks the hub and writes what it decides;
//! [`Broker::connect_local`] joins a peer inside the same process. The way of a parcel: `mom-net` reads bytes,
//! a codec of `mom-proto` makes a parcel, `session` hands it to the `switchboard`, which admits it by the
//! channel's route or asks `mom-hub`, encodes it once per wire form and puts it into outboxes; they write.

mod audit;
mod broker;
mod channel;
mod clock;
mod config;
mod encodings;
mod figures;
mod files;
mod gather;
mod history;
#[cfg(all(test, shuttle))]
mod interleaved;
mod login;
mod measure;
mod outbox;
mod record;
mod reload;
mod room;
mod schema;
mod session;
mod stats;
mod store;
mod switchboard;
mod sync;
mod witness;

pub use audit::AuditConfig;
pub use broker::{Broker, BrokerError};
pub use clock::Clock;
pub use config::{
    Asked, Config, ConfigError, Explanation, FailureRate, JwtConfig, JwtKey, JwtUsers, LoginConfig, Place,
    ReloadOn, StoreConfig, Supposed, ThrottleConfig, UserEntry,
};
pub use login::{LoginStats, hash};
pub use record::{Decision, Difference, Outcome, RecordConfig, RecordError, Replay, Summary};
pub use reload::{Changes, ReloadReport};
pub use schema::{config_schema, users_schema};
pub use store::StoreError;
