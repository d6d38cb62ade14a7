//! Which loads go through which hubs, and what ours should reach beside the others: all constants of the comparison.

use std::time::Duration;

use mom_benches::scenario::Size;

use crate::brokers::Kind;
use crate::canary::{Canary, Hindrance};
use crate::crowd::Crowd;
use crate::metric::Metric;
use crate::network::LINK_RATE;
use crate::stop::SaturatedStop;

/// One scenario.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Its name.
    pub name: &'static str,
    /// What is done.
    pub load: Load,
    /// How large each parcel is.
    pub size: Size,
    /// Which hubs take it.
    pub hubs: &'static [Kind],
    /// What ours should reach.
    pub goals: &'static [Goal],
}

/// A load.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Load {
    /// As many parcels as can be from one peer to so many.
    Stream(usize),
    /// One parcel there and back.
    PingPong,
    /// Fifty peers that all talk and all listen.
    Crowd,
    /// Ten thousand peers that say nothing.
    Idle,
    /// A stop that must pass a camera's frames on a slow link.
    Stop,
    /// A stop to a receiver that is flooded, or beside one that reads nothing.
    Canary(Hindrance),
    /// A channel with a token and managers beside one without.
    Guarded,
}

/// A bound on one quantity of our own hub.
#[derive(Clone, Copy, Debug)]
pub struct Goal {
    /// The quantity.
    pub metric: Metric,
    /// Its bound.
    pub rule: Rule,
}

/// A bound.
#[derive(Clone, Copy, Debug)]
pub enum Rule {
    /// At least this.
    AtLeast(f64),
    /// At most this.
    AtMost(f64),
    /// At least so many times the best peer's.
    TimesBest(f64),
    /// At most so many times the best peer's.
    OfBest(f64),
    /// At most so many times the relay's.
    OfRelay(f64),
}

/// How much is done for a figure.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Runs of which the median counts.
    pub runs: usize,
    /// A stream's time before its measurement.
    pub warm_up: Duration,
    /// A stream's measured time.
    pub stream: Duration,
    /// Measured round trips, over all connections.
    pub rounds: usize,
    /// Pairs of connections that they are spread over.
    pub connections: usize,
    /// Round trips before another hub has its turn.
    pub block: usize,
    /// The crowd.
    pub crowd: Crowd,
    /// Idle peers.
    pub idle: usize,
    /// The saturated stop.
    pub stop: SaturatedStop,
    /// The canary.
    pub canary: Canary,
    /// Pairs of streams, one on a bare channel and one on a guarded.
    pub pairs: usize,
}

impl Effort {
    /// For figures: some 25 minutes with all peers.
    pub fn full() -> Effort {
        Effort {
            runs: 3,
            warm_up: Duration::from_millis(300),
            stream: Duration::from_millis(1000),
            rounds: 6000,
            connections: 10,
            block: 200,
            crowd: Crowd {
                peers: 50,
                rate: 100,
                payload: 256,
                warm_up: Duration::from_millis(500),
                time: Duration::from_secs(4),
            },
            idle: 10_000,
            stop: SaturatedStop {
                frame: 64 * 1024,
                load: 1.5 * LINK_RATE,
                warm_up: Duration::from_secs(2),
                pauses: None,
                stops: 300,
                every: Duration::from_millis(100),
                late: Duration::from_secs(30),
            },
            canary: Canary {
                payload: 16 * 1024,
                offered: 80e6,
                times: 10.0,
                stops: 100,
                every: Duration::from_millis(40),
                late: Duration::from_secs(5),
            },
            pairs: 10,
        }
    }

    /// For a look whether all still works: the figures mean little.
    pub fn quick() -> Effort {
        let full = Effort::full();
        Effort {
            runs: 1,
            warm_up: Duration::from_millis(50),
            stream: Duration::from_millis(200),
            rounds: 600,
            connections: 2,
            crowd: Crowd {
                warm_up: Duration::from_millis(100),
                time: Duration::from_millis(500),
                ..full.crowd
            },
            // As many as in a whole run: what is left of joining weighs more on a few.
            idle: 10_000,
            stop: SaturatedStop {
                stops: 20,
                ..full.stop
            },
            canary: Canary {
                stops: 20,
                ..full.canary
            },
            pairs: 2,
            ..full
        }
    }
}

const STREAMS: &[Kind] = &[
    Kind::RawRelay,
    Kind::Relay,
    Kind::Mom,
    Kind::Nats,
    Kind::Redis,
    Kind::Mosquitto,
    Kind::Zenoh,
];
/// Where several senders talk at once, a relay has to know where a frame ends.
const TALKS: &[Kind] = &[
    Kind::Relay,
    Kind::Mom,
    Kind::Nats,
    Kind::Redis,
    Kind::Mosquitto,
    Kind::Zenoh,
];
const BROKERS: &[Kind] = &[Kind::Mom, Kind::Nats, Kind::Redis, Kind::Mosquitto, Kind::Zenoh];
const XML: &[Kind] = &[Kind::MomXml, Kind::Prosody];

