//! The demonstration lab's broker inside a test, on a port of its own.

use std::net::SocketAddr;

use mom_broker::{Broker, Clock, Config};
use mom_proto::{Map, Time, Value, from_value};

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
    config.listen = vec![SocketAddr::from(([127, 0, 0, 1], 0)).into()];
    // Raw peers answer no pings: where nothing else is said, none is silent for too long because the machine is busy.
    config.limits.gone = 600_000;
    change(&mut config);
    Broker::start_at(config, clock)
        .await
        .expect("the lab is a right configuration")
}

/// Lets a rule go before all others in the lab's chat, where everybody may do everything.
///
/// # Panics
/// Never: the lab has a chat.
pub fn rule_chat(config: &mut Config, rule: Map) {
    let all = Map::new().with("allow", words(&["*"]));
    let rules = vec![Value::from(rule), Value::from(all)];
    let manager = Map::new().with("kind", "roles").with("rules", rules);
    let mut contexts = config.contexts.iter_mut();
    let chat = contexts.find(|spec| spec.path.as_deref() == Some("/chat"));
    chat.expect("the lab has a chat").manager = Some(manager.into());
}

/// Adds a channel in which senders wait for room.
///
/// # Panics
/// Never: what it adds is a context.
pub fn add_waiting_channel(config: &mut Config, path: &str) {
    let channel = Map::new()
        .with("path", path)
        .with("kind", "channel")
        .with("overflow", "wait");
    config
        .contexts
        .push(from_value(channel.into()).expect("a context"));
}

/// Words as they stand in a rule.
pub fn words(words: &[&str]) -> Vec<Value> {
    words.iter().map(|word| Value::from(*word)).collect()
}

/// A clock that stands still until the test moves it: a lease is over at once.
///
/// # Panics
/// Never.
pub fn clock() -> Clock {
    let morning = "2026-11-21T10:00:00Z".parse::<Time>();
    Clock::manual(morning.expect("a time"))
}
