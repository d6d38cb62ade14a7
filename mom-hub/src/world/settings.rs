//! What the hub is given at its start.

use mom_proto::{Limits, Micros, Time};

use crate::{Record, StopRecord};

/// The hub's constants.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Wall time at monotonic time 0.
    pub anchor: Time,
    /// The upper part of every fence: Unix seconds at start or more, so that fences rise over restarts.
    pub epoch: u64,
    /// Whether changes of ownership wait until they are durable ([`Effect::Store`](crate::Effect::Store)).
    pub durable: bool,
    /// The records that were durable before the start.
    pub records: Vec<Record>,
    /// Whether stops are kept ([`Effect::Keep`](crate::Effect::Keep)).
    pub keeps_stops: bool,
    /// What was stopped before the start.
    pub stops: Vec<StopRecord>,
    /// That could not be read: what is not in `stops` is stopped.
    pub stops_unread: bool,
    /// The limits that the login reply advertises.
    pub limits: Limits,
    /// For how long another user cannot have the name of a peer that left, in µs.
    pub name_rest: Micros,
    /// The members of a context above which `counts` are sent, and at most once in
    /// [`Settings::counts_every`].
    pub counts_above: usize,
    /// The least time between two counts, in µs.
    pub counts_every: Micros,
}

impl Default for Settings {
    fn default() -> Settings {
        Settings {
            anchor: Time::default(),
            epoch: 0,
            durable: false,
            records: Vec::new(),
            keeps_stops: false,
            stops: Vec::new(),
            stops_unread: false,
            limits: Limits::default(),
            name_rest: 60_000_000,
            counts_above: 200,
            counts_every: 1_000_000,
        }
    }
}
