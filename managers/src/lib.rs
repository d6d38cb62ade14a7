//! Who may: the [`Manager`] trait and the built-in access managers (M24, M25, M29).
//!
//! A manager answers one question at a time: may this peer do this here, now? It knows the peer's facts, the
//! verb, the context and the state of the token, never the content. It does no IO and reads no clock; time
//! comes with the question. Managers are made from the configuration file or inline at a context's creation
//! by a [`Registry`]; a new kind is one file and one line in `builtin.rs`.
//!
//! ```
//! use mom_managers::Registry;
//! use mom_proto::{Map, Value};
//!
//! let registry = Registry::builtin();
//! let spec = Map::new().with("kind", "level-or-lease").with("lease", 180_000);
//! assert!(registry.build(&Value::Map(spec)).is_ok());
//! ```

mod bucket;
mod builtin;
mod calendar;
mod chain;
mod closed;
mod first_come;
mod given;
mod held;
mod level_or_lease;
mod manager;
mod moderated;
mod open;
mod params;
mod question;
mod queue;
mod quota;
mod registry;
mod roles;
mod schedule;
mod self_managed;
#[cfg(test)]
mod tests;
mod verdict;
mod who;
mod zones;

pub use manager::Manager;
pub use question::{GivenAnswer, NoTokens, Owner, PeerFacts, Question, TokenFacts, Tokens};
pub use registry::{Factory, Registry, Setup};
pub use verdict::{
    Answer, Ask, Bucket, Defer, Denial, Expiry, Grant, Rate, Scope, Standing, Terms, Verdict, Wait,
};

// The examples of the guide are compiled and run with the doctests.
#[cfg(doctest)]
#[doc = include_str!("../../docs/managers.md")]
mod guide {}
