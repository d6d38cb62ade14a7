//! The demonstration lab's broker inside a test, on a port of its own.

use std::net::SocketAddr;

use mom_broker::{Broker, Clock, Config};
use mom_proto::Time;

/// Starts the lab's broker on a free port of loopback.
pub async fn start() -> Broker {
    start_with(|_| {}).await
}

/// Starts the lab's broker on a free port of loopback, with some of its configuration changed.
///
/// # Panics
/// If the configuration is refused: the test's own fault.
pub async fn start_with(change: impl FnOnce(&mut Config)) -> Broker {
    start_at(Clock::system(), change).await
}

/// The same, with a clock of the test's own.
///
/// # Panics
/// If the configuration is refused: the test's own fault.
pub async fn start_at(clock: Clock, change: impl FnOnce(&mut Config)) -> Broker {
    let mut config = Config::lab();
    config.listen = vec![SocketAddr::from(([127, 0, 0, 1], 0)).to_string()];
    change(&mut config);
    Broker::start_at(config, clock)
        .await
        .expect("the lab is a right configuration")
}

/// A clock that stands still until the test moves it: a lease is over at once.
///
/// # Panics
/// Never.
pub fn clock() -> Clock {
    let morning = "2026-11-21T10:00:00Z".parse::<Time>();
    Clock::manual(morning.expect("a time"))
}
