//! The demonstration lab's broker inside a test, on a port of its own.

use std::net::SocketAddr;

use mom_broker::{Broker, Clock, Config};

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

/// The same, by another clock.
///
/// # Panics
/// As [`start_with`].
pub async fn start_at(clock: Clock, change: impl FnOnce(&mut Config)) -> Broker {
    let mut config = Config::lab();
    config.listen = vec![SocketAddr::from(([127, 0, 0, 1], 0)).to_string()];
    change(&mut config);
    Broker::start_at(config, clock)
        .await
        .expect("the lab is a right configuration")
}
