//! MOM beside other brokers: the same load generator, each hub in a process of its own, one table.
//!
//! [`plan::ROWS`] has all scenarios with what ours should reach; another broker is one more [`Kind`] and one more
//! [`mom_benches::Driver`].

mod brokers;
mod canary;
mod crowd;
mod doors;
mod driver;
mod files;
mod gateway;
mod idle;
mod metric;
mod network;
pub mod plan;
mod plot;
mod run;
mod stop;
pub mod table;

pub use brokers::{Kind, Programs};
pub use canary::{Canary, Hindrance};
pub use crowd::Crowd;
pub use doors::DoorHub;
pub use driver::{MqttDriver, NatsDriver, RedisDriver, XmppDriver, ZenohDriver};
pub use gateway::{Gateway, Passage, trusting};
pub use idle::{idle, raise_files};
pub use metric::{Metric, Sample};
pub use mom_tests::network::Network;
pub use network::SlowLink;
pub use plot::bars;
pub use run::{Outcome, run};
pub use stop::{Observed, SaturatedStop};
