//! What can be measured, in which unit, and which direction is better.

use std::collections::BTreeMap;

/// One quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Metric {
    /// Deliveries per second.
    Rate,
    /// Of all deliveries that were asked for, from 0 to 1.
    Share,
    /// Delay in µs that half of all do not exceed.
    P50,
    /// Delay in µs that 99 of 100 do not exceed.
    P99,
    /// Processor seconds of the hub's process per million deliveries.
    Cpu,
    /// KiB that the hub's process grows by with one more peer.
    Memory,
    /// Stops that arrived.
    Arrived,
    /// Of the link's rate, what frames' payloads took, from 0 to 1.
    Link,
    /// Frames that arrived.
    Frames,
    /// Frames of which the camera heard that they were dropped.
    Told,
    /// The guarded channel's rate over the bare one's.
    Guarded,
    /// As [`Metric::P50`], before the load.
    IdleP50,
    /// As [`Metric::P99`], before the load.
    IdleP99,
    /// Processor cores that the hub's process used.
    Cores,
    /// MiB that the hub's process grew by.
    Grown,
}

/// What one run came to.
pub type Sample = BTreeMap<Metric, f64>;

impl Metric {
    /// All of them.
    pub const ALL: [Metric; 15] = [
        Metric::Rate,
        Metric::Share,
        Metric::P50,
        Metric::P99,
        Metric::Cpu,
        Metric::Memory,
        Metric::Arrived,
        Metric::Link,
        Metric::Frames,
        Metric::Told,
        Metric::Guarded,
        Metric::IdleP50,
        Metric::IdleP99,
        Metric::Cores,
        Metric::Grown,
    ];

    /// Its key in the raw results.
    pub fn key(self) -> &'static str {
        match self {
            Metric::Rate => "deliveries-per-second",
            Metric::Share => "share-delivered",
            Metric::P50 => "p50-us",
            Metric::P99 => "p99-us",
            Metric::Cpu => "cpu-s-per-million",
            Metric::Memory => "kib-per-peer",
            Metric::Arrived => "stops-arrived",
            Metric::Link => "link-share",
            Metric::Frames => "frames-arrived",
            Metric::Told => "frames-told-dropped",
            Metric::Guarded => "guarded-over-bare",
            Metric::IdleP50 => "idle-p50-us",
            Metric::IdleP99 => "idle-p99-us",
            Metric::Cores => "cores",
            Metric::Grown => "mib-grown",
        }
    }

    /// The one with this key.
    pub fn from_key(key: &str) -> Option<Metric> {
        Metric::ALL.into_iter().find(|metric| metric.key() == key)
    }

    /// What it is called in tables.
    pub fn title(self) -> &'static str {
        match self {
            Metric::Rate => "deliveries per second",
            Metric::Share => "share delivered",
            Metric::P50 => "p50, µs",
            Metric::P99 => "p99, µs",
            Metric::Cpu => "CPU s per million deliveries",
            Metric::Memory => "KiB per peer",
            Metric::Arrived => "stops that arrived",
            Metric::Link => "share of the link",
            Metric::Frames => "frames that arrived",
            Metric::Told => "dropped frames that the camera heard of",
            Metric::Guarded => "guarded over bare",
            Metric::IdleP50 => "p50 before, µs",
            Metric::IdleP99 => "p99 before, µs",
            Metric::Cores => "cores of CPU",
            Metric::Grown => "MiB that the hub grew by",
        }
    }

    /// Whether more is better.
    pub fn more_is_better(self) -> bool {
        match self {
            Metric::Rate
            | Metric::Share
            | Metric::Arrived
            | Metric::Link
            | Metric::Frames
            | Metric::Guarded => true,
            Metric::P50 | Metric::P99 | Metric::Cpu | Metric::Memory | Metric::Told => false,
            Metric::IdleP50 | Metric::IdleP99 | Metric::Cores | Metric::Grown => false,
        }
    }

    /// The value as it stands in a table.
    pub fn show(self, value: f64) -> String {
        match self {
            Metric::Rate => mom_benches::report::amount(value),
            Metric::Share | Metric::Link | Metric::Guarded => format!("{value:.3}"),
            Metric::P50 | Metric::P99 | Metric::IdleP50 | Metric::IdleP99 if value >= 1e6 => {
                format!("{:.1} s", value / 1e6)
            }
            Metric::P50 | Metric::P99 | Metric::IdleP50 | Metric::IdleP99 if value >= 10_000.0 => {
                format!("{:.1} ms", value / 1000.0)
            }
            Metric::P50 | Metric::P99 | Metric::IdleP50 | Metric::IdleP99 => format!("{value:.0}"),
            Metric::Arrived | Metric::Frames | Metric::Told => format!("{value:.0}"),
            Metric::Cpu | Metric::Cores => mom_benches::report::short(value),
            Metric::Memory | Metric::Grown => format!("{value:.1}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_short() {
        for (metric, value, text) in [
            (Metric::Rate, 1_234_567.0, "1.23 M"),
            (Metric::Share, 0.99951, "1.000"),
            (Metric::P99, 187.4, "187"),
            (Metric::P99, 17_200_000.0, "17.2 s"),
            (Metric::Cpu, 0.0312, "0.031"),
            (Metric::Memory, 3.96, "4.0"),
        ] {
            assert_eq!(metric.show(value), text);
        }
    }
}
