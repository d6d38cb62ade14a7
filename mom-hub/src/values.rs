//! Numbers of the hub as values of the wire.

use mom_proto::{Micros, Value};

/// A duration in whole ms.
pub(crate) fn millis(duration: Micros) -> Value {
    Value::Int(i64::try_from(duration / 1000).unwrap_or(i64::MAX))
}

/// A number that may be larger than those of the wire.
pub(crate) fn number(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

/// How many there are of something.
pub(crate) fn count(count: usize) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}
