//! The fleet of the second paper: over the model of its network in virtual time, and over real sockets.

mod air;
pub(super) mod beside;
mod drive;
pub(super) mod lost;
pub(super) mod many;
pub(super) mod rates;
mod sockets;
pub(super) mod trips;

use super::quantile;

/// ms that a message took, sorted.
#[derive(Clone, Debug, Default)]
struct Times(Vec<f64>);

impl Times {
    fn new(mut times: Vec<f64>) -> Times {
        times.sort_by(f64::total_cmp);
        Times(times)
    }

    fn at(&self, share: f64) -> f64 {
        quantile(&self.0, share)
    }

    fn mean(&self) -> f64 {
        self.0.iter().sum::<f64>() / self.0.len() as f64
    }
}

/// So many out of so many, as percent.
fn percent(part: u64, whole: u64) -> f64 {
    100.0 * part as f64 / whole.max(1) as f64
}