const fn goal(metric: Metric, rule: Rule) -> Goal {
    Goal { metric, rule }
}

const TWICE: &[Goal] = &[goal(Metric::Rate, Rule::TimesBest(2.0))];
const FAN_OUT: &[Goal] = &[
    goal(Metric::Rate, Rule::TimesBest(2.0)),
    goal(Metric::Cpu, Rule::OfBest(0.5)),
];
const PING_PONG: &[Goal] = &[
    goal(Metric::P50, Rule::OfBest(1.0)),
    goal(Metric::P99, Rule::OfBest(1.0)),
    goal(Metric::P50, Rule::OfRelay(1.2)),
    goal(Metric::P99, Rule::OfRelay(1.2)),
];

const fn row(
    name: &'static str,
    load: Load,
    payload: usize,
    hubs: &'static [Kind],
    goals: &'static [Goal],
) -> Row {
    Row {
        name,
        load,
        size: Size::Payload(payload),
        hubs,
        goals,
    }
}

/// All scenarios.
pub const ROWS: [Row; 18] = [
    row("1→1, 16 B", Load::Stream(1), 16, STREAMS, TWICE),
    row("1→1, 256 B", Load::Stream(1), 256, STREAMS, TWICE),
    row("1→1, 1 KiB", Load::Stream(1), 1024, STREAMS, TWICE),
    row("1→1, 16 KiB", Load::Stream(1), 16 * 1024, STREAMS, TWICE),
    row(
        "1→1, 256 KiB",
        Load::Stream(1),
        256 * 1024,
        STREAMS,
        &[goal(Metric::Rate, Rule::TimesBest(1.0))],
    ),
    row("1→10, 256 B", Load::Stream(10), 256, STREAMS, FAN_OUT),
    row("1→100, 256 B", Load::Stream(100), 256, STREAMS, FAN_OUT),
    row("1→1000, 256 B", Load::Stream(1000), 256, STREAMS, FAN_OUT),
    Row {
        name: "1→1, 300 B in all, XML",
        load: Load::Stream(1),
        size: Size::Frame(300),
        hubs: XML,
        goals: &[
            goal(Metric::Rate, Rule::AtLeast(200_000.0)),
            goal(Metric::Rate, Rule::TimesBest(10.0)),
        ],
    },
    row("ping-pong, 16 B", Load::PingPong, 16, STREAMS, PING_PONG),
    row("ping-pong, 1000 B", Load::PingPong, 1000, STREAMS, PING_PONG),
    row("ping-pong, 10000 B", Load::PingPong, 10_000, STREAMS, PING_PONG),
    row(
        "50 peers, 100/s each, 256 B",
        Load::Crowd,
        256,
        TALKS,
        &[
            goal(Metric::Share, Rule::AtLeast(0.9995)),
            goal(Metric::P99, Rule::OfBest(1.0)),
            goal(Metric::Cpu, Rule::OfBest(0.7)),
        ],
    ),
    row(
        "10000 idle peers",
        Load::Idle,
        64,
        BROKERS,
        &[goal(Metric::Memory, Rule::AtMost(4.0))],
    ),
    row(
        "saturated stop",
        Load::Stop,
        64 * 1024,
        BROKERS,
        &[
            goal(Metric::P99, Rule::AtMost(5000.0)),
            goal(Metric::Arrived, Rule::AtLeast(300.0)),
            goal(Metric::Link, Rule::AtLeast(0.9)),
            goal(Metric::Told, Rule::AtLeast(1.0)),
        ],
    ),
    row(
        "stop to a receiver of a flood",
        Load::Canary(Hindrance::Flood),
        16 * 1024,
        BROKERS,
        &[
            goal(Metric::Arrived, Rule::AtLeast(100.0)),
            goal(Metric::P99, Rule::OfBest(0.1)),
        ],
    ),
    row(
        "stop beside a receiver that reads nothing",
        Load::Canary(Hindrance::Sleeper),
        16 * 1024,
        BROKERS,
        &[goal(Metric::Arrived, Rule::AtLeast(100.0))],
    ),
    row(
        "guarded and managed beside bare, 256 B",
        Load::Guarded,
        256,
        &[Kind::Mom],
        &[goal(Metric::Guarded, Rule::AtLeast(0.95))],
    ),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_has_ours_and_something_to_reach() {
        for row in ROWS {
            assert!(row.hubs.iter().any(|kind| kind.is_mom()), "{}", row.name);
            assert!(!row.goals.is_empty(), "{}", row.name);
        }
    }
}
