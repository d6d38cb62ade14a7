//! Drives: the MOM broker service (design §3).
//!
//! [`Broker::start`] listens, logs peers in, reads their parcels, asks the hub and writes what it decides;
//! [`Broker::connect_local`] joins a peer inside the same process. The way of a parcel: `mom-net` reads bytes,
//! a codec of `mom-proto` makes a parcel, `connection` hands it to the switchboard of `traffic`, which admits it by
//! the channel's route or asks `mom-hub`, encodes it once per wire form and puts it into outboxes; they write.

mod broker;
mod connection;
mod inquiry;
mod reload;
mod traffic;
mod web;

pub use broker::{Broker, BrokerError, read_tls};
pub use mom_config::{
    Asked, Config, ConfigError, ConfigErrors, Explanation, ListenConfig, Location, Network, ReloadOn,
    Supposed, TlsConfig, check_address, config_schema, users_schema,
};
pub use mom_journal::{
    AuditConfig, Decision, Difference, Outcome, RecordConfig, RecordError, Replay, Summary, WriteError,
};
pub use mom_login::{
    FailureRate, JwtConfig, JwtUsers, KeyFile, LoginConfig, LoginStats, ThrottleConfig, UserEntry, hash,
};
pub use mom_net::{Protocol, TlsUse};
pub use mom_store::{StoreConfig, StoreError};
pub use mom_system::Clock;
pub use reload::{Changes, ReloadReport};
